"""Drive: what the wheels of a robot can do, and how they move its body. Pure."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

from hostlink.core.robot.kinematics.pose import Pose, moved
from hostlink.core.robot.velocity import Kinematics, PlanarVelocity
from hostlink.errors import ConfigError

Row = tuple[float, float, float]  # speed of one wheel's rim, for 1 m/s of x, 1 m/s of y and 1 rad/s of yaw

WHERE = "drive of a robot"
_FIELDS = {"linear.x": "x_m_s", "linear.y": "y_m_s", "angular.z": "yaw_rad_s"}  # components by their names in a Twist
LEAST_INDEPENDENCE = 1e-6  # of the directions in which wheels push: 1 at right angles, 0 if two are the same


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """Wheels of a robot: the speed of each rim follows from the velocity of the body by a linear equation.

    The base class has no wheels. A dimension of 0 is unknown: the drive then knows which velocities are possible, but
    not its wheels.

    Raises:
        ConfigError: a dimension is invalid, or the wheels cannot do what the drive promises.
    """

    # The same for every drive of a class. Not ClassVar: mypyc makes fields of those in a dataclass.
    kinematics: Kinematics = field(init=False, default=Kinematics.PLANAR)
    label: str = field(init=False, default="a planar drive")
    has_y: bool = field(init=False, default=True)  # it can move sideways
    turns_in_place: bool = field(init=False, default=True)
    lacks: tuple[str, ...] = field(init=False, default=())  # components for which the robot's command has no field
    wheels: tuple[str, ...] = field(init=False, default=(), repr=False, compare=False)  # names; empty: not known
    _rows: tuple[Row, ...] = field(init=False, default=(), repr=False, compare=False)
    _inverse: tuple[tuple[float, ...], ...] = field(init=False, default=(), repr=False, compare=False)

    def __post_init__(self) -> None:
        for name, value in self._dimensions():
            if not (math.isfinite(value) and value >= 0):
                raise ConfigError(WHERE, f"{name} must be a finite number, zero (unknown) or more, not {value}")
        named = self._named_rows()
        if named:
            object.__setattr__(self, "wheels", tuple(name for name, _ in named))
            object.__setattr__(self, "_rows", tuple(row for _, row in named))
            object.__setattr__(self, "_inverse", _least_squares(self._rows))

    def _dimensions(self) -> list[tuple[str, float]]:
        """Dimensions that must be finite and not negative, with their names."""
        return [
            (each.name, getattr(self, each.name))
            for each in dataclasses.fields(self)
            if each.init and isinstance(getattr(self, each.name), int | float)
        ]

    def _named_rows(self) -> list[tuple[str, Row]]:
        """Name and row of each wheel; none if a dimension of them is unknown."""
        return []

    def why_impossible(self, velocity: PlanarVelocity) -> str | None:
        """Reason for which the drive cannot move with this velocity at any speed; None: it can."""
        for component in self.lacks:
            if getattr(velocity, _FIELDS[component]) != 0:
                return f"the robot's command has no field for {component}: send 0 there"
        return self._why_not(velocity)

    def _why_not(self, velocity: PlanarVelocity) -> str | None:
        return None if self.has_y or velocity.y_m_s == 0 else self._not_sideways()

    def without(self, components: Sequence[str]) -> Self:
        """Return the same drive of a robot whose command lacks components: "linear.y", "angular.z"."""
        found = dataclasses.replace(self)
        object.__setattr__(found, "lacks", tuple(components))
        return found

    def _not_sideways(self) -> str:
        return (
            f"{self.label} cannot move sideways: send 0 as linear.y; if this robot can, remove "
            f'kinematics = "{self.kinematics.value}" from its settings'
        )

    def possible(self, velocity: PlanarVelocity) -> PlanarVelocity:
        """The possible velocity that is nearest to this one, at the same speed. Ackermann limits the curvature."""
        return velocity

    def wheel_speeds(self, velocity: PlanarVelocity) -> tuple[float, ...]:
        """Speed of each rim in m/s, in the order of `wheels`."""
        x_m_s, y_m_s, yaw_rad_s = velocity
        return tuple([a * x_m_s + b * y_m_s + c * yaw_rad_s for a, b, c in self._rows])

    def velocity(self, wheel_speeds: Sequence[float]) -> PlanarVelocity:
        """Velocity of the body; of more wheels than needed the least squares.

        Raises:
            ValueError: the number of speeds is not that of the wheels, or the drive knows no wheels.
        """
        if len(wheel_speeds) != len(self.wheels) or not self.wheels:
            raise ValueError(f"{len(wheel_speeds)} wheel speeds for {self.label} of {len(self.wheels)} known wheels")
        x_m_s, y_m_s, yaw_rad_s = (
            sum([factor * speed_m_s for factor, speed_m_s in zip(row, wheel_speeds, strict=True)])
            for row in self._inverse
        )
        return PlanarVelocity(x_m_s, y_m_s, yaw_rad_s)

    def integrate(self, pose: Pose, wheel_m: Sequence[float]) -> Pose:
        """The pose after each wheel rolled this far at a constant speed: along the arc of a circle."""
        return moved(pose, *self.velocity(wheel_m))

    def fastest_wheel_m_s(self, velocity: PlanarVelocity) -> float:
        """Speed of the fastest wheel, in either direction; infinite for a velocity that is not finite."""
        if not velocity.is_finite:
            return math.inf
        largest = max(map(abs, velocity))  # in units of it, no sum of large numbers is infinity minus infinity
        if largest == 0:
            return 0.0
        x, y, yaw = (component / largest for component in velocity)
        return largest * self._fastest(PlanarVelocity(x, y, yaw))

    def _fastest(self, velocity: PlanarVelocity) -> float:
        """Speed of the fastest wheel; without known wheels that of the body."""
        return max(map(abs, self.wheel_speeds(velocity)), default=velocity.speed_m_s)

    def limited(self, velocity: PlanarVelocity, max_wheel_m_s: float) -> PlanarVelocity:
        """The velocity in the same direction and on the same curve, slow enough for every wheel."""
        fastest_m_s = self.fastest_wheel_m_s(velocity)
        return velocity if fastest_m_s <= max_wheel_m_s else velocity.scaled(max_wheel_m_s / fastest_m_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanarDrive(Drive):
    """Drive about which nothing is known. It promises every velocity; its wheels are not known.

    `wheel_separation_m` is a diameter of the robot's drive: its fastest point is at half of it, on any side.
    """

    wheel_separation_m: float = 0.0

    def _fastest(self, velocity: PlanarVelocity) -> float:
        return velocity.speed_m_s + velocity.turn_rad_s * self.wheel_separation_m / 2


PLANAR = PlanarDrive()


def _least_squares(rows: tuple[Row, ...]) -> tuple[tuple[float, ...], ...]:
    """Pseudo-inverse of the rows, by their normal equations; a component that no wheel has stays zero.

    Raises:
        ConfigError: a component cannot be told from the others.
    """
    gram = [[sum([row[i] * row[j] for row in rows]) for j in range(3)] for i in range(3)]
    for i in range(3):
        if gram[i][i] == 0:
            gram[i][i] = 1.0
    (a, b, c), (_, d, e), (_, _, f) = gram  # symmetric
    adjugate = (
        (d * f - e * e, c * e - b * f, b * e - c * d),
        (c * e - b * f, a * f - c * c, b * c - a * e),
        (b * e - c * d, b * c - a * e, a * d - b * b),
    )
    determinant = a * adjugate[0][0] + b * adjugate[0][1] + c * adjugate[0][2]
    if determinant < LEAST_INDEPENDENCE * a * d * f:
        raise ConfigError(WHERE, "the wheels push in too few directions to move and turn; check their angles")
    return tuple(
        tuple([sum([factor * part for factor, part in zip(line, row, strict=True)]) / determinant for row in rows])
        for line in adjugate
    )
