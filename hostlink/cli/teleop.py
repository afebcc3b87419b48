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
from hostlink.cli.keys import Key, KeyReader
from hostlink.cli.terminal import Terminal, draw, key_terminal
from hostlink.client import DEFAULT_URL, Host, RobotState, connect
from hostlink.errors import ConfigError, HostlinkError, UnknownTopic

PRIORITY = 60  # a person at the keys comes before a program
TICK_S = 0.02
LOOK_INTERVAL_S = 0.2
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
                keyboard.driving.stop()  # what was held when the link went must not move the robot when it is back
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
    now_s = asyncio.get_running_loop().time
    driving = keyboard.driving
    state = await host.robot(name).state()
    look_at_s, refusal = 0.0, ""
    try:
        while not keyboard.is_done:
            if keyboard.take_stop():
                refusal = await _stop(host, name)
            if keyboard.wants_suspend:
                await _send(host, state["velocity_topic"], (0.0, 0.0))
                keyboard.suspend()
            velocity = driving.due(now_s())
            if velocity is not None:
                refusal = await _send(host, state["velocity_topic"], velocity)
            if now_s() >= look_at_s:
                look_at_s = now_s() + LOOK_INTERVAL_S
                state = await host.robot(name).state()
                draw(_screen(state, driving, now_s(), keys, refusal))
            await keyboard.wait(TICK_S)
    finally:
        driving.stop()
        with contextlib.suppress(HostlinkError):  # with the connection gone the daemon stops the robot
            while (velocity := driving.due(now_s())) is not None or driving.is_ending:
                if velocity is not None:
                    await _send(host, state["velocity_topic"], velocity)
                await asyncio.sleep(TICK_S)


async def _stop(host: Host, name: str) -> str:
    """Stop the robot; returns why that was refused, or an empty text. A lost connection shows by the next request."""
    try:
        await host.robot(name).stop()
    except HostlinkError as error:
        return str(error)
    return ""


async def _send(host: Host, topic: str, velocity: tuple[float, float]) -> str:
    """Send a velocity; returns why the one before was refused, or an empty text."""
    linear_m_s, angular_rad_s = velocity
    message = {"linear": {"x": linear_m_s}, "angular": {"z": angular_rad_s}}
    refusal = host.take_refusal(topic)
    await host.publish(topic, message, type_name="geometry_msgs/Twist", priority=PRIORITY)
    return refusal


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
    """Keys and signals of the terminal, told to a Driving as they come."""

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

    def take_stop(self) -> bool:
        """Whether a stop key was pressed since the last call."""
        wanted, self._wants_stop = self._wants_stop, False
        return wanted

    def suspend(self) -> None:
        """Ctrl-Z: the shell gets its terminal back until it is told to go on."""
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
            self._take(key)
        self._news.set()

    def _take(self, key: Key) -> None:
        if key.name in QUIT_KEYS:
            self._quit()
        elif key.name == "ctrl-z":
            self._want_suspend()
        else:
            self._wants_stop |= key.name in STOP_KEYS
            self.driving.take(key, asyncio.get_running_loop().time())

    def _quit(self) -> None:
        self.driving.stop()
        self.is_done = True
        self._news.set()

    def _want_suspend(self) -> None:
        self.driving.stop()
        self.wants_suspend = True
        self._news.set()
