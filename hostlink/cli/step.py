"""`hostlink step`: drive a step of speed, show how the robot follows, tune its PID."""

import asyncio
import contextlib
import json as json_text
import math
import sys
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import Token, Url, not_empty
from hostlink.cli.connecting import ask, rosapi
from hostlink.cli.files import check_folder, check_picture
from hostlink.cli.output import show_progress, table, write, write_error
from hostlink.cli.robots import free_robot
from hostlink.client import DEFAULT_URL, PRIORITY, Host, Mailbox, Robot, RobotState
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import (
    ConfigError,
    HostlinkError,
    RefusalKind,
    Refused,
)
from hostlink.workbench.motor_model import MotorModel, PidGains, identify_motor, simc_gains
from hostlink.workbench.step_response import FULL_PWM, Record, Sample, StepFigures, make_record, step_figures

# -- step stages ------------------------------------------------------------------------------------------------------

FIRST_SHARE, LEVELS = 0.4, 6  # share of the speed at the first level; the last level has the whole speed
FIRST_LEVEL_S, LEVEL_S = 2.4, 1.2  # the first level begins with a stopped robot

TICK_S = 0.02
COMMAND_INTERVAL_S = 0.1  # a fifth of the lease
LONGEST_PAUSE_S = 0.4  # of this program; after the lease, 0.5 s, the robot has stopped
CREEP_M_S = 0.01  # a zero does not take a robot over from another driver
STANDING_S = 0.5
STOP_INTERVAL_S = 1.0
STANDING_TIMEOUT_S = 5.0

FIRST_MESSAGE_S = 2.0
SILENCE_S = 0.9  # without measurements the robot would drive blind
SEPARATION_M = 0.210  # docs/paper-robot.md#numbers

ODOMETRY_TYPE = "nav_msgs/Odometry"

DIGITS = 4

PAPER_GAINS = {"left": PidGains(23.0, 36.0, 0.1), "right": PidGains(24.0, 35.0, 0.1)}  # docs/paper-robot.md#numbers
GAINS = 3
RULE = "SIMC: S. Skogestad, J. Process Control 13 (2003) 291-309, tau_c = dead time"

STEP_S = 6.0


class Wheel(StrEnum):
    """Wheel that turns while the other one is stopped."""

    LEFT = "left"
    RIGHT = "right"


@dataclass(frozen=True, slots=True)
class Stage:
    """Velocity and its duration; `speed_m_s` is that of the wheels that turn."""

    speed_m_s: float
    linear_m_s: float
    angular_rad_s: float
    seconds: float


def make_stage(speed_m_s: float, seconds: float, wheel: Wheel | None, separation_m: float) -> Stage:
    """Build the stage of a speed: straight ahead, or one wheel round the other."""
    if wheel is None:
        return Stage(speed_m_s, speed_m_s, 0.0, seconds)
    turn = -1 if wheel is Wheel.LEFT else 1  # the left wheel alone turns the robot clockwise
    return Stage(speed_m_s, speed_m_s / 2, turn * speed_m_s / separation_m, seconds)


def rising_stages(speed_m_s: float, wheel: Wheel | None, separation_m: float) -> tuple[Stage, ...]:
    """Build rising steps. The robot never brakes between two messages, which would go unnoticed."""
    shares = [FIRST_SHARE + (1 - FIRST_SHARE) * level / (LEVELS - 1) for level in range(LEVELS)]
    lengths_s = [FIRST_LEVEL_S, *[LEVEL_S] * (LEVELS - 1)]
    return tuple(
        make_stage(share * speed_m_s, seconds, wheel, separation_m)
        for share, seconds in zip(shares, lengths_s, strict=True)
    )


