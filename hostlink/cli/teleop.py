"""`hostlink teleop`: drive a robot with the keyboard. The robot stops however this command ends."""

import asyncio
import atexit
import contextlib
import math
import os
import signal
import sys
import termios
import tty
from collections.abc import AsyncIterator, Iterator
from typing import Annotated

import typer

from hostlink.cli.arguments import Token, Url, not_empty, robot_names
from hostlink.cli.connecting import connected
from hostlink.cli.driving import STANDING, Confirmation, Driving, Key, KeyReader, Layout, Velocity
from hostlink.cli.output import draw, terminal_size, write_control
from hostlink.cli.robots import name_of
from hostlink.cli.teleop_screen import QUIT_KEY, UNLOCK_KEY, OwnState, lost_screen, screen
from hostlink.client import DEFAULT_URL, Event, Host, Refusal, Robot, RobotState, connect
from hostlink.client.views import Odometry, Twist
from hostlink.core.robot.kinematics import DRIVES, PlanarDrive
from hostlink.core.robot.standstill import DriveWatch, Speeds
from hostlink.core.runtime.cancellation import first_error, meanwhile
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import ConfigError, HostlinkError, RefusalKind, UnknownTopic

# -- terminal ---------------------------------------------------------------------------------------------------------

_HIDE_CURSOR, _SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"
_CLEAR = "\x1b[2J\x1b[H"

TICK_S = 0.02

PRIORITY = 60  # a person at the keys takes precedence over a program
DRAW_INTERVAL_S = 0.2
RETRY_S = 1.0
STOP_KEYS = ("space", "k", "s")
QUIT_KEYS = ("ctrl-c", "ctrl-d")
QUIT_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Terminal:
    """Terminal of standard input and output."""

    def __init__(self) -> None:
        self.input = sys.stdin.fileno()
        self._saved = termios.tcgetattr(self.input)

    def enter(self) -> None:
        """Switch to keys without echo and without line input; Ctrl-C and Ctrl-Z still send signals."""
        tty.setcbreak(self.input)
        write_control(_HIDE_CURSOR + KeyReader.ENTER + _CLEAR)

    def leave(self) -> None:
        """Restore the terminal; do nothing if it is closed."""
        with contextlib.suppress(OSError, termios.error, ValueError):
            termios.tcsetattr(self.input, termios.TCSADRAIN, self._saved)
            write_control(KeyReader.LEAVE + _SHOW_CURSOR + "\n")


@contextlib.contextmanager
def key_terminal() -> Iterator[Terminal]:
    """Switch the terminal to key mode for the length of the block. Standard input and output must be a terminal."""
    terminal = Terminal()
    atexit.register(terminal.leave)
    terminal.enter()
    try:
        yield terminal
    finally:
        terminal.leave()
        atexit.unregister(terminal.leave)


# -- commands for the robot -------------------------------------------------------------------------------------------


class WatchedRobot:
    """Robot's state as the daemon reports it."""

    def __init__(self, state: RobotState) -> None:
        self.state = state

    async def follow(self, events: AsyncIterator[Event]) -> None:
        """Update the state until the connection is lost.

        Raises:
            HostlinkError: the connection is lost.
            UnknownTopic: the daemon has forgotten the robot.
        """
        async for event in events:
            if event.name == "robots":
                states: dict[str, RobotState] = {robot["name"]: robot for robot in event.data["robots"]}
                if self.state["name"] not in states:
                    raise UnknownTopic("robot", self.state["name"], tuple(states))
                self.state = states[self.state["name"]]


@contextlib.asynccontextmanager
async def watched_robot(host: Host, state: RobotState) -> AsyncIterator["WatchedRobot"]:
    """Keep a robot's state up to date for the length of the block.

    Raises:
        HostlinkError: the connection is lost, which ends the block.
        UnknownTopic: the daemon has forgotten the robot, which ends the block.
    """
    watched = WatchedRobot(state)
    try:
        async with meanwhile(("watch", watched.follow(host.watch()))):
            yield watched
    except BaseExceptionGroup as group:
        raise first_error(group) from None


