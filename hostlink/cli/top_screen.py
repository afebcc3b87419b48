"""Screen of top: lines of the figures and a size, robots first, with scrolling and an order. Pure."""

import math
from collections.abc import Callable, Sequence
from typing import Any

from hostlink.cli.driving import Action, Key
from hostlink.cli.figures import LINK_COLUMNS, advice, link_rows, ordered, robot_table
from hostlink.cli.output import table
from hostlink.cli.teleop_screen import QUIT_KEY, RED, YELLOW, Line, folded
from hostlink.core.runtime.plain_text import plain

BOLD = "1"
SILENT_S = 2.0  # age of an odometry that is coloured: robots send it ten times a second, slow ones once
ORDER_KEY = "s"
UP, DOWN = ("up", "k"), ("down", "j")
PAGE_UP, PAGE_DOWN = ("sequence 5~", "b"), ("sequence 6~", "space")
_LEAST_IMPORTANT = ("firmware", "errors", "Hz", "deg", "dBm", "y m", "x m", "rad/s", "link", "battery")


def is_silent(robot: dict[str, Any]) -> bool:
    """Whether the robot is away, or its odometry has stopped."""
    odometry = robot["odometry"]
    return robot["link"] is None or (odometry is not None and odometry["age_s"] > SILENT_S)


def colour_of(robot: dict[str, Any]) -> str:
    """Colour of a robot: red if it is locked, yellow if it is silent."""
    return RED if robot.get("locked") else YELLOW if is_silent(robot) else ""


def _trouble(robot: dict[str, Any]) -> int:
    return (RED, YELLOW, "").index(colour_of(robot))


def _slowness(robot: dict[str, Any]) -> float:
    twist = (robot["odometry"] or {}).get("twist") or {}
    return -math.hypot(twist.get("linear_m_s", 0.0), twist.get("linear_y_m_s", 0.0))


def _freshness(robot: dict[str, Any]) -> float:
    return -float((robot["odometry"] or {}).get("age_s", math.inf))


ORDERS: dict[str, Callable[[dict[str, Any]], Any] | None] = {  # name, and the key of the order
    "name": None,
    "state": _trouble,
    "speed": _slowness,
    "age": _freshness,
}


class TopScreen:
    """Order and place of the screen, which keys change."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._order = next(iter(ORDERS))
        self._first = self._page = 0  # line of the body at the top, and how many fit

    def press(self, key: Key) -> None:
        """Apply a key: scroll, or take the next order."""
        if key.action is Action.RELEASED:
            return
        steps = {**dict.fromkeys(UP, -1), **dict.fromkeys(DOWN, 1)}
        steps |= {**dict.fromkeys(PAGE_UP, -self._page), **dict.fromkeys(PAGE_DOWN, self._page)}
        if key.name in steps:
            self._first += steps[key.name]
        elif key.name == ORDER_KEY:
            names = list(ORDERS)
            self._order = names[(names.index(self._order) + 1) % len(names)]

    def lines(self, shown: dict[str, Any], columns: int, rows: int) -> list[Line]:
        """Return the lines for a terminal of this size. The last one says how many are above and below."""
        width = max(columns - 1, 1)
        title = f"hostlink top by {self._order}   {ORDER_KEY} sorts, {QUIT_KEY} ends   {self._url}"
        whole = self._body(shown, width)
        body = [Line(part, line.colour) for line in whole for part in folded(plain(line.text), width)]
        self._page = max(rows - 2, 1)
        if len(body) <= rows - 1:
            self._first = 0
            return [Line(title, BOLD), *body]
        self._first = max(0, min(self._first, len(body) - self._page))
        end = self._first + self._page
        below = f"{len(body) - end} lines more below, {self._first} above; arrows scroll"
        return [Line(title, BOLD), *body[self._first : end], Line(below, BOLD)]

    def _body(self, shown: dict[str, Any], width: int) -> list[Line]:
        order = ORDERS[self._order]
        heads, rows = fitting(*robot_table(shown, order), width)
        robots = table(heads, rows, columns=width)[1:]
        height = len(robots) // (len(rows) + 1) if rows else 0  # lines of a row, in a terminal that is too narrow
        colours = [BOLD, *(colour_of(robot) for robot in ordered(shown, order))]
        lines = [Line(text, colours[place // height]) for place, text in enumerate(robots)]
        lines = lines or [Line("no robot has connected")]
        links = link_rows(shown)
        found = table(LINK_COLUMNS, links, columns=width)[1:] or ["no device is connected"]
        return [
            *lines,
            Line(""),
            *(Line(text) for text in found),
            Line(""),
            *(Line(text, YELLOW) for text in advice(shown) or ()),
            *([] if advice(shown) else [Line("no findings")]),
        ]


def fitting(heads: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> tuple[list[str], list[list[str]]]:
    """Leave out the least important columns until a row fits into a line of the terminal."""
    kept = list(range(len(heads)))
    for name in ("", *_LEAST_IMPORTANT):
        kept = [column for column in kept if heads[column] != name]
        names, cells = [heads[column] for column in kept], [[row[column] for column in kept] for row in rows]
        if len(table(names, cells, columns=width)) <= len(cells) + 2:  # an empty line, the heads and the rows
            break
    return names, cells
