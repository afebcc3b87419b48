"""`hostlink teleop`: drive a robot with the keyboard. On every way out the robot stops."""

import asyncio
import contextlib
import math
import os
import signal
from typing import Annotated

import typer

from hostlink.cli.arguments import Token, Url
from hostlink.cli.driving import LAYOUTS, Driving
from hostlink.cli.key_driver import TICK_S, KeyDriver, watched_robot
from hostlink.cli.keys import Key, KeyReader
from hostlink.cli.terminal import Terminal, draw, key_terminal
from hostlink.client import DEFAULT_URL, Host, RobotState, connect
from hostlink.errors import ConfigError, HostlinkError, UnknownTopic

PRIORITY = 60  # a person at the keys comes before a program
DRAW_INTERVAL_S = 0.2
RETRY_S = 1.0
STOP_KEYS = ("space", "k", "s")
QUIT_KEYS = ("ctrl-c", "ctrl-d")
QUIT_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

MAPS = {
    "original": [
        "   q  w  e        u* i  o        t/b  both speeds up/down",
        "   a  s  d        j  k  l        y/n  forward speed up/down",
        "   z  x  c        m* ,  .        u/m  turning speed up/down   (* not for driving)",
    ],
    "twist": [
        "   u  i  o                       q/z  both speeds up/down",
        "   j  k  l                       w/x  forward speed up/down",
        "   m  ,  .                       e/c  turning speed up/down",
    ],
}


def command(
    robot: Annotated[
        str | None, typer.Argument(help="Its name; the only one that is connected.", show_default=False)
    ] = None,
    *,
    url: Url = DEFAULT_URL,
    token: Token = None,
    layout: Annotated[
        str, typer.Option(help="original (q w e / a d / z x c) or twist (u i o / j l / m , .).")
    ] = "original",
    linear: Annotated[float, typer.Option(min=0.01, max=1.0, help="Forward speed to begin with, m/s.")] = 0.2,
    angular: Annotated[float, typer.Option(min=0.05, max=4.0, help="Turning speed to begin with, rad/s.")] = 0.8,
) -> None:
    """Drive a robot with the keyboard: it moves while a key is held, and stops when none is."""
    if layout not in LAYOUTS:
        raise ConfigError("--layout", f"{layout} is none of {', '.join(LAYOUTS)}")
    driving = Driving(layout=layout, linear_m_s=linear, angular_rad_s=angular)
    asyncio.run(_teleop(url, token, robot, driving, MAPS[layout]))


async def _teleop(url: str, token: str | None, name: str | None, driving: Driving, keys: list[str]) -> None:
    async with connect(url, token=token, reconnect=False) as host:
        found = await _choose(host, name)
    with key_terminal() as terminal, _Keyboard(terminal, driving) as keyboard:
        while not keyboard.is_done:
            try:
                async with connect(url, token=token, reconnect=False) as host:
                    await _drive(host, found, keyboard, keys)
            except HostlinkError as lost:
                keyboard.driving.bar(_now_s())  # what is held must not move the robot when the connection is back
                draw([f"{found}: {lost}", "", "the robot stops by itself; trying again, Ctrl-C ends"])
                await keyboard.wait(RETRY_S)


async def _choose(host: Host, name: str | None) -> str:
    robots = await host.robots()
    names = tuple(robot["name"] for robot in robots)
    if name is None:
        connected = [robot["name"] for robot in robots if robot["connected"]]
        if len(connected) != 1:
            listed = ", ".join(names) or "none yet"
            raise HostlinkError(f"which robot? say `hostlink teleop NAME`; there are: {listed}")
        return str(connected[0])
    if name.strip("/") not in names:
        raise UnknownTopic("robot", name, names)
    return name.strip("/")


async def _drive(host: Host, name: str, keyboard: "_Keyboard", keys: list[str]) -> None:
    robot, driving = host.robot(name, priority=PRIORITY), keyboard.driving
    draw_at_s = 0.0
    async with watched_robot(host, await robot.state()) as watched:
        driver = KeyDriver(robot, driving, watched)
        try:
            while not keyboard.is_done:
                await _obey(keyboard, driver)
                if _now_s() >= draw_at_s:
                    draw_at_s = _now_s() + DRAW_INTERVAL_S
                    draw(_screen(watched.state, driving, _now_s(), keys, driver.refusal))
                await keyboard.wait(TICK_S)
        finally:
            driving.stop()
            with contextlib.suppress(HostlinkError):  # with the connection gone the daemon stops the robot
                await driver.finish()


async def _obey(keyboard: "_Keyboard", driver: KeyDriver) -> None:
    if keyboard.pop_stop():
        await driver.stop()
    if keyboard.wants_suspend:
        await driver.send((0.0, 0.0))
        keyboard.suspend()
    await driver.send_what_is_due()


def _screen(state: RobotState, driving: Driving, now_s: float, keys: list[str], refusal: str) -> list[str]:
    linear_m_s, angular_rad_s = driving.velocity(now_s)
    odometry = state["odometry"]
    lines = [
        f"hostlink teleop   {state['name']}   {'connected' if state['connected'] else 'NOT CONNECTED'}",
        "",
        f"speeds    {driving.linear_m_s:5.2f} m/s  {driving.angular_rad_s:5.2f} rad/s",
        f"asked     {linear_m_s:+5.2f} m/s  {angular_rad_s:+5.2f} rad/s",
        "odometry  none yet",
        "",
        f"driven by {state['holder'] or 'nobody'}   {refusal}",
        "",
        *keys,
        "   arrows drive too; space, k or s stops; any other key stops; Ctrl-C ends",
    ]
    if odometry is not None:
        pose, twist = odometry["pose"], odometry["twist"]
        lines[4] = (
            f"odometry  {twist['linear_m_s']:+5.2f} m/s  {twist['angular_rad_s']:+5.2f} rad/s   "
            f"x {pose['x_m']:+7.3f} m  y {pose['y_m']:+7.3f} m  heading {math.degrees(pose['theta_rad']):+6.1f}°"
        )
        lines[5] = f"age       {odometry['age_s']:5.2f} s  at {odometry['rate_hz']:4.1f} Hz"
    return lines


class _Keyboard:
    """Keys and signals of the terminal, passed to a Driving as they come."""

    def __init__(self, terminal: Terminal, driving: Driving) -> None:
        self.driving = driving
        self.is_done = self.wants_suspend = False
        self._terminal = terminal
        self._reader = KeyReader()
        self._news = asyncio.Event()
        self._wants_stop = False

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

    def suspend(self) -> None:
        """Ctrl-Z: the shell gets its terminal back until it resumes this program."""
        self.wants_suspend = False
        self._terminal.leave()
        os.kill(os.getpid(), signal.SIGSTOP)
        self._terminal.enter()

    async def wait(self, timeout_s: float) -> None:
        """Wait for a key or a signal, not longer."""
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
        if key.name in QUIT_KEYS:
            self._quit()
        elif key.name == "ctrl-z":
            self._want_suspend()
        else:
            self._wants_stop |= key.name in STOP_KEYS
            self.driving.receive(key, _now_s())

    def _quit(self) -> None:
        self.driving.stop()
        self.is_done = True
        self._news.set()

    def _want_suspend(self) -> None:
        self.driving.stop()
        self.wants_suspend = True
        self._news.set()


def _now_s() -> float:
    return asyncio.get_running_loop().time()