def describe_way(robot: str, stages: Sequence[Stage], wheel: Wheel | None, separation_m: float) -> str:
    """Describe the drive, for the person who must make room."""
    way_m = sum(abs(stage.speed_m_s) * stage.seconds for stage in stages)
    seconds = sum(stage.seconds for stage in stages)
    speed_m_s = stages[-1].speed_m_s
    pace = f"at up to {abs(speed_m_s):.2f} m/s for {seconds:.1f} s"
    direction = "forwards" if speed_m_s > 0 else "backwards"
    if wheel is None:
        return f"{robot} drives {way_m:.2f} m straight {direction} {pace}; keep that way and half a metre more free"
    other = Wheel.RIGHT if wheel is Wheel.LEFT else Wheel.LEFT
    return (
        f"{robot}'s {wheel.value} wheel rolls {way_m:.2f} m {direction} round the {other.value} one {pace}; "
        f"keep a circle of {2 * separation_m + 0.5:.1f} m free"
    )


# -- step recorder ----------------------------------------------------------------------------------------------------

STANDING_TICKS_S, STANDING_M_S = 1.5, 0.005
LEAST_SEPARATION_M, MOST_SEPARATION_M = 0.02, 5.0  # limits of hostlink's firmware
PLOT_TYPE, GAINS_TYPE = "geometry_msgs/Twist", "geometry_msgs/Vector3"

Samples = Mapping[str, Sample]  # by wheel; "robot" if only the robot's speed is known
Reader = Callable[[Mapping[str, Any], Stage], Samples]


@dataclass(frozen=True, slots=True)
class Source:
    """Topic from which a robot's speeds are read."""

    topic: str
    type_name: str
    unit: str
    read: Reader
    standing: float  # in the unit; a lower speed counts as stopped


@dataclass(frozen=True, slots=True)
class StepRecording:
    """Speeds that were recorded during a step, and the velocity that the robot's limits accepted."""

    source: str
    records: Mapping[str, Record]
    accepted: tuple[float, float]  # m/s, rad/s of the last stage, within the limits of the robot


def find_topic(state: RobotState, links: Sequence[Mapping[str, Any]], leaf: str, type_name: str) -> str | None:
    """Find a topic of the robot's link by its last part; one in the robot's namespace takes precedence."""
    topics = [topic for link in links if link["number"] == state["link"] for topic in link["topics"]]
    names = [topic["name"] for topic in topics if topic["type"] == type_name]
    found = [name for name in names if name.rpartition("/")[2] == leaf]
    wanted = f"{state['velocity_topic'].rpartition('/')[0]}/{leaf}"
    return wanted if wanted in found else next(iter(found), None)


async def find_source(host: Host, state: RobotState, wheel: Wheel | None, separation_m: float) -> Source:
    """Choose the topic of the speeds: plot_data, else the odometry that the daemon publishes.

    Raises:
        HostlinkError: the robot has neither.
    """
    plot = find_topic(state, await host.links(), "plot_data", PLOT_TYPE)
    if plot is not None:
        return Source(plot, PLOT_TYPE, "ticks/s", _plot_reader(wheel), STANDING_TICKS_S)
    odometry = f"/{state['name']}/odom"
    if any(topic["name"] == odometry and topic["type"] == ODOMETRY_TYPE for topic in await host.topics()):
        return Source(odometry, ODOMETRY_TYPE, "m/s", _odometry_reader(wheel, separation_m), STANDING_M_S)
    raise HostlinkError(
        f"{state['name']} publishes neither plot_data nor odometry, so its speed cannot be measured; "
        "`hostlink doctor` finds out why"
    )


def _plot_reader(wheel: Wheel | None) -> Reader:
    axes = {"left": "x", "right": "y"} if wheel is None else {wheel.value: "x" if wheel is Wheel.LEFT else "y"}
    pwm = {"left": "linear", "right": "angular"}

    def read(message: Mapping[str, Any], _: Stage) -> Samples:
        return {
            side: Sample(message["angular"][axis], message["linear"][axis], message[pwm[side]]["z"])
            for side, axis in axes.items()
        }

    return read


def _odometry_reader(wheel: Wheel | None, separation_m: float) -> Reader:
    side = 0.0 if wheel is None else separation_m / 2 * (-1 if wheel is Wheel.LEFT else 1)
    name = "robot" if wheel is None else wheel.value

    def read(message: Mapping[str, Any], stage: Stage) -> Samples:
        twist = message["twist"]["twist"]
        return {name: Sample(stage.speed_m_s, twist["linear"]["x"] + side * twist["angular"]["z"])}

    return read


