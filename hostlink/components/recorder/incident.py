"""Incidents: the rules that recognise them, their files, and the writing of these files."""

import itertools
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

from hostlink.components.recorder.channel import Channel
from hostlink.components.recorder.folder import Folder, StoredFile, file_stamp
from hostlink.components.recorder.reader import McapReader
from hostlink.components.recorder.ring import Entry
from hostlink.core.robot.events import HOST_AWAY, LEASE_ENDED, ORDERLY, EventKind, RobotEvent
from hostlink.core.robot.velocity import ZERO
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import RecordingFailed

# -- incident ---------------------------------------------------------------------------------------------------------

Cause = Literal["locked", "lease", "gone", "diagnosed", "device_error", "watchdog", "requested", "daemon_died"]

AGAIN_S = 60.0  # the same cause of the same robot is one incident during this time
MAX_NAMES = 4096  # of robots, and of topics by which devices are driven that are not robots; the oldest are removed
ERROR_LEVEL = 3
WATCHDOG_TEXT = "no command for"  # log text of the project's firmware when its own watchdog has stopped it
SILENCES = ("went_silent", "time_stopped")  # findings that end a link
_ENDS = (EventKind.STOPPED, EventKind.LOCKED, EventKind.GONE)  # end of a drive

MAX_LISTED = 1000

BURST = 64  # messages, which take about half a millisecond


@dataclass(frozen=True, slots=True)
class Incident:
    """Incident of one robot."""

    robot: str
    cause: Cause
    detail: str
    stamp_ns: int
    at_s: float = 0.0  # loop time, which is never set; 0 if read from a file


class IncidentRules:
    """Rules that decide whether an event is an incident. They keep each robot's last velocity and recent incidents."""

    def __init__(self) -> None:
        self._is_driven: dict[str, bool] = {}
        self._last_s: dict[str, dict[Cause, float]] = {}

    def __len__(self) -> int:
        """Number of names with data."""
        return max(len(self._is_driven), len(self._last_s))

    def observe(self, event: RobotEvent) -> Incident | None:
        """Return the incident that this event causes, or None."""
        cause, detail = self._cause(event)
        if cause is None or not event.robot:
            return None
        of_robot = self._last_s.setdefault(event.robot, {})
        _drop_oldest(self._last_s)
        causes = (cause, *_same_silence(event))
        if any(event.at_s < of_robot.get(each, float("-inf")) + AGAIN_S for each in causes):
            return None
        of_robot |= dict.fromkeys(causes, event.at_s)
        return Incident(event.robot, cause, detail, event.stamp_ns, event.at_s)

    def forget(self, robot: str) -> None:
        """Drop the data of a removed robot."""
        self._is_driven.pop(robot, None)
        self._last_s.pop(robot, None)

    def _cause(self, event: RobotEvent) -> tuple[Cause | None, str]:
        """Return (cause, detail); cause is None if the event is not an incident."""
        facts = event.facts
        if event.kind is EventKind.COMMANDED:
            self._is_driven[event.robot] = facts["limited"] != ZERO
            _drop_oldest(self._is_driven)
            return None, ""
        was_driven = self._is_driven.pop(event.robot, False) if event.kind in _ENDS else False
        match event.kind:
            case EventKind.STOPPED if was_driven and facts["reason"] == LEASE_ENDED:
                return "lease", f"{facts['owner']} sent no new velocity in time"
            case EventKind.STOPPED if was_driven and facts["reason"] == HOST_AWAY:
                return "lease", f"{HOST_AWAY} while {facts['owner']} drove"
            case EventKind.STOPPED if was_driven and facts["reason"] not in ORDERLY:  # the program itself has said why
                return "lease", f"{facts['owner']} stopped it: {facts['reason']}"
            case EventKind.LOCKED:
                return "locked", str(facts["reason"])
            case EventKind.GONE if facts["was_moving"]:
                return "gone", "its link ended while it was driven"
            case EventKind.DIAGNOSED:
                return "diagnosed", ": ".join(str(facts[part]) for part in ("cause", "detail") if facts[part])
            case EventKind.LOGGED:
                return _cause_of_line(str(facts["text"]), facts["level"])
        return None, ""


