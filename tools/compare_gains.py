"""Compare PID gains on the firmware in simulated worlds: the paper's, and those of `hostlink step --tune`.

    .venv/bin/python tools/compare_gains.py

The same stages, identification and figures as the command's, in virtual time; docs/gains.md has the tables. The
overshoot is of the true speed, a hundred times a second: the robot's own messages are ten a second, and filtered.
"""

import argparse
import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hostlink.cli.step import PAPER_GAINS, Stage, draw_picture, make_stage, rising_stages
from hostlink.errors import HostlinkError
from hostlink.workbench.motor_model import MotorModel, PidGains, identify_motor, simc_gains
from hostlink.workbench.sim.firmware_module import WorldParameters, wheel
from hostlink.workbench.sim.firmware_world import Feedback, FirmwareWorld, Trace
from hostlink.workbench.step_response import Record, Sample, StepFigures, make_record, step_figures

SEPARATION_M = 0.21
BEFORE_S = 0.5
MESSAGE_S = 0.1
SAMPLE_S = 0.01
STEP_S = 6.0
SIDES = ("left", "right")
PAPER = WorldParameters()

Gains = Mapping[str, PidGains]


class Control(NamedTuple):
    """A way of control: gains for each world, and the firmware's feedback."""

    name: str
    gains: Sequence[Gains]
    feedback: Feedback


class Compared(NamedTuple):
    """One way of control, at one speed, in some worlds."""

    name: str
    speed_m_s: float
    figures: Sequence[StepFigures]
    overshoots_percent: Sequence[float]  # of the true speeds


class Driven(NamedTuple):
    """A drive from rest, by side."""

    records: dict[str, Record]  # what the robot says
    overshoots_percent: dict[str, float]  # of the true speed over the last set-point


def drawn_world(seed: int) -> WorldParameters:
    """Motors, load and battery as in docs/wheel-tests.md#what-the-tests-hold, of robots that reach 0.3 m/s."""
    random = np.random.default_rng(seed)

    def draw(low: float, high: float) -> float:
        return float(random.uniform(low, high))

    def draw_wheel(side: str) -> dict[str, float]:
        return wheel(
            side,
            full_speed_rad_s=PAPER["left.full_speed_rad_s"] * draw(0.97, 1.07),
            dead_zone_pwm=draw(0, 400),
            has_jump=float(random.integers(2)),
            rise_constant_s=draw(0.03, 0.2),
            coast_constant_s=draw(0.1, 1.0),
            friction_rad_s=PAPER["left.friction_rad_s"] * draw(0.2, 1.0),
        )

    own = {"seed": seed, "floor_pwm": draw(0, 100), "battery_v": draw(11.5, 13.0)}
    return WorldParameters({**own, **draw_wheel("left"), **draw_wheel("right")})


def drive(
    world: WorldParameters, gains: Gains, stages: Sequence[Stage], *, feedback: Feedback = Feedback.WASHED_OUT
) -> Driven:
    """A drive from rest: its plot_data, as the robot sends it, and what was true."""
    robot = FirmwareWorld(world, feedback=feedback)
    robot.connect()
    for side in SIDES:
        each = gains[side]
        robot.publish(f"pid_tune_{side[0]}", struct.pack("<3d", each.kp, each.ki, each.kd))
    robot.run(1.0)
    robot.forget()
    robot.run(BEFORE_S)
    for stage in stages:
        robot.drive(stage.linear_m_s, stage.angular_rad_s, stage.seconds, sample_s=SAMPLE_S)
    plots = [
        struct.unpack("<6d", frame.payload) for frame in robot.frames if frame.topic_id == robot.topics["plot_data"]
    ]
    times_s = [MESSAGE_S * number - BEFORE_S for number in range(len(plots))]
    records = {
        side: make_record("ticks/s", times_s, [Sample(row[3 + at], row[at], row[2 + 3 * at]) for row in plots])
        for at, side in enumerate(SIDES)
    }
    return Driven(records, {side: _overshoot_percent(robot.trace, side) for side in SIDES})


def _overshoot_percent(trace: Trace, side: str) -> float:
    wanted_ticks_s = trace[f"{side}_set_ticks_s"][-1]
    return max(0.0, 100.0 * float(np.max(trace[f"{side}_ticks_s"] / wanted_ticks_s) - 1.0))


