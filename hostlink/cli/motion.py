"""The commands move and turn: one motion of a robot by its odometry. The robot stops however the command ends."""

import asyncio
import json as json_text
import math
import re
from collections.abc import Callable, Coroutine
from dataclasses import asdict
from typing import Annotated, Any, NamedTuple

import typer

from hostlink.cli.arguments import Json, Token, Url, not_empty, robot_names
from hostlink.cli.connecting import connected
from hostlink.cli.output import show_progress, write, write_error
from hostlink.cli.quantities import metres, radians
from hostlink.cli.robots import free_robot, name_of
from hostlink.cli.teleop import QUIT_SIGNALS
from hostlink.client import DEFAULT_URL, Motion, MotionKind, Progress, Robot
from hostlink.errors import ConfigError, HostlinkError, RefusalKind

PRIORITY = 50  # of a program, as in the Python client
MOVE, TURN = "hostlink move {} 1", "hostlink turn {} 90deg"  # examples, with the place of the name
_SHOWN_S = 0.2  # between two lines of progress


# -- arguments -------------------------------------------------------------------------------------------------------


def named(robot: str, text: str | None, read: Callable[[str], float], example: str) -> tuple[str | None, float]:
    """Return the name, None if it was left out, and the amount of `ROBOT AMOUNT` or `AMOUNT`.

    Raises:
        ConfigError: the amount cannot be read, or is missing.
    """
    if text is not None:
        return robot, read(text)
    try:
        return None, read(robot)
    except ConfigError as error:
        if re.match(r"[-+.\d]", robot):
            raise
        raise ConfigError(
            error.where, f"is missing; write it behind the name, as in `{example.format(robot)}`"
        ) from error


class Way(NamedTuple):
    """Motion that was asked for: how far, and how its distances are written."""

    verb: str
    amount: float  # m or rad
    text: Callable[[float], str]

    def gone(self, seen: Motion | Progress) -> float:
        """Return how far the robot has come."""
        return (seen.distance_m if self.verb == "moved" else seen.turned_rad) or 0.0


def metres_text(amount: float) -> str:
    """Text of a distance."""
    return f"{amount:+.3f} m"


def degrees_text(amount: float) -> str:
    """Text of an angle."""
    return f"{math.degrees(amount):+.1f}°"


# -- commands ---------------------------------------------------------------------------------------------------------

Name = Annotated[
    str,
    typer.Argument(
        help="Name of the robot; optional if only one is connected.", callback=not_empty, autocompletion=robot_names
    ),
]
Timeout = Annotated[
    float | None,
    typer.Option(
        min=0.1, help="Longest duration of the motion, s.", show_default="10 s, and four times what the speed needs"
    ),
]


TakeOver = Annotated[
    bool, typer.Option("--take-over", help="Take the robot over from another program, which must let go of it then.")
]