class KeyDriver:
    """Sender of the keys' velocity as commands."""

    def __init__(self, robot: Robot, driving: Driving, watched: WatchedRobot) -> None:
        self.refusal = ""
        self._robot, self._driving, self._watched = robot, driving, watched
        self._refused: Refusal | None = None
        self._is_moving = False

    async def send_due(self) -> None:
        """Send the velocity that is due.

        After a refusal the keys have no effect until they are released and pressed again; except while a driver of
        higher priority has the robot.
        """
        drive = DRIVES.get(
            self._watched.state.get("kinematics", ""), PlanarDrive
        )()  # of a newer daemon: may be another
        self._driving.has_y, self._driving.turns_in_place = drive.has_y, drive.turns_in_place
        refused, before = self._robot.refusal, self._refused
        self._refused = refused
        if refused is not None and refused is not before:  # another command was refused
            self.refusal = refused.reason
            if refused.kind != RefusalKind.HELD:
                self._driving.bar(loop_time_s())
        elif refused is None and self._is_moving:  # a velocity was accepted; a zero always is
            self.refusal = ""
        velocity = self._driving.due(loop_time_s())
        if velocity is not None:
            await self.send(velocity)

    async def send(self, velocity: Velocity) -> None:
        """Send one velocity."""
        self._is_moving = velocity != STANDING
        await self._robot.command(*velocity)

    async def stop(self) -> None:
        """Stop the robot, also when another source drives it. A lost connection is reported by the next command."""
        try:
            await self._robot.stop(wait_s=0.0)
            self.refusal = ""
        except HostlinkError as error:
            self.refusal = str(error)

    @property
    def lock(self) -> tuple[object, ...] | None:
        """Identity of the lock that the robot has: a new one has another; None without one."""
        state = self._watched.state
        return (state.get("epoch"), state.get("lock_reason")) if state.get("locked") else None

    async def unlock(self, lock: object) -> None:
        """End this lock, not a later one. Held keys have no effect until they are released and pressed again."""
        if lock is None or lock != self.lock:
            return
        self._driving.bar(loop_time_s())
        try:
            await self._robot.unlock()
            self.refusal = ""
        except HostlinkError as error:
            self.refusal = str(error)

    async def finish(self) -> None:
        """Send the remaining zeros at the end."""
        while (velocity := self._driving.due(loop_time_s())) is not None or self._driving.is_ending:
            if velocity is not None:
                await self.send(velocity)
            await asyncio.sleep(TICK_S)


# -- command ----------------------------------------------------------------------------------------------------------


def command(
    robot: Annotated[
        str | None,
        typer.Argument(
            help="Name of the robot; optional if only one is connected.", callback=not_empty, autocompletion=robot_names
        ),
    ] = None,
    *,
    url: Url = DEFAULT_URL,
    token: Token = None,
    layout: Annotated[
        Layout,
        typer.Option(help="Keys: original, or twist as in teleop_twist_keyboard."),
    ] = "original",
    linear: Annotated[
        float, typer.Option(min=0.01, max=1.0, help="Forward speed at the beginning, m/s: lower in a narrow room.")
    ] = 0.2,
    angular: Annotated[float, typer.Option(min=0.05, max=4.0, help="Turning speed at the beginning, rad/s.")] = 0.8,
) -> None:
    """Drive a robot with the keyboard: the robot moves while a key is held, and stops when no key is held.

    drive: the arrow keys; w e a d z x c; i j l o , .

    change both speeds: t b; the forward speed: y n; the turning speed: u m

    stop the robot, also when another program drives it: space, s, k

    sideways, if the robot can: shift with a key that turns; J L U O M < > as in teleop_twist_keyboard

    unlock a locked robot: r twice; let go: any other key; end: q, Ctrl-C

    With --layout twist: drive: the arrow keys; u i o j l m , .; end: Ctrl-C

    change both speeds: q z; the forward speed: w x; the turning speed: e c
    """
    driving = Driving(layout=layout, linear_m_s=linear, angular_rad_s=angular)
    asyncio.run(_teleop(url, token, robot, driving, layout))


async def _teleop(url: str, token: str | None, name: str | None, driving: Driving, layout: str) -> None:
    async with connected(url, token) as host:
        found = await name_of(host, name, example="hostlink teleop {}")
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise ConfigError(
            "teleop", "standard input or output is not a terminal; from a script, drive with `hostlink pub` or the API"
        )
    with key_terminal() as terminal, _Keyboard(terminal, driving) as keyboard:
        while not keyboard.is_done:
            try:
                async with connect(url, token=token, reconnect=False, name="teleop") as host:
                    await _drive(host, found, keyboard, layout)
            except HostlinkError as lost:
                keyboard.driving.bar(loop_time_s())  # held keys must not move the robot when the connection returns
                draw(lost_screen(found, str(lost), driving, width=terminal_size()[0] - 1))
                await keyboard.wait(RETRY_S)


async def _drive(host: Host, name: str, keyboard: "_Keyboard", layout: str) -> None:
    robot, driving = host.robot(name, priority=PRIORITY), keyboard.driving
    draw_at_s, watch = 0.0, DriveWatch()
    async with watched_robot(host, await robot.state()) as watched:
        driver = KeyDriver(robot, driving, watched)
        try:
            while not keyboard.is_done:
                keyboard.lock = driver.lock
                await _obey(keyboard, driver)
                if loop_time_s() >= draw_at_s:
                    draw_at_s = loop_time_s() + DRAW_INTERVAL_S
                    _observe(watch, watched.state)
                    own = OwnState(robot.client_name, driver.refusal, watch.warning, keyboard.asks_to_unlock)
                    draw(
                        screen(watched.state, driving, loop_time_s(), own, layout=layout, width=terminal_size()[0] - 1)
                    )
                await keyboard.wait(TICK_S)
        finally:
            keyboard.lock = keyboard.unlocks = None  # a press that was not obeyed must not unlock after the connection
            driving.stop()
            with contextlib.suppress(HostlinkError):  # with the connection gone the daemon stops the robot
                await driver.finish()


