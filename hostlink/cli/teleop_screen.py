"""Screen of teleop: lines of a state and a width, with the robot, the keys and warnings. Pure."""

import math
import textwrap
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from hostlink.cli.driving import Driving
from hostlink.cli.figures import speed_text
from hostlink.cli.names import driver
from hostlink.client import RobotState

GAP = 3  # spaces between two facts of a line, at which it may be broken
UNLOCK_KEY = "r"
QUIT_KEY = "q"  # in a layout in which it has no other meaning
RED, YELLOW = "31;1", "33;1"

MAPS = {
    "original": [
        ("   w  e        u* i  o", "t/b  both speeds up/down"),
        ("a  s  d        j  k  l", "y/n  forward speed up/down"),
        ("z  x  c        m* ,  .", "u/m  turning speed up/down   (* not for driving)"),
    ],
    "twist": [
        ("u  i  o", "q/z  both speeds up/down"),
        ("j  k  l", "w/x  forward speed up/down"),
        ("m  ,  .", "e/c  turning speed up/down"),
    ],
}
_MAP_WIDTH = 33


class Line(NamedTuple):
    """Line with its colour, as numbers of SGR."""

    text: str
    colour: str = ""


class OwnState(NamedTuple):
    """State of this program: its name at the daemon, the last refusal, a warning, and whether it asks to unlock."""

    client_name: str | None = None
    refusal: str = ""
    warning: str = ""
    asks_to_unlock: bool = False


def screen(state: RobotState, driving: Driving, now_s: float, own: OwnState, *, layout: str, width: int) -> list[Line]:
    """Return the lines of the screen, none wider than the terminal."""
    lines = [*_facts(state, driving, now_s, own), Line(""), *_keys(layout, width)]
    lines.append(
        Line(f"arrows drive too; space, k or s stops the robot; any other key lets go; {ending(driving)} ends")
    )
    if driving.has_y:
        lines.insert(-1, Line("shift with a key that turns: sideways"))
    return [Line(part, line.colour) for line in lines for part in folded(line.text, width)]


def ending(driving: Driving) -> str:
    """Names of the keys that end teleop. A layout in which q has another meaning has only Ctrl-C."""
    return "Ctrl-C" if driving.has_meaning(QUIT_KEY) else f"{QUIT_KEY} or Ctrl-C"


def lost_screen(name: str, reason: str, driving: Driving, *, width: int) -> list[Line]:
    """Return the lines of the screen while the connection is lost."""
    lines = [Line(f"{name}: {reason}", RED), Line(f"the robot stops by itself; trying again, {ending(driving)} ends")]
    return [Line(part, line.colour) for line in lines for part in folded(line.text, width)]


def _facts(state: RobotState, driving: Driving, now_s: float, own: OwnState) -> Iterator[Line]:
    linear_m_s, angular_rad_s, left_m_s = driving.velocity(now_s)
    is_connected = state["connected"]
    connected = "connected" if is_connected else "NOT CONNECTED"
    yield Line(f"hostlink teleop   {state['name']}   {connected}", "" if is_connected else RED)
    if state.get("locked"):
        step = f"REALLY UNLOCK? {UNLOCK_KEY} again does it" if own.asks_to_unlock else f"{UNLOCK_KEY} twice unlocks it"
        yield Line(f"LOCKED: {state.get('lock_reason')}   {step}", RED)
    else:
        yield Line(own.warning, YELLOW)
    yield Line(f"speeds    {driving.linear_m_s:5.2f} m/s  {driving.angular_rad_s:5.2f} rad/s")
    sideways = f"  {left_m_s:+5.2f} m/s to the left" if left_m_s else ""
    yield Line(f"command   {linear_m_s:+5.2f} m/s  {angular_rad_s:+5.2f} rad/s{sideways}")
    yield from _odometry(state)
    why = "" if state.get("locked") else own.refusal
    yield Line(f"driven by {driver(state, own.client_name) or 'nobody'}   {why}".rstrip(), YELLOW if why else "")


def _odometry(state: RobotState) -> Iterator[Line]:
    odometry = state["odometry"]
    if odometry is None:
        yield Line("odometry  none yet")
        return
    pose, twist = odometry["pose"], odometry["twist"]
    speed = "" if twist is None else f"{speed_text(twist)} m/s  {twist['angular_rad_s']:+5.2f} rad/s   "
    place = (
        "no pose"
        if pose is None
        else (f"x {pose['x_m']:+7.3f} m  y {pose['y_m']:+7.3f} m   heading {math.degrees(pose['theta_rad']):+.1f}°")
    )
    yield Line(f"odometry  {speed}{place}")
    yield Line(f"age       {odometry['age_s']:5.2f} s  at {odometry['rate_hz']:4.1f} Hz")


def _keys(layout: str, width: int) -> Iterator[Line]:
    """Yield the map of the keys with their meanings next to it, or below it on a narrow terminal."""
    rows = MAPS[layout]
    if width >= _MAP_WIDTH + max(len(text) for _, text in rows):
        yield from (Line(f"   {keys:<{_MAP_WIDTH - 3}}{text}") for keys, text in rows)
    else:
        yield from (Line(f"   {keys}") for keys, _ in rows)
        yield from (Line(text) for _, text in rows)


def folded(text: str, width: int) -> Sequence[str]:
    """Break a text into lines between facts, else between words. A window may be too narrow for any character."""
    width = max(width, 1)
    if len(text) <= width:
        return [text]
    lines: list[str] = []
    for fact in text.split(" " * GAP):
        joined = f"{lines[-1]}{' ' * GAP}{fact}" if lines else fact
        if lines and len(joined) <= width:
            lines[-1] = joined
        else:
            lines += textwrap.wrap(fact.strip(), width, subsequent_indent="  " if width > GAP else "") or [""]
    return lines
