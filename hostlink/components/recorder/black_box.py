"""BlackBox: keeps the last minutes of every robot in memory, and saves them around each incident."""

import asyncio
import contextlib
import functools
import hashlib
import itertools
import os
import threading
import time
from collections import defaultdict, deque
from collections.abc import Callable
from pathlib import Path

import structlog

from hostlink.components.recorder.channel import Channel, note_newest
from hostlink.components.recorder.drives import LastCommand
from hostlink.components.recorder.folder import MEGABYTE, Folder
from hostlink.components.recorder.incident import Incident, IncidentRules, OutOfTime, write_incident
from hostlink.components.recorder.recorder import Recorder, TopicSelection
from hostlink.components.recorder.ring import RingMemory, Rings
from hostlink.components.recorder.salvage import ABOUT, CLOSED, About, Pending, clear_old, pending_name, salvage
from hostlink.components.recorder.salvage import MAX_PENDING_CHANNELS as MAX_FACT_CHANNELS
from hostlink.components.recorder.settings import BlackBoxConfig
from hostlink.core.host import Host
from hostlink.core.robot.events import EventKind, RobotEvent
from hostlink.core.runtime import remains
from hostlink.core.runtime.detached import DetachedThread, start_python
from hostlink.core.runtime.folders import FolderOwner, FolderTaken
from hostlink.errors import RecordingBusy, RecordingFailed

log = structlog.get_logger()

MAX_PENDING = 256  # incidents that wait for their last half minute: something happened to all robots
MAX_REQUESTED = 8  # requested incidents among them
MAX_CHANNELS = 1024  # channels of one robot that its incidents contain even without a message; the newest
MAX_DETAIL = 400  # characters
REST_S = 0.001
END_S = 0.6  # to write pending incidents when the daemon ends; another process writes the rest
LONGEST_END_S = 5.0  # if the memory does not survive this process
_ROOT = Path(__file__).resolve().parents[3]


