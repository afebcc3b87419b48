"""BlackBox: the last minutes of every robot, in memory; saved with the half minute after when something happens."""

import asyncio
import functools
import itertools
import re
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import structlog

from hostlink.errors import RecordingBusy
from hostlink.hub.hub import Hub
from hostlink.hub.robot_events import EventKind, RobotEvent
from hostlink.recording.channel import Channel, note_newest
from hostlink.recording.folder import MEGABYTE, Folder
from hostlink.recording.incident import Incident, IncidentRules
from hostlink.recording.recorder import Recorder, Selection
from hostlink.recording.ring import Entry, Rings

log = structlog.get_logger()

MAX_PENDING = 256  # incidents whose half minute after is not over: something happened to all robots
MAX_REQUESTED = 8  # among them, that somebody requested
MAX_CHANNELS = 1024  # of one robot, that are in its incidents without a message; the newest
MAX_DETAIL = 400  # characters
BURST = 64  # messages, which take about half a millisecond
REST_S = 0.001


def rest_a_moment() -> None:
    """In a thread that writes: the loop has the interpreter for itself."""
    time.sleep(REST_S)


def _go_on() -> None:
    """The daemon ends: nobody needs the loop."""


class BlackBox:
    """A sink for everything, and an observer of what happens."""

    def __init__(self, hub: Hub, folder: Path) -> None:
        """`folder`: of the recordings; incidents have one in it."""
        config = hub.config.black_box
        self.folder = Folder(
            folder / "incidents",
            max_disk_mb=config.max_disk_mb,
            min_free_disk_mb=hub.config.recording.min_free_disk_mb,
        )
        self.saved = self.missed = 0  # incidents
        self.pending: deque[Incident] = deque()
        self.rings = Rings(keep_s=config.before_s + config.after_s, max_bytes=int(config.max_memory_mb * MEGABYTE))
        self._hub, self._config = hub, config
        self._rules = IncidentRules()
        self._channels: defaultdict[str, dict[Channel, None]] = defaultdict(dict)  # by robot
        self._writer = ThreadPoolExecutor(1, "incident")  # one at a time: the loop shares the interpreter with it
        self._recorder = Recorder(hub, self, Selection(has_derived=False, has_remote=False))
        self._observer = hub.join_daemon()

    def start(self) -> None:
        """Keep everything from now on."""
        if self._config.enabled:
            self._recorder.start()
            self._observer.observe(self._receive)

    async def aclose(self) -> None:
        """Keep nothing more; what is pending is saved without the rest of its half minute."""
        self._recorder.stop()
        self._observer.leave()
        for incident in list(self.pending):
            await self._save(incident, rest=_go_on)
        await asyncio.to_thread(self._writer.shutdown)

    def announce(self, channel: Channel) -> None:
        """The channels of a robot are in each of its incidents."""
        note_newest(self._channels[channel.robot], channel, MAX_CHANNELS)

    def put(self, channel: Channel, stamp_ns: int, payload: bytes, robot: str) -> None:
        """Keep a message."""
        self.rings.add(robot, channel, stamp_ns, payload, time.monotonic())

    def save(self, robot: str, reason: str) -> Incident:
        """Save a robot's last minutes because somebody requests it.

        Raises:
            UnknownTopic: there is no robot of that name here.
            RecordingBusy: the black box is turned off, or too many incidents are pending.
        """
        found = self._hub.robots.find_here(robot.strip("/"))
        if not self._config.enabled:
            raise RecordingBusy("the black box is off: set enabled = true in [black_box]")
        incident = Incident(found.name, "requested", reason[:MAX_DETAIL], time.time_ns(), time.monotonic())
        requested = sum(each.cause == "requested" for each in self.pending)
        if requested >= MAX_REQUESTED or not self._begin(incident):
            raise RecordingBusy(
                f"{requested} incidents are being saved on request; try again in {self._config.after_s:g} s"
            )
        return incident

    def _receive(self, event: RobotEvent) -> None:
        if event.kind is EventKind.FORGOTTEN:
            self._rules.forget(event.robot)
            self._forget(event.robot)
        incident = self._rules.observe(event)
        if incident is not None and not self._begin(incident):
            self.missed += 1

    def _forget(self, robot: str) -> None:
        """What is kept of a robot that is no more, unless an incident of it is pending."""
        if all(each.robot != robot for each in self.pending) and not self._hub.robots.has(robot):
            self.rings.forget(robot)
            self._channels.pop(robot, None)

    def _begin(self, incident: Incident) -> bool:
        if len(self.pending) >= MAX_PENDING:
            return False
        self.pending.append(incident)
        log.warning("incident.begun", robot=incident.robot, cause=incident.cause, detail=incident.detail[:MAX_DETAIL])
        self._hub.spawn(self._save_later(incident), name=f"incident of {incident.robot}")
        return True

    async def _save_later(self, incident: Incident) -> None:
        await asyncio.sleep(self._config.after_s)
        await self._save(incident)

    async def _save(self, incident: Incident, *, rest: Callable[[], None] = rest_a_moment) -> None:
        if incident not in self.pending:
            return
        self.pending.remove(incident)
        entries = self.rings.copies(incident.robot)
        channels = list(self._channels.get(incident.robot, ()))
        self._forget(incident.robot)
        write = functools.partial(
            write_incident, self.folder, incident, channels, entries, before_s=self._config.before_s, rest=rest
        )
        try:
            path = await asyncio.get_running_loop().run_in_executor(self._writer, write)
        except OSError as error:
            self.missed += 1
            reason = error.strerror or str(error)
            log.warning("incident.lost", robot=incident.robot, cause=incident.cause, reason=reason)
        else:
            self.saved += 1
            log.warning("incident.saved", robot=incident.robot, cause=incident.cause, file=str(path))


def write_incident(
    folder: Folder,
    incident: Incident,
    channels: list[Channel],
    entries: Iterable[Iterable[Entry]],
    *,
    before_s: float,
    rest: Callable[[], None],
) -> Path:
    """Write an incident's file, by time; returns where. It waits for the disk.

    `rest` is called after every BURST messages: the loop would be half as fast without the interpreter for itself.

    Raises:
        OSError: of the disk.
    """
    from hostlink.recording.mcap_writer import McapWriter  # noqa: PLC0415 - most daemons never save one

    folder.make_room(())
    stamp = time.strftime("%Y-%m-%dT%H-%M-%S", time.localtime(incident.stamp_ns // 1_000_000_000))
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
    beside = path.with_suffix(".part")
    beside.unlink(missing_ok=True)
    writer = McapWriter(beside, metadata=metadata)
    try:
        for channel in channels:
            writer.announce(channel)
        wanted = (entry for entry in itertools.chain(*entries) if entry.at_s >= first_s)
        for number, entry in enumerate(sorted(wanted, key=lambda entry: entry.stamp_ns)):
            writer.write(*entry[:3])
            if number % BURST == BURST - 1:
                rest()
        writer.close()
    except BaseException:
        writer.abandon()
        beside.unlink(missing_ok=True)
        raise
    beside.rename(path)
    return path