def _same_silence(event: RobotEvent) -> tuple[Cause, ...]:
    """Return other causes by which the same silence appears: the link ends, or the robot's watchdog stops it."""
    if event.kind is EventKind.DIAGNOSED and event.facts["code"] in SILENCES:
        return ("gone",)
    return ("watchdog",) if event.kind is EventKind.STOPPED and event.facts["reason"] == HOST_AWAY else ()


def _drop_oldest(names: dict[str, Any]) -> None:
    if len(names) > MAX_NAMES:
        del names[next(iter(names))]


def _cause_of_line(text: str, level: object) -> tuple[Cause | None, str]:
    if WATCHDOG_TEXT in text:
        return "watchdog", text
    return ("device_error", text) if isinstance(level, int) and level >= ERROR_LEVEL else (None, "")


# -- incident files ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SavedIncident:
    """File of one incident."""

    incident: Incident
    file: StoredFile


class IncidentFiles:
    """Incidents of a folder. Each file's beginning is read once; every method waits for the disk."""

    def __init__(self, folder: Folder) -> None:
        self.folder = folder
        self._known: dict[StoredFile, Incident] = {}

    def newest_first(self) -> list[SavedIncident]:
        """List the newest MAX_LISTED incidents, newest first. Files without incident metadata are skipped.

        Raises:
            OSError: the folder cannot be read.
        """
        known: dict[StoredFile, Incident] = {}
        for file in self.folder.files()[-MAX_LISTED:]:
            incident = self._known.get(file) or read_incident(self.folder.path / file.name)
            if incident is not None:
                known[file] = incident
        self._known = known
        found = [SavedIncident(incident, file) for file, incident in known.items()]
        return sorted(found, key=lambda saved: saved.incident.stamp_ns, reverse=True)


def read_incident(path: Path) -> Incident | None:
    """Read the incident of a file from its metadata; None if it has none."""
    reader = McapReader(path)
    facts = reader.metadata
    try:
        reader.read_beginning()
        cause = cast("Cause", facts["cause"])
        return Incident(facts.get("robot", ""), cause, facts.get("detail", ""), int(facts["stamp_ns"]))
    except (RecordingFailed, ValueError, KeyError):  # removed meanwhile, damaged, or not an incident's file
        return None


# -- incident writer --------------------------------------------------------------------------------------------------


class OutOfTime(Exception):
    """The process ends and no longer waits for a file."""


def write_incident(
    folder: Folder,
    incident: Incident,
    channels: list[Channel],
    entries: Iterable[Iterable[Entry]],
    *,
    before_s: float,
    rest: Callable[[], None],
) -> Path:
    """Write an incident's file in the order of arrival. Return its path. Blocks on the disk.

    `rest` is called after every BURST messages, because the loop would otherwise run at half speed, and once when the
    file is complete. An exception from it ends the writing, and no file is left.

    Raises:
        OSError: the disk failed.
    """
    from hostlink.components.recorder.mcap_writer import McapWriter  # noqa: PLC0415 - most daemons never save one

    folder.make_room(())
    stamp = file_stamp(incident.stamp_ns)
    name = re.sub(r"[^A-Za-z0-9_+-]", "-", f"{stamp}_{incident.robot}_{incident.cause}")[:90]
    number = 0
    while folder.file(name, number).exists():
        number += 1
    path = folder.file(name, number)
    metadata = {
        "robot": incident.robot,
        "cause": incident.cause,
        "detail": incident.detail,
        "stamp_ns": str(incident.stamp_ns),
    }
    first_s = incident.at_s - before_s
    part = path.with_suffix(".part")
    part.unlink(missing_ok=True)
    writer = McapWriter(part, metadata=metadata)
    try:
        for channel in channels:
            writer.announce(channel)
        wanted = (entry for entry in itertools.chain(*entries) if entry.at_s >= first_s)
        for number, entry in enumerate(sorted(wanted, key=lambda entry: entry.at_s)):
            steady_ns = incident.stamp_ns + round((entry.at_s - incident.at_s) * NS_PER_S)
            writer.write(entry.channel, entry.stamp_ns, entry.payload, steady_ns)
            if number % BURST == BURST - 1:
                rest()
        writer.close()
        rest()  # a process that is out of time has left the incident to another one
    except BaseException:
        writer.abandon()
        part.unlink(missing_ok=True)
        raise
    part.rename(path)
    return path