class StepRecorder:
    """Drive and record of one robot. `record` always ends with a stop, unless another source drives the robot."""

    def __init__(self, host: Host, robot: Robot, source: Source, *, show: Callable[[str], None]) -> None:
        self._host, self._robot, self._source, self._show = host, robot, source, show
        self._arrivals_s: list[float] = []
        self._samples: list[Samples] = []
        self._is_measured = False  # whether a message has arrived
        self._has_commanded = False
        self._ran_at_s = 0.0
        self._commanded_at_s = -math.inf

    async def record(self, stages: Sequence[Stage]) -> StepRecording:
        """Wait until the robot is stopped, drive the stages, stop.

        Raises:
            HostlinkError: another source drives the robot, a command is refused, no speed is measured, the robot does
                not stop, or the connection is lost.
        """
        source = self._source
        async with self._host.subscribe(source.topic, type_name=source.type_name) as messages, self._stopping():
            await self._stand(messages)
            began_s = loop_time_s()
            for stage in stages:
                await self._drive(stage, messages)
            accepted = (await self._robot.state())["velocity"]
        names = self._samples[0]
        arrivals_s = [arrival_s - began_s for arrival_s in self._arrivals_s]
        return StepRecording(
            source.topic,
            {name: make_record(source.unit, arrivals_s, [each[name] for each in self._samples]) for name in names},
            (accepted["linear_m_s"], accepted["angular_rad_s"]),
        )

    @contextlib.asynccontextmanager
    async def _stopping(self) -> AsyncIterator[None]:
        try:
            yield
        finally:
            if self._may_move:
                with contextlib.suppress(HostlinkError):  # without a connection the daemon has stopped it
                    await self._robot.stop(wait_s=0.0)

    @property
    def _may_move(self) -> bool:
        """Whether the robot may move by a command of this program; a stop would also end another source's drive."""
        refusal = self._robot.refusal
        return self._has_commanded and (refusal is None or refusal.kind != RefusalKind.HELD)

    async def _stand(self, messages: Mailbox[dict[str, Any]]) -> None:
        """Stop the robot, and keep the last half second before the step."""
        began_s, stopped_s = loop_time_s(), -math.inf
        rest = Stage(0.0, 0.0, 0.0, 0.0)
        while not self._stands():
            if loop_time_s() >= stopped_s + STOP_INTERVAL_S:
                stopped_s = loop_time_s()
                await self._take_over()
            await asyncio.sleep(TICK_S)
            self._receive(messages, rest)
            if not self._is_measured and loop_time_s() > began_s + FIRST_MESSAGE_S:
                raise HostlinkError(
                    f"{self._source.topic} had no message in {FIRST_MESSAGE_S:g} s; `hostlink doctor` finds out why"
                )
            if loop_time_s() > began_s + STANDING_TIMEOUT_S:
                raise HostlinkError(
                    f"{self._robot.name} still moves {STANDING_TIMEOUT_S:g} s after the stop, and a step begins with a "
                    "stopped robot; lift its wheels or end what moves it"
                )

    async def _take_over(self) -> None:
        """Stop the robot, also when a source of lower priority drives it."""
        state = await free_robot(self._host, self._robot.name, below=PRIORITY)
        if state["holder"] is not None:
            self._has_commanded = True
            await self._robot.command(CREEP_M_S, 0.0)
        await self._robot.stop(wait_s=0.0)

    def _stands(self) -> bool:
        """Whether the robot is stopped for half a second; earlier samples are discarded."""
        moving = [
            number
            for number, samples in enumerate(self._samples)
            if any(abs(sample.measured) > self._source.standing for sample in samples.values())
        ]
        first = moving[-1] + 1 if moving else 0
        del self._arrivals_s[:first], self._samples[:first]
        return bool(self._arrivals_s) and self._arrivals_s[-1] - self._arrivals_s[0] >= STANDING_S

    async def _drive(self, stage: Stage, messages: Mailbox[dict[str, Any]]) -> None:
        end_s = loop_time_s() + stage.seconds
        self._ran_at_s, self._commanded_at_s = loop_time_s(), -math.inf
        self._show(f"driving at {stage.speed_m_s:.2f} m/s; Ctrl-C stops")
        while loop_time_s() < end_s:
            await self._command(stage)
            await asyncio.sleep(min(TICK_S, max(0.0, end_s - loop_time_s())))
            self._receive(messages, stage)
            if loop_time_s() > self._arrivals_s[-1] + SILENCE_S:
                raise HostlinkError(
                    f"{self._source.topic} had no message for {SILENCE_S:g} s; the robot was sent a stop"
                )

    async def _command(self, stage: Stage) -> None:
        now_s = loop_time_s()
        if now_s > self._ran_at_s + LONGEST_PAUSE_S:
            raise HostlinkError(
                f"this program was paused for {now_s - self._ran_at_s:.1f} s; the robot was sent a stop"
            )
        self._ran_at_s = now_s
        refusal = self._robot.refusal
        if refusal is not None:
            raise Refused(refusal.kind, refusal.reason)
        if now_s >= self._commanded_at_s + COMMAND_INTERVAL_S:
            self._has_commanded, self._commanded_at_s = True, now_s
            await self._robot.command(stage.linear_m_s, stage.angular_rad_s)

    def _receive(self, messages: Mailbox[dict[str, Any]], stage: Stage) -> None:
        for message in messages.pop_all():
            self._is_measured = True
            self._arrivals_s.append(loop_time_s())
            self._samples.append(self._source.read(message, stage))


