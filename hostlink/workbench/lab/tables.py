"""Causes of odometry errors, one at a time, and tables 2-5 of the paper and of simulated robots."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hostlink.workbench.lab.experiment import (
    PAPER_CM,
    PAPER_WORLD,
    PATTERNS,
    Errors,
    Experiment,
    Habits,
    Laboratory,
    Pattern,
    Setup,
    Software,
    calibrated,
)
from hostlink.workbench.lab.robots import Mistakes, names
from hostlink.workbench.sim.firmware_module import WorldParameters

# -- causes -----------------------------------------------------------------------------------------------------------

RADIUS_M = 0.045
TRACK_M = 0.21

# Radius and caster that bring line and squares together closest to the paper: docs/laboratory.md#which-world
CASTER_WORLD = PAPER_WORLD.changed(
    {
        "left.radius_m": RADIUS_M * 1.005,
        "right.radius_m": RADIUS_M * 1.005,
        "caster_twist_rad": 0.055,
        "caster_random": 0.4,
    }
)


@dataclass(frozen=True, slots=True)
class Cause:
    """Difference between the robot and the software's assumptions."""

    name: str
    title: str
    values: tuple[tuple[str, float], ...] = ()  # numbers of the world
    mistake: str = ""  # mistake of the paper's software
    push_m: float = 0.0  # sideways push by hand

    def setup(self, software: Software) -> Setup:
        """Return a setup with this cause alone; the paper's software also has its mistakes.

        A mistake of the paper's software is tried twice: alone (column of the firmware), and with all mistakes but this
        one (column of the paper).
        """
        world = PAPER_WORLD.changed(dict(self.values))
        habits = Habits(push_m=self.push_m)
        if not self.mistake:
            return Setup(software=software, world=world, habits=habits)
        is_alone = software is Software.FIRMWARE
        made = (Mistakes.none() if is_alone else Mistakes()).changed(self.mistake, is_made=is_alone)
        return replace(Setup(software=Software.PAPER, world=world), mistakes=made)


def _both(name: str, value: float) -> tuple[tuple[str, float], ...]:
    return ((f"left.{name}", value), (f"right.{name}", value))


CAUSES = (
    Cause("none", "nothing"),
    Cause("radius", "both wheels 0.5 % larger", _both("radius_m", RADIUS_M * 1.005)),
    Cause("left_radius", "left wheel 0.5 % larger", (("left.radius_m", RADIUS_M * 1.005),)),
    Cause("track", "track 1 % wider", (("track_m", TRACK_M * 1.01),)),
    Cause("caster_twist", "caster twists 0.055 rad a turn", (("caster_twist_rad", 0.055),)),
    Cause("caster_random", "the same +-40 %", (("caster_twist_rad", 0.055), ("caster_random", 0.4))),
    Cause("caster_drag", "caster costs 200 of the PWM", (("caster_pwm", 200.0),)),
    Cause("slip_noise", "slip, 3 mm after 1 m", _both("slip_noise_m", 0.003)),
    Cause("slip_accelerating", "slip while speeding up, 1 % at 1 m/s2", _both("slip_accelerating_s2_m", 0.01)),
    Cause("slip_braking", "slide while braking, 1 % at 1 m/s2", _both("slip_braking_s2_m", 0.01)),
    Cause("carpet", "carpet, 200 of the PWM", (("floor_pwm", 200.0),)),
    Cause(
        "weak_motor", "left motor 10 % slower", (("left.full_speed_rad_s", 280.0 * 0.9 * 6.283185307179586 / 230.4),)
    ),
    Cause("battery", "battery at 10.5 V, sagging by 1 V", (("battery_v", 10.5), ("battery_sag_v", 1.0))),
    Cause("low_threshold", "motors turn from a PWM of 550", _both("dead_zone_pwm", 550.0)),
    Cause("high_threshold", "motors turn from a PWM of 690", _both("dead_zone_pwm", 690.0)),
    Cause("jump", "motors start with a jump at 350", (*_both("dead_zone_pwm", 350.0), *_both("has_jump", 1.0))),
    Cause("push", "pushed 5 cm by hand", push_m=0.05),
)
_TITLES = {
    "sign_by_direction_pin": "sign by the DIR pin",
    "drives_against": "torque against the set-point",
    "filtered_odometry": "odometry of the filtered speed",
    "rising_edges_only": "rising edges only",
    "slow_stop": "minimum-jerk stop, 3.6 s",
    "steady_feedback": "steady feedback term",
    "wrong_derivative": "derivative's sign",
    "wound_integral": "integral winds up",
    "single_precision_time": "single-precision time",
    "never_brakes": "never brakes",
}
MISTAKES = tuple(Cause(name, _TITLES[name], mistake=name) for name in names())


# -- tables -----------------------------------------------------------------------------------------------------------

_Array = NDArray[np.float64]

PAPER, REBUILT, OURS, CALIBRATED = "paper", "its software", "ours", "ours calibrated"


def tables(
    world: WorldParameters, laboratory: Laboratory, *, runs: int, report: Callable[[str], None]
) -> dict[Pattern, dict[str, _Array]]:
    """Drive all patterns with all software. Return the sizes of the errors in cm: by pattern and column, a row a run.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    report("calibrating")
    firmware = Setup(software=Software.FIRMWARE, world=world)
    setups = {
        REBUILT: replace(firmware, software=Software.PAPER),
        OURS: firmware,
        CALIBRATED: calibrated(firmware),
    }
    experiments = [Experiment(setup, pattern, runs) for pattern in PATTERNS for setup in setups.values()]
    measured = measure_all(laboratory, experiments, report)
    return {
        pattern: {PAPER: PAPER_CM[pattern.table], **{title: next(measured).sizes_cm for title in setups}}
        for pattern in PATTERNS
    }


def means_and_errors(sizes_cm: _Array) -> tuple[_Array, _Array]:
    """Return the means of the columns, as in the last line of the paper's table, and their standard errors."""
    return sizes_cm.mean(axis=0), sizes_cm.std(axis=0, ddof=1) / np.sqrt(len(sizes_cm))


def measure_all(
    laboratory: Laboratory, experiments: Sequence[Experiment], report: Callable[[str], None]
) -> Iterator[Errors]:
    """Yield the errors of each experiment, and report how many were driven."""
    for number, errors in enumerate(laboratory.measure(experiments), start=1):
        report(f"{number} of {len(experiments)} experiments driven")
        yield errors
