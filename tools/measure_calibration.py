#!/usr/bin/env python3
"""Calibrates the real firmware in its world, in virtual time: how far squares are off before and after.

The firmware drives two lines and squares both ways; their true ends are the tape measure. It is given the numbers that
follow, as parameters, and drives other squares: without noise, and with wheels that slip and a random caster.
"""

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hostlink.client.course import Leg, square, straight
from hostlink.workbench.calibration import MeasuredRun, Measurement, RunKind, WheelGeometry, calibrated, student_95
from hostlink.workbench.sim.firmware_module import WorldParameters
from hostlink.workbench.sim.firmware_world import FirmwareWorld, follow

SQUARES = 5  # each way, as UMBmark has them
SIDE_M, LENGTH_M = 2.0, 3.0
SLIP_M = 0.002  # of each wheel after a metre: a hard floor
TWIST_RAD, TWIST_SHARE = 0.055, 0.4  # docs/laboratory.md: a caster that explains the paper's squares
OTHER_SEED = 1000  # the squares after are not those before
NOMINAL = WheelGeometry()
WORLD = WorldParameters({"track_m": 0.2142, "left.radius_m": 0.0448, "right.radius_m": 0.0453})


class Errors(NamedTuple):
    """E_max,syst, metres: the farther of the two centres of the squares' ends."""

    before_m: float
    umbmark_m: float  # with UMBmark's numbers
    least_squares_m: float


class Interval(NamedTuple):
    """A mean and its 95 %."""

    low: float
    middle: float
    high: float


def noisy(seed: int) -> WorldParameters:
    """Return the robot on a floor where it slips, with a caster that twists it."""
    slip = {"left.slip_noise_m": SLIP_M, "right.slip_noise_m": SLIP_M}
    return WORLD.changed({"seed": seed, "caster_twist_rad": TWIST_RAD, "caster_random": TWIST_SHARE, **slip})


def errors_in(world: WorldParameters, squares_each_way: int = SQUARES) -> Errors:
    """Calibrate the robot of a world.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    robot = robot_in(world)
    runs = [*lines(robot), *squares(robot, squares_each_way)]
    found = calibrated(runs, NOMINAL)
    other = world.changed({"seed": world["seed"] + OTHER_SEED})
    after = [
        error_m(list(squares(robot_in(other, wheels), SQUARES))) for wheels in (found.umbmark_geometry, found.geometry)
    ]
    return Errors(error_m(runs), *after)


def robot_in(world: WorldParameters, wheels: WheelGeometry | None = None) -> FirmwareWorld:
    """The firmware, with these numbers as its parameters, or with its own."""
    parameters: dict[str, Sequence[float]] = {}
    if wheels is not None:
        parameters["wheel_radius"] = (wheels.left_radius_m, wheels.right_radius_m)
        parameters["wheel_separation"] = (wheels.separation_m,)
    robot = FirmwareWorld(world, device_parameters=parameters)
    robot.connect()
    return robot


def squares(robot: FirmwareWorld, count: int) -> Iterator[MeasuredRun]:
    """Driven one after the other."""
    for _ in range(count):
        yield drive(robot, RunKind.SQUARE_CW, square(SIDE_M, -1), SIDE_M)
        yield drive(robot, RunKind.SQUARE_CCW, square(SIDE_M, 1), SIDE_M)


def lines(robot: FirmwareWorld) -> Iterator[MeasuredRun]:
    """Two of them."""
    for _ in range(2):
        yield drive(robot, RunKind.STRAIGHT, straight(LENGTH_M), LENGTH_M)


def drive(robot: FirmwareWorld, kind: RunKind, legs: tuple[Leg, ...], size: float) -> MeasuredRun:
    """One course, measured exactly."""
    path, end = follow(robot, legs)
    robot.forget()
    return MeasuredRun(kind, size, path, Measurement(end.x_m, end.y_m))


def error_m(runs: Sequence[MeasuredRun]) -> float:
    """E_max,syst of what the firmware believed, by its own poses alone."""
    centres = []
    for kind in (RunKind.SQUARE_CW, RunKind.SQUARE_CCW):
        off = np.mean([_off(run) for run in runs if run.kind is kind], axis=0)
        centres.append(float(np.hypot(*off)))
    return max(centres)


def _off(run: MeasuredRun) -> tuple[float, float]:
    first, last = run.path[0], run.path[-1]
    cos, sin = math.cos(first.theta_rad), math.sin(first.theta_rad)
    dx_m, dy_m = last.x_m - first.x_m, last.y_m - first.y_m
    return run.measured.x_m - dx_m * cos - dy_m * sin, run.measured.y_m - dy_m * cos + dx_m * sin


def interval(values: Sequence[float]) -> Interval:
    """Return the mean and its 95 % interval."""
    middle = float(np.mean(values))
    half = student_95(max(len(values) - 1, 3)) * float(np.std(values, ddof=1)) / math.sqrt(len(values))
    return Interval(middle - half, middle, middle + half)


def gain(errors: Sequence[Errors], after: Callable[[Errors], float]) -> Interval:
    """Return the geometric mean of the factors by which the error is smaller, and its 95 % interval."""
    return Interval(
        *(math.exp(value) for value in interval([math.log(each.before_m / after(each)) for each in errors]))
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--squares", type=int, default=SQUARES, help="each way, to calibrate with")
    given = parser.parse_args()
    exact = errors_in(WORLD, given.squares)
    print(f"without noise: {_cm(exact.before_m)} before, {_cm(exact.umbmark_m)} by UMBmark's numbers", end="")
    print(f" (1/{exact.before_m / exact.umbmark_m:.0f}), {_cm(exact.least_squares_m)} by least squares", end="")
    print(f" (1/{exact.before_m / exact.least_squares_m:.0f})")
    errors = [errors_in(noisy(seed), given.squares) for seed in range(1, given.seeds + 1)]
    print(f"slip {SLIP_M * 1000:g} mm/m, caster {TWIST_RAD:g} rad +-{TWIST_SHARE:.0%}, {given.seeds} seeds:")
    for number, name in enumerate(("before", "UMBmark", "least squares")):
        low, middle, high = interval([each[number] for each in errors])
        print(f"  {name:14} {_cm(middle)}  (95 % {_cm(low)} .. {_cm(high)})")
        if number:
            low, middle, high = gain(errors, lambda each, at=number: each[at])
            worst = min(each.before_m / each[number] for each in errors)
            print(f"  {'':14} 1/{middle:.1f}  (95 % 1/{low:.1f} .. 1/{high:.1f}, the worst seed 1/{worst:.1f})")


def _cm(metres: float) -> str:
    return f"{metres * 100:.2f} cm"


if __name__ == "__main__":
    main()