async def wheel_parameter(host: Host, robot: str, leaf: str) -> list[float]:
    """Return the numbers of a parameter of the robot; empty if the daemon's configuration does not set it.

    Raises:
        HostlinkError: the daemon is not connected.
    """
    text = await rosapi(host, "get_param", "value", name=f"/{robot}/{leaf}", default="")
    with contextlib.suppress(ValueError):  # it is not set, or has another type
        return [float(word) for word in str(text).strip("[] ").split(",")]
    return []


async def separation_of(host: Host, robot: str) -> float:
    """Return the wheel separation: the parameter unless the firmware refuses it, else the setting, else the paper's.

    Raises:
        HostlinkError: the daemon is not connected, or the robot is unknown.
    """
    parameter = await wheel_parameter(host, robot, "wheel_separation")
    if parameter and LEAST_SEPARATION_M <= parameter[0] <= MOST_SEPARATION_M:
        return parameter[0]
    return (await host.robot(robot).state()).get("wheel_separation_m") or SEPARATION_M


# -- step picture -----------------------------------------------------------------------------------------------------

_WIDTH_IN, _HEIGHT_IN = 9.0, 5.5
_SET_POINT, _MEASURED, _PWM = "#888888", "#0b6bcb", "#c25e00"


def draw_picture(path: Path, title: str, records: Mapping[str, Record]) -> None:
    """Write a picture with a column for each wheel."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra, whose import takes a second

    figure = Figure(figsize=(_WIDTH_IN, _HEIGHT_IN), layout="constrained")
    figure.suptitle(title)
    has_pwm = any(record.pwm is not None for record in records.values())
    rows = 2 if has_pwm else 1
    axes = figure.subplots(rows, len(records), sharex=True, sharey="row", squeeze=False)
    for column, (name, record) in enumerate(records.items()):
        speeds = axes[0][column]
        speeds.set_title(name)
        speeds.plot(record.t_s, record.set_point, color=_SET_POINT, linestyle="--", label="set-point")
        speeds.plot(record.t_s, record.measured, color=_MEASURED, label="measured")
        if record.pwm is not None:
            axes[1][column].plot(record.t_s, record.pwm, color=_PWM, drawstyle="steps-post", label="PWM")
        axes[-1][column].set_xlabel("time since the first command, s")
        for row in axes:
            row[column].grid(visible=True, alpha=0.3)
    axes[0][0].set_ylabel(f"speed, {next(iter(records.values())).unit}")
    axes[0][0].legend(loc="lower right")
    if has_pwm:
        axes[1][0].set_ylabel("PWM, counts")
    figure.savefig(path, dpi=120)


# -- step report ------------------------------------------------------------------------------------------------------


def step_lines(figures: Mapping[str, StepFigures], units: Mapping[str, str]) -> list[str]:
    """Table of the figures, with a column for each wheel."""
    unit = next(iter(units.values()))
    rows = [
        ["set-point", *(f"{each.target:.4g} {unit}" for each in figures.values())],
        ["rise time (10 to 90 %)", *(_seconds(each.rise_s) for each in figures.values())],
        ["  of the set-point", *(_seconds(each.set_point_rise_s) for each in figures.values())],
        ["behind the set-point", *(_seconds(each.lag_s) for each in figures.values())],
        ["dead time", *(_seconds(each.dead_s) for each in figures.values())],
        ["overshoot", *(f"{each.overshoot_percent:.1f} %" for each in figures.values())],
        ["settled (within 5 %)", *(_seconds(each.settling_s) for each in figures.values())],
        ["steady error", *(f"{each.steady_error_percent:+.1f} %" for each in figures.values())],
        ["tracking error", *(f"{each.tracking_error:.3g} {unit}" for each in figures.values())],
        ["full PWM", *(_percent(each.saturated_percent) for each in figures.values())],
    ]
    return table(["", *figures], rows)


def record_views(records: Mapping[str, Record], figures: Mapping[str, StepFigures]) -> dict[str, Any]:
    """Return figures and samples by wheel."""
    return {
        side: {"figures": rounded(asdict(each)), "samples": sample_view(records[side])}
        for side, each in figures.items()
    }


def sample_view(record: Record) -> dict[str, Any]:
    """Return a record as lists."""
    return {
        "unit": record.unit,
        "t_s": [round(float(value), DIGITS) for value in record.t_s],
        "set_point": [round(float(value), DIGITS) for value in record.set_point],
        "measured": [round(float(value), DIGITS) for value in record.measured],
        "pwm": None if record.pwm is None else [round(float(value)) for value in record.pwm],
    }


def rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    """Round numbers to the digits that are significant."""
    return {name: round(value, DIGITS) if isinstance(value, float) else value for name, value in values.items()}


def notes_of(stage: Stage, accepted: tuple[float, float], records: Mapping[str, Record]) -> list[str]:
    """Return notes on what distorts the figures of a drive."""
    notes = []
    wanted = (stage.linear_m_s, stage.angular_rad_s)
    if not all(
        math.isclose(one, other, rel_tol=0.001, abs_tol=0.0005) for one, other in zip(wanted, accepted, strict=True)
    ):
        notes.append(
            f"the robot's limits reduced {wanted[0]:.3f} m/s, {wanted[1]:.3f} rad/s "
            f"to {accepted[0]:.3f} m/s, {accepted[1]:.3f} rad/s"
        )
    if any(record.is_set_point_changing for record in records.values()):
        notes.append("the set-point was still changing at the end; use more --seconds")
    return notes


def _seconds(value: float | None) -> str:
    return "not reached" if value is None else f"{value:.2f} s"


def _percent(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.0f} % of the time"


# -- step tuning ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TunedWheel:
    """Model of one motor, and its gains."""

    model: MotorModel
    present: PidGains
    is_configured: bool  # whether `present` is from the configuration, else from the firmware
    proposed: PidGains


@dataclass(frozen=True, slots=True)
class Tuning:
    """Result of tuning a robot."""

    robot: str
    wheels: Mapping[str, TunedWheel]
    is_sent: bool

    def lines(self) -> list[str]:
        """Lines of the report."""
        rows = [
            row
            for side, wheel in self.wheels.items()
            for row in (
                [side, "present", *_digits(wheel.present), _origin(wheel)],
                ["", "proposed", *_digits(wheel.proposed), ""],
            )
        ]
        settings = [
            f'  "/{self.robot}/gains_{side}" = {[float(word) for word in _digits(wheel.proposed)]}'
            for side, wheel in self.wheels.items()
        ]
        return [
            *(f"{side} motor: {wheel.model}" for side, wheel in self.wheels.items()),
            *table(["", "", "Kp", "Ki", "Kd", ""], rows),
            f"rule: {RULE}",
            "",
            "sent to the robot, which keeps them until it is switched off"
            if self.is_sent
            else "not sent; --send sends them",
            "to keep them, write under [parameters] of the daemon's configuration:",
            *settings,
        ]

    def view(self, records: Mapping[str, Record]) -> dict[str, Any]:
        """Return the result as a JSON object."""
        return {
            "rule": RULE,
            "is_sent": self.is_sent,
            "wheels": {
                side: {
                    "model": rounded(asdict(wheel.model)),
                    "present": asdict(wheel.present) | {"is_configured": wheel.is_configured},
                    "proposed": rounded(asdict(wheel.proposed)),
                    "samples": sample_view(records[side]),
                }
                for side, wheel in self.wheels.items()
            },
        }


async def tune_motors(host: Host, robot: str, records: Mapping[str, Record], *, sends: bool) -> Tuning:
    """Identify each motor; with `sends`, send the gains.

    Raises:
        HostlinkError: a motor was not identified, the robot accepts no gains, or the daemon is not connected.
    """
    wheels = {}
    for side, record in records.items():
        model = identify_motor(record)
        configured = await wheel_parameter(host, robot, f"gains_{side}")
        is_configured = len(configured) == GAINS
        present = PidGains(*configured) if is_configured else PAPER_GAINS[side]
        wheels[side] = TunedWheel(model, present, is_configured, simc_gains(model))
    if sends:
        await _send(host, robot, wheels)
    return Tuning(robot, wheels, sends)


async def _send(host: Host, robot: str, wheels: Mapping[str, TunedWheel]) -> None:
    state, links = await host.robot(robot).state(), await host.links()
    found = {side: find_topic(state, links, f"pid_tune_{side[0]}", GAINS_TYPE) for side in wheels}
    for side, topic in found.items():
        if topic is None:
            raise HostlinkError(
                f"{robot} accepts no gains, because it does not subscribe to pid_tune_{side[0]} of {GAINS_TYPE}; "
                "leave out --send"
            )
    for side, topic in found.items():
        gains = wheels[side].proposed
        await host.publish(str(topic), {"x": gains.kp, "y": gains.ki, "z": gains.kd}, type_name=GAINS_TYPE)
    await host.settle()


def _digits(gains: PidGains) -> list[str]:
    return [f"{gains.kp:.1f}", f"{gains.ki:.1f}", f"{gains.kd:.1f}"]


def _origin(wheel: TunedWheel) -> str:
    return "of the configuration" if wheel.is_configured else "of the firmware (the paper's table 1)"


# -- step -------------------------------------------------------------------------------------------------------------

LEAST_SPEED_M_S, MOST_SPEED_M_S = 0.02, 2.0


def command(
    robot: Annotated[str, typer.Argument(help="Name of the robot.", callback=not_empty)],
    *,
    speed: Annotated[
        float, typer.Option(help="Speed of the wheels, m/s, for the range in which you drive; below zero: backwards.")
    ] = 0.2,
    wheel: Annotated[
        Wheel | None,
        typer.Option(help="Turn this wheel only, to compare the two motors.", show_default="both, straight ahead"),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            min=2.0, max=60.0, help="Duration of the step, s: longer for a slow robot.", show_default=f"{STEP_S:g}"
        ),
    ] = None,
    tune: Annotated[
        bool, typer.Option("--tune", help="Identify the motors by rising steps, and compute PID gains.")
    ] = False,
    send: Annotated[
        bool, typer.Option("--send", help="With --tune: send the gains to the robot, to try them at once.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Do not ask whether there is room, for scripts.")] = False,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the speeds into this file, for a report: .png, .svg or .pdf.")
    ] = None,
    full_pwm: Annotated[
        float,
        typer.Option(min=1.0, help="PWM of full power, if the robot's differs: saturation is measured against it."),
    ] = FULL_PWM,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON, for programs; needs --yes.")] = False,
) -> None:
    """Drive a step of speed, and show how the robot follows it. The robot moves; the distance is shown first.

    Shows rise time, overshoot, settling time, steady error, dead time and saturation of each wheel, from the robot's
    plot_data, or without it from odometry. Ctrl-C stops the robot at once.
    """
    if not LEAST_SPEED_M_S <= abs(speed) <= MOST_SPEED_M_S:
        raise ConfigError(
            "--speed", f"{speed:g} m/s is outside {LEAST_SPEED_M_S:g} to {MOST_SPEED_M_S:g} m/s, forwards or backwards"
        )
    if send and not tune:
        raise ConfigError("--send", "sends the gains that --tune computes; add --tune")
    if tune and seconds is not None:
        raise ConfigError(
            "--seconds", "cannot be combined with --tune, which drives rising steps of fixed durations; leave it out"
        )
    if not yes and (json or not sys.stdin.isatty()):
        raise ConfigError(
            "--yes", "the robot will move, and this command cannot ask whether there is room; add --yes if there is"
        )
    if picture is not None:
        check_picture("--picture", picture, needs="--picture", extra="pictures")
        check_folder("--picture", picture)

    def stages_of(separation_m: float) -> tuple[Stage, ...]:
        if tune:
            return rising_stages(speed, wheel, separation_m)
        return (make_stage(speed, STEP_S if seconds is None else seconds, wheel, separation_m),)

    # The connection is closed while the person reads.
    way = ask(url, token, lambda host: _describe(host, robot, wheel, stages_of))
    if not json:
        write_error(f"{way}.")
    if not yes:
        typer.confirm("Is there room?", abort=True, err=True)
    recording, notes = ask(url, token, lambda host: _step(host, robot, wheel, stages_of))
    records, name = recording.records, robot.strip("/")
    if picture is not None:
        notes += _draw(picture, f"{name}: {'rising steps' if tune else 'step'} to {speed:g} m/s", records)
    if tune:
        tuned = ask(url, token, lambda host: tune_motors(host, name, records, sends=send))
        lines, results = tuned.lines(), tuned.view(records)
    else:
        figures = {side: step_figures(record, full_pwm=full_pwm) for side, record in records.items()}
        lines = step_lines(figures, {side: record.unit for side, record in records.items()})
        results = {"wheels": record_views(records, figures)}
    if json:
        view = {"robot": name, "source": recording.source, "speed_m_s": speed, "notes": notes}
        write(json_text.dumps(view | results))
    else:
        write(*lines, *(f"note: {note}" for note in notes))


async def _prepared(host: Host, name: str, wheel: Wheel | None) -> tuple[Robot, Source, float]:
    """Return a robot that may be driven, the source of its speeds, and its wheel separation in m."""
    state = await free_robot(host, name, below=PRIORITY)
    separation_m = await separation_of(host, state["name"])
    return host.robot(state["name"]), await find_source(host, state, wheel, separation_m), separation_m


async def _describe(host: Host, name: str, wheel: Wheel | None, stages_of: Callable[[float], tuple[Stage, ...]]) -> str:
    robot, _, separation_m = await _prepared(host, name, wheel)
    return describe_way(robot.name, stages_of(separation_m), wheel, separation_m)


async def _step(
    host: Host, name: str, wheel: Wheel | None, stages_of: Callable[[float], tuple[Stage, ...]]
) -> tuple[StepRecording, list[str]]:
    """Drive the stages. Return the recording, and notes on what distorts its figures."""
    robot, source, separation_m = await _prepared(host, name, wheel)
    stages = stages_of(separation_m)
    recording = await StepRecorder(host, robot, source, show=show_progress).record(stages)
    return recording, notes_of(stages[-1], recording.accepted, recording.records)


def _draw(picture: Path, title: str, records: Mapping[str, Record]) -> list[str]:
    """Draw the picture. A failure is a note, because the robot has driven for the figures."""
    try:
        draw_picture(picture, title, records)
    except OSError as error:
        return [f"the picture {picture} cannot be written: {error.strerror or error}"]
    return []