def _observe(watch: DriveWatch, state: RobotState) -> None:
    odometry = state["odometry"]
    measured = None if odometry is None else _measured(odometry)
    age_s = 0.0 if odometry is None else odometry["age_s"]
    watch.observe(_speeds(state["velocity"]), measured, loop_time_s(), age_s=age_s)


def _measured(odometry: Odometry) -> Speeds:
    twist = odometry["twist"]
    return Speeds(is_moving=odometry["is_moving"] is not False) if twist is None else _speeds(twist)


def _speeds(twist: Twist) -> Speeds:
    return Speeds(math.hypot(twist["linear_m_s"], twist.get("linear_y_m_s", 0.0)), twist["angular_rad_s"])


async def _obey(keyboard: "_Keyboard", driver: KeyDriver) -> None:
    if keyboard.pop_stop():
        await driver.stop()
    await driver.unlock(keyboard.pop_unlock())
    if keyboard.wants_suspend:
        await driver.send(STANDING)
        keyboard.suspend()
    await driver.send_due()


class _Keyboard:
    """Keys and signals of the terminal, passed to a Driving as they arrive."""

    def __init__(self, terminal: Terminal, driving: Driving) -> None:
        self.driving = driving
        self.lock: object = None  # of the robot, about which the unlock key asks
        self.unlocks: object = None  # lock that was confirmed to end
        self.is_done = self.wants_suspend = False
        self._terminal = terminal
        self._reader = KeyReader()
        self._news = asyncio.Event()
        self._wants_stop = False
        self._unlocking = Confirmation(UNLOCK_KEY)

    def __enter__(self) -> "_Keyboard":
        loop = asyncio.get_running_loop()
        loop.add_reader(self._terminal.input, self._read)
        for number in QUIT_SIGNALS:
            loop.add_signal_handler(number, self._quit)
        loop.add_signal_handler(signal.SIGTSTP, self._want_suspend)
        return self

    def __exit__(self, *_: object) -> None:
        loop = asyncio.get_running_loop()
        loop.remove_reader(self._terminal.input)
        for number in (*QUIT_SIGNALS, signal.SIGTSTP):
            loop.remove_signal_handler(number)

    def pop_stop(self) -> bool:
        """Whether a stop key was pressed since the last call."""
        wanted, self._wants_stop = self._wants_stop, False
        return wanted

    def pop_unlock(self) -> object:
        """Return the lock that the unlock key has confirmed to end since the last call; None without one."""
        wanted, self.unlocks = self.unlocks, None
        return wanted

    @property
    def asks_to_unlock(self) -> bool:
        """Whether the unlock key was pressed and has to be pressed again."""
        return self._unlocking.is_asking(self.lock, loop_time_s())

    def suspend(self) -> None:
        """Suspend this program as Ctrl-Z does; the shell has the terminal until it resumes this program."""
        self.wants_suspend = False
        self._terminal.leave()
        os.kill(os.getpid(), signal.SIGSTOP)
        self._terminal.enter()

    async def wait(self, timeout_s: float) -> None:
        """Wait for a key or a signal, at most `timeout_s` seconds."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                await self._news.wait()
        self._news.clear()

    def _read(self) -> None:
        try:
            data = os.read(self._terminal.input, 1024)
        except OSError:
            data = b""
        if not data:  # the terminal is closed
            asyncio.get_running_loop().remove_reader(self._terminal.input)
            self._quit()
        for key in self._reader.feed(data):
            self._receive(key)
        self._news.set()

    def _receive(self, key: Key) -> None:
        if key.name in QUIT_KEYS or (key == Key(QUIT_KEY) and not self.driving.has_meaning(QUIT_KEY)):
            self._quit()
        elif key.name == "ctrl-z":
            self._want_suspend()
        elif not self.is_done:  # a key that is still held must not drive after Ctrl-C
            self._wants_stop |= key.name in STOP_KEYS
            if self._unlocking.receive(key, loop_time_s(), self.lock):
                self.unlocks = self.lock
            self.driving.receive(key, loop_time_s())

    def _quit(self) -> None:
        self.driving.stop()
        self.is_done = True
        self._news.set()

    def _want_suspend(self) -> None:
        self.driving.stop()
        self.wants_suspend = True
        self._news.set()