def move(
    robot: Name,
    distance: Annotated[
        str | None, typer.Argument(help="How far: 1 (metres), 0.3m, 25cm; below zero: backwards.", show_default=False)
    ] = None,
    *,
    speed: Annotated[float, typer.Option(min=0.02, max=1.0, help="Speed, m/s: lower in a narrow room.")] = 0.2,
    timeout: Timeout = None,
    take_over: TakeOver = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """Move a robot along a line by its odometry, and stop it. Ctrl-C stops it at once.

    Exit status 1: something has stopped it earlier: an obstacle, a lock, another driver, the connection.
    """
    name, amount = named(robot, distance, metres, MOVE)
    way = Way("moved", amount, metres_text)

    def follow(found: Robot, show: Callable[[Progress], None]) -> Coroutine[Any, Any, Motion]:
        return found.move(way.amount, speed_m_s=speed, timeout_s=timeout, on_progress=show, take_over=take_over)

    _run(url, token, name, way, follow, example=MOVE, as_json=json, take_over=take_over)


def turn(
    robot: Name,
    angle: Annotated[
        str | None,
        typer.Argument(help="How far: 90deg, 1.57rad, 1turn; below zero: clockwise.", show_default=False),
    ] = None,
    *,
    speed: Annotated[float, typer.Option(min=0.05, max=4.0, help="Turning speed, rad/s.")] = 0.8,
    timeout: Timeout = None,
    take_over: TakeOver = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """Turn a robot on the spot by its odometry, and stop it. Ctrl-C stops it at once.

    Exit status 1: something has stopped it earlier: an obstacle, a lock, another driver, the connection.
    """
    name, amount = named(robot, angle, radians, TURN)
    way = Way("turned", amount, degrees_text)

    def follow(found: Robot, show: Callable[[Progress], None]) -> Coroutine[Any, Any, Motion]:
        return found.turn(way.amount, speed_rad_s=speed, timeout_s=timeout, on_progress=show, take_over=take_over)

    _run(url, token, name, way, follow, example=TURN, as_json=json, take_over=take_over)


Follow = Callable[[Robot, Callable[[Progress], None]], Coroutine[Any, Any, Motion]]


def _run(
    url: str,
    token: str | None,
    name: str | None,
    way: Way,
    follow: Follow,
    *,
    example: str,
    as_json: bool,
    take_over: bool,
) -> None:
    shown, below = Shown(way), PRIORITY + take_over
    try:
        asyncio.run(_cancelled_by_signals(_drive(url, token, name, shown, follow, example, below)))
    except asyncio.CancelledError:
        write_error(f"{shown.robot} was sent a stop, {shown.progress}")
        raise KeyboardInterrupt from None
    assert shown.motion is not None  # noqa: S101 - nothing was raised
    if as_json:
        write(json_text.dumps({"robot": shown.robot, **asdict(shown.motion)}))
    else:
        write(f"{shown.robot} {way.verb} {way.text(way.gone(shown.motion))} in {shown.motion.elapsed_s:.1f} s")
    if not shown.motion.is_reached:
        raise HostlinkError(broken_off(shown.robot, way, shown.motion))


async def _cancelled_by_signals(work: Coroutine[Any, Any, None]) -> None:
    """Await the coroutine. A signal cancels it, and a second one cancels what it does at its end."""
    loop, running = asyncio.get_running_loop(), asyncio.current_task()
    assert running is not None  # noqa: S101 - a task runs this
    for number in QUIT_SIGNALS:
        loop.add_signal_handler(number, running.cancel)
    await work


class Shown:
    """Progress line of a motion on the terminal, and its end."""

    def __init__(self, way: Way) -> None:
        self.robot = "the robot"
        self.motion: Motion | None = None
        self._way = way
        self._newest: Progress | None = None
        self._show_at_s = 0.0

    @property
    def progress(self) -> str:
        """Distance so far, as a part of a sentence."""
        gone = 0.0 if self._newest is None else self._way.gone(self._newest)
        return f"{self._way.text(gone)} of {self._way.text(self._way.amount)}"

    def show(self, progress: Progress) -> None:
        """Write the line, a few times a second."""
        self._newest = progress
        if progress.elapsed_s >= self._show_at_s:
            self._show_at_s = progress.elapsed_s + _SHOWN_S
            show_progress(f"{self.robot}: {self.progress}; Ctrl-C stops the robot")


async def _drive(
    url: str, token: str | None, name: str | None, shown: Shown, follow: Follow, example: str, below: int
) -> None:
    async with connected(url, token) as host:
        state = await free_robot(host, await name_of(host, name, example=example), below=below)
        shown.robot = state["name"]
        shown.motion = await follow(host.robot(state["name"], priority=PRIORITY), shown.show)


def broken_off(robot: str, way: Way, motion: Motion) -> str:
    """Return why a motion has not been completed, and the next step. Pure."""
    by = f", by {motion.by}" if motion.by and motion.by not in motion.reason else ""
    step = ""
    if motion.kind == RefusalKind.LOCKED:
        step = f"; to drive it again: hostlink unlock {robot}"
    elif motion.kind == RefusalKind.HELD:
        step = "; `hostlink robots` shows who drives"
    elif motion.kind == MotionKind.CONNECTION:
        step = "; the robot stops by itself; `hostlink robots` shows its speed when the daemon runs again"
    reason = f"{motion.reason}{by}{step}" if motion.reason or by else "the robot was stopped"
    return f"{robot}: {motion.outcome} before {way.text(way.amount)}: {reason}"