class BlackBox:
    """Recorder of all topics and events into memory, and observer of incidents.

    The memory survives the process if there is a tmpfs. salvage.py then writes what a killed daemon could not write.
    """

    def __init__(
        self,
        host: Host,
        config: BlackBoxConfig,
        folder: Path,
        *,
        min_free_disk_mb: float,
        owner: FolderOwner | None = None,
    ) -> None:
        """`folder` is that of the recordings, with its owner; incidents have a subfolder."""
        self.folder = Folder(
            folder / "incidents",
            max_disk_mb=config.max_disk_mb,
            min_free_disk_mb=min_free_disk_mb,
            owner=owner,
        )
        self.saved = self.missed = 0  # numbers of incidents
        self.pending: deque[Incident] = deque()
        self._purpose = hashlib.blake2s(str(self.folder.path.absolute()).encode(), digest_size=6).hexdigest()
        max_bytes = int(config.max_memory_mb * MEGABYTE)
        self._memory = RingMemory(max_bytes, purpose=self._purpose if config.enabled else None)
        self.rings = Rings(self._memory, keep_s=config.before_s + config.after_s)
        self._add = self.rings.add
        self._host, self.config = host, config
        self._now_s = asyncio.get_running_loop().time  # lines of other threads are kept, too
        self._rules = IncidentRules()
        self._channels: defaultdict[str, dict[Channel, None]] = defaultdict(dict)  # by robot
        self._unsaved: dict[Incident, str] = {}  # name of each incident's fact in the memory
        self._numbers = itertools.count()
        self._turn = asyncio.Lock()  # one file at a time, because the thread slows the loop
        self._thread = DetachedThread("incident")
        self._ends_at_s: float | None = None  # end of writing when the daemon ends
        self._recorder = Recorder(host, self, TopicSelection(is_local=True))
        self._observer = host.join_as_observer()

    def start(self, on_last_commands: Callable[[list[LastCommand]], None] = lambda _: None) -> None:
        """Keep everything from now on, and save the incidents of an earlier process.

        `on_last_commands` gets the last drivers of that process.
        """
        if self.config.enabled:
            disk = (self.folder.max_disk_mb, self.folder.min_free_disk_mb)
            self._memory.put_fact(ABOUT, About(str(self.folder.path.absolute()), *disk, self.config.before_s))
            if self._memory.folder is None:
                log.warning("black_box.volatile", reason=f"no room on {remains.PLACE}")
            self._recorder.start()
            self._observer.observe(self._receive)
        self._host.spawn(self._salvage(on_last_commands), name="incidents of an earlier process", is_vital=False)

    async def aclose(self) -> None:
        """Stop recording, and save pending incidents without the rest of their half minute.

        Incidents that END_S is too short for are left to another process, because the memory survives.
        """
        self._recorder.stop()
        self._observer.leave()
        end_s = LONGEST_END_S if self._memory.folder is None else END_S
        self._ends_at_s = self._now_s() + end_s
        self._memory.put_fact(CLOSED, "in order")
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(end_s):
                for incident in list(self.pending):
                    await self._save(incident)
                async with self._turn:  # wait for a file that is being written
                    pass
        if self._unsaved and self._memory.folder is not None:
            log.warning("incident.postponed", count=len(self._unsaved))
            self._memory.release()
            try:
                salvage = start_python(["-c", remains.SALVAGE, str(_ROOT), str(os.getpid())])
                threading.Thread(target=salvage.wait, name="salvage", daemon=True).start()  # leaves no zombie
            except OSError as error:  # the next start of the daemon does it
                log.warning("incident.postponed", reason=error.strerror or str(error))
            return
        for incident in self._unsaved:
            self._note_lost(incident, f"not written within {end_s:g} s")
        self._memory.remove()

    def announce(self, channel: Channel) -> None:
        """Note a channel, which all incidents of its robot contain."""
        note_newest(self._channels[channel.robot], channel, MAX_CHANNELS)

    def put(self, channel: Channel, stamp_ns: int, payload: bytes, robot: str) -> None:
        self._add(robot, channel, stamp_ns, payload, self._now_s())

    async def save(self, robot: str, reason: str) -> Incident:
        """Save a robot's last minutes on request.

        Raises:
            UnknownTopic: this daemon has no robot of that name.
            RecordingBusy: the black box is off, too many incidents are pending, or another daemon owns the folder.
            RecordingFailed: the disk refuses.
        """
        found = self._host.robot(robot, is_here=True)
        if not self.config.enabled:
            raise RecordingBusy("the black box is off: set enabled = true in [black_box]")
        incident = Incident(found.name, "requested", reason[:MAX_DETAIL], time.time_ns(), self._now_s())
        try:
            await asyncio.to_thread(self.folder.claim)
        except FolderTaken as error:
            raise RecordingBusy(error.strerror) from error
        except OSError as error:
            raise RecordingFailed(f"{self.folder.path}: {error.strerror or error}") from error
        requested = sum(each.cause == "requested" for each in self.pending)
        if requested >= MAX_REQUESTED or not self._begin(incident):
            raise RecordingBusy(
                f"{requested} incidents are being saved on request; try again in {self.config.after_s:g} s"
            )
        return incident

    def _receive(self, event: RobotEvent) -> None:
        if event.kind is EventKind.FORGOTTEN:
            self._rules.forget(event.robot)
            self._forget(event.robot)
        if self._host.is_played(event.robot):  # nothing happens to a recording
            return
        incident = self._rules.observe(event)
        if incident is not None and not self._begin(incident):
            self.missed += 1

    def _forget(self, robot: str) -> None:
        """Drop the data of a removed robot, unless one of its incidents is pending."""
        if all(each.robot != robot for each in self._unsaved) and not self._host.has_robot(robot):
            self.rings.forget(robot)
            self._channels.pop(robot, None)

    def _begin(self, incident: Incident) -> bool:
        if len(self.pending) >= MAX_PENDING:
            return False
        self.pending.append(incident)
        name = self._unsaved[incident] = pending_name(next(self._numbers))
        channels = itertools.islice(reversed(self._channels.get(incident.robot, {})), MAX_FACT_CHANNELS)
        self._memory.put_fact(name, Pending(incident, list(channels)))
        log.warning("incident.begun", robot=incident.robot, cause=incident.cause, detail=incident.detail[:MAX_DETAIL])
        self._host.spawn(self._save_later(incident), name=f"incident of {incident.robot}", is_vital=False)
        return True

    async def _save_later(self, incident: Incident) -> None:
        await asyncio.sleep(self.config.after_s)
        await self._save(incident)

    async def _save(self, incident: Incident) -> None:
        async with self._turn:
            if incident not in self.pending:
                return
            self.pending.remove(incident)
            entries = self.rings.copies(incident.robot)
            channels = list(self._channels.get(incident.robot, ()))
            before_s, rest, fact = self.config.before_s, self._rest, self._unsaved[incident]

            def write() -> Path:
                path = write_incident(self.folder, incident, channels, entries, before_s=before_s, rest=rest)
                self._memory.drop_fact(fact)  # here: the ending daemon may not wait for the thread's answer
                return path

            try:
                path = await self._thread.run(write)
            except OutOfTime:
                return
            except OSError as error:
                self._memory.drop_fact(fact)
                self._note_lost(incident, error.strerror or str(error))
            else:
                self.saved += 1
                log.warning("incident.saved", robot=incident.robot, cause=incident.cause, file=str(path))
        del self._unsaved[incident]
        self._forget(incident.robot)

    def _note_lost(self, incident: Incident, reason: str) -> None:
        self.missed += 1
        log.warning("incident.lost", robot=incident.robot, cause=incident.cause, reason=reason)

    def _rest(self) -> None:
        """Yield the interpreter to the loop, from a writing thread. At the end of the daemon, check the time instead.

        Raises:
            OutOfTime: the time of the ending daemon is over.
        """
        if self._ends_at_s is None:
            time.sleep(REST_S)
        elif self._now_s() > self._ends_at_s:
            raise OutOfTime

    async def _salvage(self, on_last_commands: Callable[[list[LastCommand]], None]) -> None:
        """Save the incidents that earlier processes with the same folder have left."""
        for path in remains.of_purpose(self._purpose):
            if Path(path) == self._memory.folder:
                continue
            async with self._turn:
                try:
                    found = await self._thread.run(functools.partial(salvage, Path(path), rest=self._rest))
                except OutOfTime:
                    return
                except OSError as error:
                    log.warning("incident.postponed", reason=error.strerror or str(error))
                    continue
            if found is None:
                continue
            on_last_commands(found.commands)
            for incident, file in found.saved:
                self.saved += 1
                log.warning("incident.saved", robot=incident.robot, cause=incident.cause, file=str(file))
            for incident, reason in found.lost:
                self._note_lost(incident, reason)
        async with self._turn:
            await self._thread.run(clear_old)
