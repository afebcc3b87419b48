"""Figures of `hostlink top`, `links` and `robots`: rates from two snapshots of a daemon's state."""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any, NamedTuple

from hostlink.cli.names import driver, natural
from hostlink.client import Event, Host

# -- figures of two snapshots -----------------------------------------------------------------------------------------

LINK_COLUMNS = ("link", "peer", "robot", "topics", "from/s", "to/s", "bytes/s", "lost %", "silent s", "diagnosis")
ROBOT_COLUMNS = ("robot", "link", "driven by", "m/s", "rad/s", "x m", "y m", "deg", "Hz", "age s")
MOTION_COLUMNS = ("command", "knows its motion by")
DEVICE_COLUMNS = ("battery", "dBm", "errors", "firmware")  # more columns of a robot, shown if any robot has a value
USUAL_PROTOCOL = "rosserial"
_DEGREES = 57.29577951308232

EARLY_S = 0.05  # events arrive each tenth of a second: one that is half of that too early is in time


class Snapshot(NamedTuple):
    """The daemon's links and robots at one moment."""

    at_s: float
    links: dict[str, Any]  # GET /api/links
    robots: list[dict[str, Any]]


def figures(before: Snapshot, now: Snapshot) -> dict[str, Any]:
    """Return rates and states as JSON objects: links, robots, ended links and ports."""
    earlier = {link["number"]: link for link in before.links["links"]}
    names: dict[int, list[str]] = {}
    for robot in now.robots:
        if robot["link"] is not None:
            names.setdefault(robot["link"], []).append(robot["name"])
    links = []
    for link in now.links["links"]:
        seconds = now.at_s - before.at_s if link["number"] in earlier else link["seconds"]
        rates = _rates(earlier.get(link["number"], {}), link, max(seconds, 1e-3))
        known = {key: link[key] for key in ("number", "peer", "silent_s", "seconds", "diagnosis")}
        known["protocol"] = link.get("protocol", USUAL_PROTOCOL)  # an older daemon does not tell it
        links.append(known | rates | {"topics": len(link["topics"]), "robots": names.get(link["number"], [])})
    return {"links": links, "robots": now.robots, "ended": now.links["ended"], "ports": now.links["ports"]}


def place(link: Mapping[str, Any]) -> str:
    """Return where a device connects from, and its protocol if that is not rosserial."""
    protocol = link.get("protocol", USUAL_PROTOCOL)
    return str(link["peer"]) if protocol == USUAL_PROTOCOL else f"{link['peer']} {protocol}"


def _rates(before: dict[str, Any], now: dict[str, Any], seconds: float) -> dict[str, float]:
    def difference(key: str) -> float:
        return float(now.get(key, 0) - before.get(key, 0))  # an older daemon does not tell all of them

    came, lost = difference("bytes_from_device"), difference("lost_messages")
    sent = difference("frames_from_device") + lost
    return {
        "frames_from_device_s": round(difference("frames_from_device") / seconds, 1),
        "frames_to_device_s": round(difference("frames_to_device") / seconds, 1),
        "bytes_from_device_s": round(came / seconds),
        "skipped_percent": round(100 * difference("skipped_bytes") / came, 1) if came else 0.0,
        "lost_messages_percent": round(100 * lost / sent, 1) if sent else 0.0,
    }