def identify(world: WorldParameters, speed_m_s: float = 0.2) -> dict[str, MotorModel]:
    """The motors of a world, as `hostlink step --tune` finds them with the paper's gains."""
    records = drive(world, PAPER_GAINS, rising_stages(speed_m_s, None, SEPARATION_M)).records
    return {side: identify_motor(record) for side, record in records.items()}


def controls(worlds: Sequence[WorldParameters]) -> tuple[Control, ...]:
    """The paper's, the paper's gains in this firmware, and tuned ones."""
    tuned = [{side: simc_gains(model) for side, model in identify(world).items()} for world in worlds]
    papers = [PAPER_GAINS] * len(worlds)
    return (
        Control("table 1, the paper's feedback", papers, Feedback.PAPER),
        Control("table 1, washed-out feedback", papers, Feedback.WASHED_OUT),
        Control("tuned, washed-out feedback", tuned, Feedback.WASHED_OUT),
    )


def compare(worlds: Sequence[WorldParameters], speeds_m_s: Sequence[float]) -> Iterator[Compared]:
    """Three ways of control in the same worlds."""
    ways = controls(worlds)
    for speed_m_s in speeds_m_s:
        step = [make_stage(speed_m_s, STEP_S, None, SEPARATION_M)]
        for name, gains, feedback in ways:
            drives = [drive(world, each, step, feedback=feedback) for world, each in zip(worlds, gains, strict=True)]
            figures = [step_figures(record) for driven in drives for record in driven.records.values()]
            overshoots = [percent for driven in drives for percent in driven.overshoots_percent.values()]
            yield Compared(name, speed_m_s, figures, overshoots)


def draw(path: Path) -> None:
    """The left wheel of the paper's robot, a column for each way of control."""
    step = [make_stage(0.2, STEP_S, None, SEPARATION_M)]
    steps = {
        name: drive(PAPER, gains[0], step, feedback=feedback).records["left"]
        for name, gains, feedback in controls([PAPER])
    }
    draw_picture(path, "A step to 0.2 m/s, left wheel", steps)


def rows(compared: Iterator[Compared]) -> Iterator[str]:
    """A table for a document: the median, and the range of 90 %; of the overshoot the median and the worst."""
    names = (
        "m/s",
        "control",
        "rise, s",
        "behind, s",
        "overshoot, %",
        "settled, s",
        "steady error, %",
        "tracking, ticks/s",
    )
    yield f"| {' | '.join(names)} |"
    yield "|---" * len(names) + "|"
    for name, speed_m_s, figures, overshoots in compared:
        cells = (
            _spread([each.rise_s for each in figures], 2),
            _spread([each.lag_s for each in figures], 2),
            f"{np.median(overshoots):.1f}, worst {max(overshoots):.1f}",
            _spread([each.settling_s for each in figures], 1),
            _spread([each.steady_error_percent for each in figures], 1),
            _spread([each.tracking_error for each in figures], 1),
        )
        yield f"| {speed_m_s:.1f} | {name} | {' | '.join(cells)} |"


def _spread(values: Sequence[float | None], digits: int) -> str:
    """Return the median, and the range of 90 % of the values. An event that did not happen counts as later than all."""
    found = np.array([float("inf") if value is None else value for value in values])
    low, middle, high = (_number(value, digits) for value in np.quantile(found, (0.05, 0.5, 0.95), method="nearest"))
    return middle if low == high else f"{middle} ({low} to {high})"


def _number(value: float, digits: int) -> str:
    return "never" if value == float("inf") else f"{round(value, digits) + 0.0:.{digits}f}"  # no -0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=30, help="how many are drawn")
    parser.add_argument("--speed", type=float, nargs="*", default=[0.1, 0.2, 0.3], help="of the steps, m/s")
    parser.add_argument("--picture", type=Path, help="draw a step to 0.2 m/s into this file")
    arguments = parser.parse_args()
    if arguments.picture is not None:
        draw(arguments.picture)
    try:
        print("The paper's robot without a flaw:\n")
        for side, model in identify(PAPER).items():
            print(f"{side}: {model}; {simc_gains(model)}")
        print("", *rows(compare([PAPER], arguments.speed)), sep="\n")
        worlds = [drawn_world(seed) for seed in range(1, arguments.worlds + 1)]
        print(f"\n{arguments.worlds} worlds that are drawn (median, 5 to 95 %):\n")
        print(*rows(compare(worlds, arguments.speed)), sep="\n")
    except HostlinkError as error:
        raise SystemExit(f"compare_gains: {error}") from None


if __name__ == "__main__":
    main()
