"""WorldParameters: every number of a world, with its unit, default and source. Pure.

Names, order and defaults are those of firmware/host/world.h and drive_train.h; a test compares them.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from typing import Self

PAPER_TICKS_PER_TURN = 230.4


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelParameters:
    """What differs from wheel to wheel; the defaults are the paper's robot without a flaw."""

    full_speed_rad_s: float = 280.0 * math.tau / PAPER_TICKS_PER_TURN  # full PWM, rated voltage; docs/robot.md#numbers
    dead_zone_pwm: float = 350.0  # less does not turn it; half of the paper's dead band of 700
    has_jump: float = 1.0  # 1: above the dead zone as if there were none; 0: from nothing
    rise_constant_s: float = 0.1  # while its PWM pushes it; geared 12 V motors have 0.03..0.2
    coast_constant_s: float = 0.3  # while it runs free; estimated
    brake_constant_s: float = 0.04  # while it is shorted, behind its 75:1 gear; estimated
    friction_rad_s: float = 24.0 * math.tau / PAPER_TICKS_PER_TURN  # speed lost to friction in one time constant

    radius_m: float = 0.045  # where it rolls; docs/robot.md#numbers
    ticks_per_turn: float = PAPER_TICKS_PER_TURN  # periods of its encoder, two edges each; docs/robot.md#numbers
    slip_noise_m: float = 0.0  # standard deviation after 1 m, grows with the root; 0.001..0.005 on hard floors
    slip_accelerating_s2_m: float = 0.0  # share of the way lost for each m/s2 of acceleration; 0..0.02
    slip_braking_s2_m: float = 0.0  # share of the way slid on for each m/s2 of deceleration; 0..0.02

    @property
    def full_speed_ticks_s(self) -> float:
        """The full speed as its encoder counts it."""
        return self.full_speed_rad_s * self.ticks_per_turn / math.tau


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldParameters:
    """A robot on a floor; the defaults are the paper's robot without a flaw."""

    seed: float = 1.0  # of the random numbers, a whole number of 0..2**32-1; equal seeds repeat
    track_m: float = 0.21  # wheel to wheel where they touch the floor; docs/robot.md#numbers

    caster_arm_m: float = 0.15  # from the axle back to the caster's pivot; estimated from the paper's figure 2
    caster_trail_m: float = 0.02  # from the pivot to where the wheel touches; "almost as large as the wheel's radius"
    caster_pwm: float = 0.0  # counts of PWM that a caster costs that points the wrong way; estimated 0..300
    caster_twist_rad: float = 0.0  # by which a caster at a right angle twists the robot; 0.055 fits the paper's tables
    caster_random: float = 0.0  # standard deviation of that, as a share; 0.4 fits them

    floor_pwm: float = 0.0  # counts of PWM that the floor costs a rolling wheel: 0 hard, 100..300 carpet; estimated
    pwm_bits: float = 8.0  # that analogWrite puts on the pin, of 12: steps of 16; the Due core's variant.h
    battery_v: float = 12.0  # without load; the paper's supply
    rated_v: float = 12.0  # at which the motors' speeds hold; RHE158 12 V
    battery_sag_v: float = 0.0  # lost while both motors are driven with full PWM; 0.5..1.5 for ten alkaline cells

    left: WheelParameters = field(default_factory=WheelParameters)
    right: WheelParameters = field(default_factory=WheelParameters)

    def __post_init__(self) -> None:
        """Refuse a world that no robot can be in.

        Raises:
            ValueError: a number is out of its range; the text has its name and range.
        """
        for name, value in zip(names(), self.values(), strict=True):
            low, high = bounds(name)
            if not low <= value <= high:
                raise ValueError(f"{name}: {value:g} is not in {low:g}..{high:g}")

    def values(self) -> list[float]:
        """All numbers, in the order of the C++ struct."""
        own = [float(getattr(self, name)) for name in _own_names()]
        return own + [float(getattr(getattr(self, side), name)) for side, name in _wheel_names()]

    def text(self) -> str:
        """Lines `name=value`, as the native and the emulated board read them; those that are not the default."""
        items = zip(names(), self.values(), WorldParameters().values(), strict=True)
        return "".join(f"{name}={value!r}\n" for name, value, usual in items if value != usual)

    def changed(self, values: Mapping[str, float]) -> Self:
        """The same world with other numbers, by name: `track_m`, `left.radius_m`.

        Raises:
            ValueError: a name is no parameter's, then the text names the nearest one; or a number is out of its range.
        """
        known = names()
        for name in values:
            if name not in known:
                near = get_close_matches(name, known, n=1)
                raise ValueError(f"{name}: no such parameter" + (f"; meant {near[0]}?" if near else ""))
        return replace(
            self,
            **{name: float(value) for name, value in values.items() if "." not in name},
            left=_changed(self.left, values, "left."),
            right=_changed(self.right, values, "right."),
        )


# What a robot can be in; whatever is not named: 0..LARGE. firmware/host/world_parameters.cpp has the same.
_SMALL, LARGE = 1e-6, 1e6
_LINE_END = re.compile(r"\r\n|\r|\n")
_LINE = re.compile(r"(?P<name>[^=#][^=]*)=(?P<value>[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?)")
_BOUNDS = {
    "seed": (0.0, 4294967295.0),
    "track_m": (_SMALL, LARGE),
    "caster_trail_m": (_SMALL, LARGE),
    "caster_twist_rad": (-LARGE, LARGE),
    "pwm_bits": (1.0, 12.0),
    "battery_v": (0.0, 100.0),
    "rated_v": (1.0, 100.0),
    "full_speed_rad_s": (_SMALL, 1000.0),
    "dead_zone_pwm": (0.0, 4094.0),
    "rise_constant_s": (_SMALL, LARGE),
    "coast_constant_s": (_SMALL, LARGE),
    "brake_constant_s": (_SMALL, LARGE),
    "radius_m": (_SMALL, 10.0),
    "ticks_per_turn": (_SMALL, LARGE),
    "slip_accelerating_s2_m": (-LARGE, LARGE),
    "slip_braking_s2_m": (-LARGE, LARGE),
}


def bounds(name: str) -> tuple[float, float]:
    """The range of a parameter; a wheel's with or without its side."""
    return _BOUNDS.get(name.rpartition(".")[2], (0.0, LARGE))


def names() -> list[str]:
    """Of all parameters, in the order of the C++ struct."""
    return [*_own_names(), *(f"{side}.{name}" for side, name in _wheel_names())]


def read(text: str) -> WorldParameters:
    """A world from lines `name=value`, without spaces; empty lines and those that begin with # are ignored.

    Raises:
        ValueError: a line is not of this form, names no parameter, or is out of range; the text has its number.
    """
    world = WorldParameters()
    for number, line in enumerate(_LINE_END.split(text), start=1):
        if not line or line.startswith("#"):
            continue
        found = _LINE.fullmatch(line)
        if found is None:
            raise ValueError(f"line {number}: {line!r} is not of the form name=number")
        try:
            world = world.changed({found["name"]: float(found["value"])})
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from None
    return world


def _own_names() -> Iterator[str]:
    return (item.name for item in fields(WorldParameters) if item.name not in ("left", "right"))


def _wheel_names() -> list[tuple[str, str]]:
    return [(side, item.name) for side in ("left", "right") for item in fields(WheelParameters)]


def _changed(wheel: WheelParameters, values: Mapping[str, float], prefix: str) -> WheelParameters:
    own = {name.removeprefix(prefix): float(value) for name, value in values.items() if name.startswith(prefix)}
    return replace(wheel, **own)