def link_rows(shown: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return the cells of each link under LINK_COLUMNS."""
    return [
        (
            str(link["number"]),
            place(link),
            ", ".join(link["robots"]) or "-",
            str(link["topics"]),
            f"{link['frames_from_device_s']:.1f}",
            f"{link['frames_to_device_s']:.1f}",
            str(link["bytes_from_device_s"]),
            f"{max(link['skipped_percent'], link['lost_messages_percent']):.1f}",  # of bytes, or of messages
            f"{link['silent_s']:.1f}",
            ", ".join(each["code"] for each in link["diagnosis"]) or "healthy",
        )
        for link in shown["links"]
    ]


def robot_table(
    shown: dict[str, Any],
    order: Callable[[dict[str, Any]], Any] | None = None,
    *,
    has_motion: bool = False,
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the columns of the robots and the cells of each robot, in the natural order of their names.

    `order` is the key of another order; robots that are equal by it are in the order of their names. `has_motion` adds
    MOTION_COLUMNS.

    A column of DEVICE_COLUMNS is left out if no robot has a value for it.
    """
    robots = ordered(shown, order)
    device = [_device_row(robot) for robot in robots]
    used = [number for number in range(len(DEVICE_COLUMNS)) if any(row[number] != "-" for row in device)]
    columns = (*ROBOT_COLUMNS, *(MOTION_COLUMNS if has_motion else ()), *(DEVICE_COLUMNS[number] for number in used))
    rows = zip(robots, device, strict=True)
    return columns, [
        (*_robot_row(robot), *(_motion_row(robot) if has_motion else ()), *(cells[number] for number in used))
        for robot, cells in rows
    ]


def ordered(shown: dict[str, Any], order: Callable[[dict[str, Any]], Any] | None = None) -> list[dict[str, Any]]:
    """Return the robots as `robot_table` orders them."""
    robots = sorted(shown["robots"], key=lambda robot: natural(robot["name"]))
    return robots if order is None else sorted(robots, key=order)


def _device_row(robot: dict[str, Any]) -> tuple[str, ...]:
    """Return the cells under DEVICE_COLUMNS; an older daemon sends none of these values."""
    volts, percent, dbm = robot.get("battery_v"), robot.get("battery_percent"), robot.get("signal_dbm")
    battery = [f"{volts:.1f} V"] if volts is not None else []
    battery += [f"{percent:.0f} %"] if percent is not None else []
    return (
        " ".join(battery) or "-",
        "-" if dbm is None else str(dbm),
        ", ".join(robot.get("device_errors", ())) or "-",
        robot.get("firmware") or "-",
    )


def _robot_row(robot: dict[str, Any]) -> tuple[str, ...]:
    odometry = robot["odometry"]
    host = robot.get("host")  # the daemon that the robot is connected to, if another than the sender
    link = "gone" if robot["link"] is None else f"at {host}" if host else str(robot["link"])
    who = "locked" if robot.get("locked") else driver(robot) or "nobody"
    if odometry is None:
        return (robot["name"], link, who, *("-",) * 7)
    pose, twist = odometry["pose"], odometry["twist"]
    return (
        robot["name"],
        link,
        who,
        *(("-", "-") if twist is None else (speed_text(twist), f"{twist['angular_rad_s']:+.2f}")),
        *(("-",) * 3 if pose is None else _pose_row(pose)),
        f"{odometry['rate_hz']:.1f}",
        f"{odometry['age_s']:.1f}",
    )


def _motion_row(robot: dict[str, Any]) -> tuple[str, ...]:
    """Return the cells under MOTION_COLUMNS; an older daemon sends neither."""
    command = robot.get("command_type", "").rpartition("/")[2]
    return command or "-", {"motion": "moves or stands", "none": "no odometry"}.get(
        robot.get("feedback", ""), robot.get("feedback", "-")
    )


def _pose_row(pose: Mapping[str, Any]) -> tuple[str, ...]:
    return f"{pose['x_m']:+.2f}", f"{pose['y_m']:+.2f}", f"{pose['theta_rad'] * _DEGREES:+.0f}"


def speed_text(twist: Mapping[str, Any]) -> str:
    """Text of a speed: m/s forward, and to the left if that is not 0."""
    left_m_s = f"{twist.get('linear_y_m_s', 0.0):+.2f}"  # an older daemon does not send it
    return f"{twist['linear_m_s']:+.2f}{'' if float(left_m_s) == 0 else f' y {left_m_s}'}"


def advice(shown: dict[str, Any]) -> list[str]:
    """Return a cause and a next step for each finding of live links and of ports, then the last links that ended."""
    lines = []
    for link in shown["links"]:
        lines += [line for each in link["diagnosis"] for line in finding_lines(each, f"link {link['number']} ")]
    lines += [
        line
        for port in shown["ports"]
        for each in port["diagnosis"]
        for line in finding_lines(each, f"{port['name']} ")
    ]
    for link in shown["ended"][:3]:
        codes = ", ".join(each["code"] for each in link["diagnosis"])
        seconds = f"after {link['seconds']:.0f} s, {link['ended_ago_s']:.0f} s ago"
        lines.append(f"link {link['number']} {place(link)} ended: {link['end']} {seconds}{codes and f'; {codes}'}")
    return lines


def finding_lines(found: dict[str, str], about: str = "") -> list[str]:
    """Return the cause and the next step of a finding; `about` names its link or port.

    Further lines of its detail are lines to copy.
    """
    first, *lines = found["detail"].splitlines() or [""]
    detail = f" ({first})" if first else ""
    return [
        f"{about}{found['code']}: {found['cause']}{detail}",
        f"  next: {found['next_step']}",
        *(f"    {line}" for line in lines),
    ]


# -- figures of the daemon's events -----------------------------------------------------------------------------------


async def live_figures(host: Host, interval_s: float) -> AsyncIterator[dict[str, Any]]:
    """Yield figures once an interval; the first as soon as there are two snapshots.

    Raises:
        HostlinkError: the connection is lost.
    """
    live = LiveFigures(interval_s)
    async for event in host.watch():
        shown = live.update(event, asyncio.get_running_loop().time())
        if shown is not None:
            yield shown


class LiveFigures:
    """Newest snapshot of links and robots, and the one an interval earlier, from which rates are computed. Pure."""

    def __init__(self, interval_s: float) -> None:
        self._interval_s = interval_s - EARLY_S
        self._robots: list[dict[str, Any]] = []
        self._before: Snapshot | None = None
        self._newest: Snapshot | None = None
        self._shown_at_s = float("-inf")

    def update(self, event: Event, now_s: float) -> dict[str, Any] | None:
        """Add an event; return figures if they are due."""
        if event.name == "robots":
            self._robots = event.data["robots"]
        elif event.name == "links":
            self._add(Snapshot(now_s, event.data, self._robots))
        if self._before is None or self._newest is None or now_s < self._shown_at_s + self._interval_s:
            return None
        self._shown_at_s = now_s
        return figures(self._before, self._newest._replace(robots=self._robots))

    def _add(self, snapshot: Snapshot) -> None:
        """Keep a snapshot. Rates are of the interval, or of the time between two snapshots if that is longer."""
        if self._newest is not None and (
            self._before is None or self._newest.at_s >= self._before.at_s + self._interval_s
        ):
            self._before = self._newest
        self._newest = snapshot
