"""Stages: which velocities a robot is driven with, one after the other, and how much floor that needs. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

FIRST_SHARE, LEVELS = 0.4, 6  # of the speed, rising to all of it
FIRST_LEVEL_S, LEVEL_S = 2.4, 1.2  # the first one begins with a robot that stands


class Wheel(StrEnum):
    """The one that turns while the other stands."""

    LEFT = "left"
    RIGHT = "right"


@dataclass(frozen=True, slots=True)
class Stage:
    """A velocity, and for how long; `speed_m_s` is that of the wheels that turn."""

    speed_m_s: float
    linear_m_s: float
    angular_rad_s: float
    seconds: float


def make_stage(speed_m_s: float, seconds: float, wheel: Wheel | None, separation_m: float) -> Stage:
    """Straight ahead, or one wheel round the other."""
    if wheel is None:
        return Stage(speed_m_s, speed_m_s, 0.0, seconds)
    turn = -1 if wheel is Wheel.LEFT else 1  # the left wheel alone turns the robot clockwise
    return Stage(speed_m_s, speed_m_s / 2, turn * speed_m_s / separation_m, seconds)


def rising_stages(speed_m_s: float, wheel: Wheel | None, separation_m: float) -> tuple[Stage, ...]:
    """Small steps upwards: the robot never brakes between two messages, where nobody would notice."""
    shares = [FIRST_SHARE + (1 - FIRST_SHARE) * level / (LEVELS - 1) for level in range(LEVELS)]
    lengths_s = [FIRST_LEVEL_S, *[LEVEL_S] * (LEVELS - 1)]
    return tuple(
        make_stage(share * speed_m_s, seconds, wheel, separation_m)
        for share, seconds in zip(shares, lengths_s, strict=True)
    )


def describe_way(robot: str, stages: Sequence[Stage], wheel: Wheel | None, separation_m: float) -> str:
    """What the robot will do, for the person who must make room."""
    way_m = sum(abs(stage.speed_m_s) * stage.seconds for stage in stages)
    seconds = sum(stage.seconds for stage in stages)
    speed_m_s = stages[-1].speed_m_s
    pace = f"at up to {abs(speed_m_s):.2f} m/s for {seconds:.1f} s"
    direction = "forwards" if speed_m_s > 0 else "backwards"
    if wheel is None:
        return f"{robot} drives {way_m:.2f} m straight {direction} {pace}; keep half a metre more free"
    other = Wheel.RIGHT if wheel is Wheel.LEFT else Wheel.LEFT
    return (
        f"{robot}'s {wheel.value} wheel rolls {way_m:.2f} m {direction} round the {other.value} one {pace}; "
        f"keep a circle of {2 * separation_m + 0.5:.1f} m free"
    )
