"""Drives: who drove which robot, from when to when. A pause of a few seconds does not end a drive."""

from collections.abc import Iterator
from typing import NamedTuple

import msgspec

from hostlink.hub.robot_events import EventKind, RobotEvent
from hostlink.robot.velocity import PlanarVelocity, Twist

PAUSE_NS = 3_000_000_000  # between two commands of one drive: a key is released and pressed again
MAX_OPEN = 1024  # unfinished drives


class Drive(msgspec.Struct, kw_only=True):
    """One drive.

    Times are wall times; `seconds` is measured by a clock that is never set. `end` is empty while it lasts.
    """

    robot: str
    owner: str
    address: str = ""  # of the last command
    priority: int
    began_ns: int
    ended_ns: int  # so far
    seconds: float | None = None  # so far; None in files of older releases
    commands: int = 0
    fastest_m_s: float = 0.0
    fastest_rad_s: float = 0.0
    end: str = ""


class _Key(NamedTuple):
    robot: str
    owner: str


class Drives:
    """Current drives, and paused ones that may continue."""

    def __init__(self) -> None:
        self._open: dict[_Key, Drive] = {}  # oldest first
        self._began_s: dict[_Key, float] = {}  # loop time of the start
        self._begun: list[Drive] = []

    def __len__(self) -> int:
        return len(self._open)

    def observe(self, event: RobotEvent) -> None:
        """Handle an event of a robot."""
        if event.kind is EventKind.COMMANDED:
            self._command(event)
        elif event.kind is EventKind.STOPPED:
            drive = self._open.get(_Key(event.robot, str(event.facts["owner"])))
            self._end([] if drive is None else [drive], event, str(event.facts["reason"]))
        elif event.kind is EventKind.LOCKED:
            self._end(self._of(event.robot), event, f"locked: {event.facts['reason']}")
        elif event.kind is EventKind.GONE:
            self._end(self._of(event.robot), event, "its device disconnected")

    @property
    def has_begun(self) -> bool:
        """Whether `pop_begun` has drives."""
        return bool(self._begun)

    def pop_begun(self) -> list[Drive]:
        """Remove and return the drives that have started since the last call."""
        begun, self._begun = self._begun, []
        return begun

    def under_way(self) -> list[Drive]:
        """Return the current drives, oldest first. Paused ones are included."""
        return list(self._open.values())

    def pop_finished(self, now_ns: int) -> list[Drive]:
        """Remove and return the drives that ended long enough ago, and the oldest above MAX_OPEN."""
        surplus = len(self._open) - MAX_OPEN
        finished = [
            key
            for number, (key, drive) in enumerate(self._open.items())
            if number < surplus or (drive.end and not 0 <= now_ns - drive.ended_ns < PAUSE_NS)
        ]
        for key in finished:
            self._began_s.pop(key, None)
        return [self._open.pop(key) for key in finished]

    def _of(self, robot: str) -> Iterator[Drive]:
        return (drive for key, drive in self._open.items() if key.robot == robot)

    def _command(self, event: RobotEvent) -> None:
        velocity, owner = event.facts["limited"], str(event.facts["owner"])
        assert isinstance(velocity, PlanarVelocity | Twist)  # noqa: S101 - see EventKind
        if velocity.is_zero:
            return  # a zero starts no drive
        key = _Key(event.robot, owner)
        drive = self._open.get(key)
        is_continued = drive is not None and not drive.end
        if drive is None:
            priority = int(str(event.facts["priority"]))
            drive = Drive(
                robot=event.robot, owner=owner, priority=priority, began_ns=event.stamp_ns, ended_ns=event.stamp_ns
            )
            self._open[key], self._began_s[key] = drive, event.at_s
            self._begun.append(drive)
            del self._begun[:-MAX_OPEN]  # bounded, in case no caller reads them
        drive.end = ""
        self._lasts_until(drive, event)
        drive.address = str(event.facts["address"])
        drive.commands += 1
        drive.fastest_m_s = max(drive.fastest_m_s, velocity.speed_m_s)
        drive.fastest_rad_s = max(drive.fastest_rad_s, velocity.turn_rad_s)
        if not is_continued:  # otherwise the other drives have ended already
            others = (other for other in self._of(event.robot) if other is not drive)
            self._end(others, event, f"taken over by {owner}")

    def _end(self, drives: Iterator[Drive] | list[Drive], event: RobotEvent, reason: str) -> None:
        for drive in drives:
            if not drive.end:
                drive.end = reason
                self._lasts_until(drive, event)

    def _lasts_until(self, drive: Drive, event: RobotEvent) -> None:
        drive.ended_ns = event.stamp_ns
        drive.seconds = event.at_s - self._began_s[_Key(drive.robot, drive.owner)]
