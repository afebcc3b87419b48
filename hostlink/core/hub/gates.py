"""Gates: all velocity gates and their clock. Every velocity to a device passes through here.

`VelocityTarget` accepts velocities. `Drivable` is one: a velocity topic of a device here, with its gate.
"""

import asyncio
import contextlib
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import structlog

from hostlink.core.hub.diagnoses import Diagnosis
from hostlink.core.hub.isolation import Isolation
from hostlink.core.hub.message import Message
from hostlink.core.hub.providers import Providers
from hostlink.core.hub.robot_events import RobotEvents, facts_of
from hostlink.core.hub.stall_watch import BEAT_S, StallWatch
from hostlink.core.hub.topic import Topic
from hostlink.core.link.link import Link
from hostlink.core.link.serving import LinkEnd
from hostlink.core.protocol.endpoint import DeviceEndpoint
from hostlink.core.robot.admission import LEASE_S, Admission, Command, named
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.core.robot.command_types import CommandType, Published, decode_twist
from hostlink.core.robot.events import (
    HOST_AWAY,
    LEASE_ENDED,
    LET_GO,
    NOT_TAKEN,
    OVERRULED,
    OWNER_LEFT,
    WAS_STOPPED,
    EventKind,
)
from hostlink.core.robot.model import STOP_SERVICE_TYPES, CommandSettings
from hostlink.core.robot.velocity import ZERO, AnyVelocity, PlanarVelocity, Twist
from hostlink.core.robot.velocity_gate import EndedLease, V, VelocityGate
from hostlink.core.runtime.arrival import SETTLE_S
from hostlink.core.runtime.host_pauses import HostPauses
from hostlink.core.runtime.log_budget import Budget
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.core.runtime.stop_frames import StopFrames
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import CommandRefused, DeviceGone, HostlinkError, RefusalKind

log = structlog.get_logger()

TICK_S = 0.05  # between two steps of a ramp; the end of a lease is a step, too
MAX_STEPS = 64  # of gates in one turn of the loop: a device may have 256, and a stop must not wait for them
FEED_INTERVAL_S = 0.125  # a source that commands at 10 Hz feeds the device by itself; a quarter of its own watchdog
MAX_GUARDED = 16  # velocity topics of a device that the guardian stops; each is a record to it
ENDING = "hostlink is stopping and accepts no commands"


class Guard(Protocol):
    """Interface of the guardian. Its methods do not wait and raise nothing."""

    def watch(self, number: int, connection: Callable[[], int | None], stop: StopFrames) -> None:
        """Guard a link with these frames, or replace them.

        `connection` returns its descriptor while it is open. Frames beyond 4 KiB are dropped with a warning.
        """
        ...

    def beat(self, driven: set[int]) -> None:
        """Report that this process runs, and which links have robots that may move.

        The guardian stops them after a second without a beat.

        Call it at least ten times a second while there are any, and once when there are none left.
        """
        ...

    def release(self, number: int) -> None:
        """Stop guarding a link, which has ended or has no velocity topic left."""
        ...


@dataclass(slots=True)
class Refusals:
    """Velocities that did not fit a robot's device."""

    count: int = 0
    error: HostlinkError | None = None  # of the last velocity; None if it was sent
    lines: Budget | None = None  # from the first refusal on

    @property
    def cause(self) -> str | None:
        """Return why the last velocity did not fit; None if it was sent."""
        return None if self.error is None else str(self.error)

    def add(self, robot: str, error: HostlinkError) -> None:
        """Count a refusal. A driver repeats a command ten times a second."""
        self.count += 1
        self.error = error
        if self.lines is None:
            self.lines = Budget()
        if counts := self.lines.due("refused", loop_time_s()):
            log.warning("robot.unreachable", robot=robot, cause=self.cause, **counts)


class VelocityTarget(ABC):
    """Target of velocities: a velocity topic of a device here, or a robot of another daemon."""

    name: str
    gates: "Gates"
    admission: Admission  # decides whether a command may move it

    def join(self, topic: Topic) -> None:
        """Note the publishers from before it subscribed to a topic."""
        self.admission.join((*topic.publishers, *topic.earlier), loop_time_s())

    @abstractmethod
    def command(self, command: Command[Any]) -> Any:
        """Drive for the length of a lease, if the command is admitted. Return the velocity after the limits.

        Raises:
            CommandRefused: the robot's admission refused the command, or the daemon stops.
            FrameTooLarge, WrongType, UnknownTopic: the command does not fit the device; the device is stopped.
            DeviceGone: the robot's daemon does not answer.
        """

    def decode(self, message: Message) -> Published:
        """Decode a published command.

        Raises:
            WrongType: the message has another type.
            BadPayload: it is damaged.
        """
        return decode_twist(message.topic, message.type_name, message.payload)

    def receive(self, message: Message) -> None:
        """Receive a published velocity as a command of its publisher. A stamp of 0 is ignored.

        A robot uses three of the six numbers, a velocity topic without a robot all of them. A zero while another source
        drives is ignored: a joystick at rest publishes zeros.

        Raises:
            HostlinkError: as from `command`.
            WrongType: the message has another type.
        """
        twist, stamp_ns = self.decode(message)
        stamp_age_s = (self.gates.wall_ns() - stamp_ns) / NS_PER_S if stamp_ns else None
        self.receive_twist(
            twist, message.source, message.priority, message.at_s, epoch=message.epoch, stamp_age_s=stamp_age_s
        )

    def receive_twist(
        self,
        twist: Twist,
        source: Hashable,
        priority: int,
        received_s: float,
        *,
        epoch: int | None = None,
        stamp_age_s: float | None = None,
    ) -> None:
        """Receive a published Twist as a command; as `receive`. The arguments are those of a `Command`."""
        is_spatial = self.admission.drive is None
        velocity: PlanarVelocity | Twist = twist if is_spatial else twist.planar
        command: Command[Any] = Command(
            velocity,
            source,
            priority,
            received_s,
            epoch=epoch,
            stamp_age_s=stamp_age_s,
            is_planar=is_spatial or twist.is_planar,
        )
        try:
            self.command(command)
        except CommandRefused as refused:
            if not (velocity.is_zero and refused.kind is RefusalKind.HELD):
                raise


class Echo(NamedTuple):
    """Topic on which the sent velocities are published: as the payload of this number, or as a Twist."""

    topic: Topic
    output: int | None = None  # None: as a Twist


class Connection(Protocol):
    """Device of one link, as its gates and its robot know it."""

    link: Link
    diagnosis: Diagnosis
    settings: CommandSettings  # of its robot's command
    drivables: "list[Drivable]"  # with their gates; set by Gates
    stop_frames: list[bytes]  # frames that the guardian sends to stop it; set by Gates
    lost: "dict[str, LostEndpoint]"  # velocity endpoints that an announcement gave up; set by Gates

    @property
    def stop_service(self) -> str | None:
        """Service that stops it by the settings, as it announces it; None: they name none."""

    def stop_unguarded(self) -> None:
        """Send zero to each endpoint that looks like a command and has no gate. Older messages to it are dropped."""

    def unguarded_endpoints(self) -> list[CommandEndpoint]:
        """Return its endpoints that look like commands and have no gate, after `stop_unguarded`."""


@dataclass(eq=False, kw_only=True)
class Drivable(VelocityTarget):
    """Command topics of a device, with their gate, which is their only subscriber in the graph.

    It belongs to a robot, or is a velocity topic that the settings exclude from robots.
    """

    name: str  # of the robot, or of the topic in the graph
    commands: CommandType  # its topics by the names that the device uses, and how they are encoded
    gate: VelocityGate[Any]  # of a PlanarVelocity for a robot, else of a Twist
    gates: "Gates"
    connection: Connection | None = None  # in the registry of links (`Robots.devices`)
    echoes: dict[str, Echo] = field(default_factory=dict)  # by the topic's name
    # For each command topic: takes its zeros, even if a damaged announcement gave it up; None: none fits.
    endpoints: tuple[DeviceEndpoint | None, ...] = ()
    stop_call: DeviceEndpoint | None = None  # takes the requests of the service that is called with each zero
    is_lost: bool = False  # the device's announcement lacks it: it only receives zeros
    is_given_up: bool = False  # the device announced twice that it lacks it: detached when its zeros were sent
    resumed_link: int = 0  # number of the link since which no reconnection was an interruption
    sent: AnyVelocity = ZERO
    sent_at_s: float = 0.0
    refusals: Refusals = field(default_factory=Refusals)
    admission: Admission = field(init=False)  # that of the gate

    def __post_init__(self) -> None:
        self.admission = self.gate.admission

    @property
    def link(self) -> Link | None:
        """Link of the device; None if it is not connected."""
        return None if self.connection is None else self.connection.link

    @property
    def beside(self) -> list["Drivable"]:
        """All velocity topics of the link, including this one."""
        return [self] if self.connection is None else list(self.connection.drivables)

    @property
    def zeros(self) -> tuple[bytes, ...]:
        """Payload for each command topic that stops the device."""
        return self.commands.encode(ZERO, self.gates.wall_ns())

    @property
    def no_stop(self) -> str:
        """Return why its device cannot be stopped although it takes a zero; empty if it can."""
        service = None if self.connection is None else self.connection.settings.stop_service
        if service is None or self.stop_call is not None:
            return ""
        return (
            f"its device has no service {service} of type {' or '.join(STOP_SERVICE_TYPES)}, which stop_service names"
        )

    def decode(self, message: Message) -> Published:
        """Decode a published command of a type that this device obeys, or a Twist."""
        return self.commands.decode(message.topic, message.type_name, message.payload)

    def command(self, command: Command[V]) -> V:
        """Drive through the gate; as `VelocityTarget.command`."""
        return self.gates.command(self, command)


class LostEndpoint(NamedTuple):
    """Endpoint that an announcement gave up, and the payload that stops it."""

    info: DeviceEndpoint
    zero: bytes


def _stop_call_of(connection: Connection) -> DeviceEndpoint | None:
    """Return the endpoint of the service that stops a device, by its robot's settings; None if it has none."""
    service = connection.stop_service
    if service is None:
        return None
    try:
        info = connection.link.session.service_endpoint(service, b"")
    except HostlinkError:
        return None
    return info if info.type in STOP_SERVICE_TYPES else None


class Gates:
    """Sender of the velocities of all gates. Methods are synchronous; `run` is the clock."""

    def __init__(
        self,
        isolation: Isolation,
        guard: Guard | None = None,
        events: RobotEvents | None = None,
        *,
        slept_s: Callable[[], float],
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """`guard` stops the devices when this process cannot. `events` gets commands and stops.

        `slept_s` returns for how long the computer has slept so far, `wall_ns` the time of day.
        """
        self.events = RobotEvents() if events is None else events
        self.wall_ns = wall_ns
        self.is_closed = False  # the daemon ends and accepts no commands
        self.providers = Providers()  # of robots of other hosts
        self._isolation, self._guardian = isolation, guard
        self._driven = set[int]()  # links of the last beat to the guardian
        self._admissions: Counter[Admission] = Counter()  # registrations of all robots and attached drivables
        self._active: dict[Drivable, None] = {}  # drivables whose gate may have a velocity to send
        self._wake = asyncio.Event()
        self._stalls = StallWatch(slept_s)
        self._noticed_s = float("-inf")  # when it was last looked for a pause
        self._unwritten: dict[Link, None] | None = None  # links with a velocity, between `hold` and `write`

    # -- which there are ----------------------------------------------------------------------------------------------

    def attach(self, drivable: Drivable, connection: Connection, *, lost: DeviceEndpoint | None = None) -> None:
        """Attach a velocity topic to its device. Earlier commands are void: the first velocity is zero.

        `lost` is its endpoint if the device's announcement lacks it.
        """
        drivable.connection, drivable.is_lost = connection, lost is not None
        drivable.endpoints = self._endpoints_of(drivable, connection) if lost is None else (lost,)
        drivable.stop_call = _stop_call_of(connection)
        self.register(drivable.admission)
        now_s = loop_time_s()
        if drivable.gate.admission.connect(now_s, came_s=self.came_s(now_s)):
            drivable.resumed_link = connection.link.number
        drivable.gate.restart()
        if not connection.drivables:
            connection.link.last_frames = ()
        connection.drivables.append(drivable)
        self._guard(drivable, connection)
        self._activate(drivable)

    def detach(self, connection: Connection) -> None:
        """Detach all velocity topics from a link, after a last zero to those that may move."""
        drivables, connection.drivables = connection.drivables, []
        for drivable in drivables:
            with self._isolation.around("robot", robot=drivable.name):  # the others must be detached, too
                self._send_last_zero(drivable, connection)
            drivable.connection = None
            drivable.echoes.clear()
            drivable.gate.admission.disconnect(loop_time_s())
            self.unregister(drivable.admission)
            drivable.gate.restart()
            self._activate(drivable)
        stops, connection.stop_frames = connection.stop_frames, []
        if stops and self._guardian is not None:
            self._guardian.release(connection.link.number)

    def give_up_lost(self, connection: Connection) -> None:
        """Detach lost velocity topics when their zeros were sent: the device has announced the same topics again."""
        for drivable in connection.drivables:
            if drivable.is_lost:
                drivable.is_given_up = True
                self._activate(drivable)

    def _detach_lost(self, drivable: Drivable, connection: Connection) -> None:
        connection.drivables.remove(drivable)
        drivable.connection = None
        self.unregister(drivable.admission)
        self._active.pop(drivable, None)
        if self._guardian is not None and connection.stop_frames:
            self._guardian.release(connection.link.number)
        connection.link.last_frames = ()
        connection.stop_frames = []
        for other in connection.drivables:
            self._guard(other, connection)

    def register(self, admission: Admission) -> None:
        """Register an admission: pauses of the process interrupt it, and sources that leave are withdrawn from it.

        It is registered for a robot and for each of its drivables, and is unregistered as often.
        """
        self._admissions[admission] += 1

    def unregister(self, admission: Admission) -> None:
        """End one registration."""
        self._admissions[admission] -= 1
        if not self._admissions[admission]:
            del self._admissions[admission]

    # -- driving ------------------------------------------------------------------------------------------------------

    def command(self, drivable: Drivable, command: Command[V]) -> V:
        """Drive a device here; as `VelocityTarget.command`."""
        gate: VelocityGate[V] = drivable.gate
        velocity, owner = command.velocity, command.source
        is_zero = velocity.is_zero
        try:
            now_s = asyncio.get_running_loop().time()
            command = self.timed(drivable.name, command, now_s)
            if not is_zero and drivable.no_stop:
                raise CommandRefused(drivable.name, RefusalKind.NOT_CONNECTED, f"{drivable.name}: {drivable.no_stop}")
            # Two zeros at the same time would become one frame on a slow line.
            is_stopping = is_zero and gate.is_stopping and drivable.refusals.cause is None
            driver = gate.owner
            limited = gate.command(command, now_s=now_s)
            ended = gate.pop_ended()
            refusal = None if is_stopping else self._step(drivable, now_s, is_news=True)
            if ended is not None and (refusal is None or driver is None):
                self._note_ended(drivable, ended, now_s)
            if refusal is not None:
                gate.admission.end_drives(owner)
                gate.stop(now_s=now_s)
                if driver is not None:
                    self._note_stop(drivable, NOT_TAKEN, str(driver))
                raise refusal
        except HostlinkError as error:
            if gate.driver is not None and gate.admission.driver(gate, loop_time_s()) is None:
                self._step(drivable, loop_time_s(), is_news=True)  # the command has ended the drive of its source
            if not (is_zero and command.is_planar):
                self.events.note(EventKind.REFUSED, drivable.name, **facts_of(command), reason=str(error))
            raise
        connection = drivable.connection
        if connection is not None and len(connection.drivables) > 1 and not is_zero:
            self._overrule(connection.drivables, drivable)
        is_continued = driver is owner and ended is None and not is_zero
        self.events.note_commanded(drivable.name, command, limited, now_s, is_continued=is_continued)
        return limited

    def hold(self) -> None:
        """Keep velocities in their links until `write`, which saves a turn of the loop. The caller must call it."""
        self._unwritten = {}

    def write(self) -> None:
        """Write the velocities since `hold`: the newest of each topic."""
        links, self._unwritten = self._unwritten, None
        if links:
            now_s = asyncio.get_running_loop().time()
            if now_s >= self._noticed_s + SETTLE_S:  # otherwise a command of this turn has looked for a pause
                self._notice_pause(now_s)
            for link in links:
                link.write_now(now_s)

    def timed(self, name: str, command: Command[V], now_s: float) -> Command[V]:
        """Return the command with the earliest time of its arrival: it may have waited while the loop was late.

        Every command of a robot, here or of another daemon, passes through here before its admission.

        Raises:
            CommandRefused: the daemon stops.
        """
        if self.is_closed:
            raise CommandRefused(name, RefusalKind.ENDING, f"{name}: {ENDING}")
        self._notice_pause(now_s)
        came_s = now_s - self._stalls.late_s(now_s)
        return command._replace(received_s=came_s) if came_s < command.received_s else command

    def came_s(self, now_s: float) -> float:
        """Return the earliest arrival time of bytes that are read now."""
        return now_s - self._stalls.late_s(now_s)

    def _notice_pause(self, now_s: float) -> None:
        """Interrupt every robot, here or of another daemon, if this process has just resumed after a pause."""
        since_s, self._noticed_s = self._stalls.pop_pause(now_s), now_s
        if since_s is not None:
            for admission in tuple(self._admissions):  # also of a robot at rest: its sources may be disarmed
                admission.interrupt(now_s, since_s=since_s, came_s=since_s, by="a pause of hostlink")
            for drivable in [each for each in self._active if each.gate.may_move]:
                self._step(drivable, now_s)  # its zero replaces a velocity that is not written yet

    def _overrule(self, beside: list[Drivable], drivable: Drivable) -> None:
        """Stop the other velocity topics of the robot whose leases the newest command has ended."""
        now_s = loop_time_s()
        for other in beside:
            gate = other.gate
            if gate is drivable.gate or gate.admission is not drivable.gate.admission or gate.driver is None:
                continue
            if now_s < gate.driver.deadline_s and gate.admission.driver(gate, now_s) is None:
                self._note_stop(other, OVERRULED, str(gate.owner_name))
                gate.stop(now_s=now_s)
                self._step(other, now_s, is_news=True)

    def release(self, owner: Hashable) -> None:
        """Stop everything that a source drives, because it has left."""
        self.providers.release(owner)
        for admission in self._admissions:
            admission.withdraw(owner)
        self.let_go(list(self._active), owner, OWNER_LEFT)

    def let_go(self, drivables: Iterable[Drivable], owner: Hashable, reason: str) -> None:
        """Stop those of the drivables that a source drives, because it has left, or says why it drives no more."""
        now_s = loop_time_s()
        for drivable in drivables:
            gate = drivable.gate
            if gate.owner == owner:
                gate.stop(now_s=now_s)
                self._note_stop(drivable, reason, str(owner))
                self._step(drivable, now_s, is_news=True)

    def stop(self, drivables: Iterable[Drivable], *, by: str | None = None) -> None:
        """Stop these within their deceleration limits, for every source. `by` is who stops them.

        Raises:
            HostlinkError: the zero does not fit a device; all others have been stopped.
        """
        drivables, now_s, refusal = list(drivables), loop_time_s(), None
        driven = [(drivable, str(drivable.gate.owner)) for drivable in drivables if drivable.gate.owner is not None]
        for admission in {drivable.admission for drivable in drivables}:  # velocity topics of one robot share one
            admission.interrupt(now_s, came_s=self.came_s(now_s), by=named("a stop", by))
        for drivable in drivables:
            drivable.gate.counts.stops += 1
            drivable.gate.stop(now_s=now_s)
            refusal = self._halt(drivable, now_s) or refusal
        for drivable, owner in driven:
            self._note_stop(drivable, WAS_STOPPED, owner)
        if refusal is not None:
            raise refusal

    def note_missing(self, drivables: Iterable[Drivable], missing: str) -> None:
        """Stop these topics of a robot of several devices, of which one is missing, until `missing` is empty."""
        drivables, now_s = list(drivables), loop_time_s()
        if missing:
            for drivable in drivables:
                self.note_end(drivable, missing)
        for admission in {drivable.admission for drivable in drivables}:
            admission.note_missing(missing, now_s, came_s=self.came_s(now_s))
        for drivable in drivables:
            if missing and drivable.gate.may_move:
                drivable.gate.stop(now_s=now_s)
                self._step(drivable, now_s, is_news=True)

    async def settled(self) -> list[CommandEndpoint]:
        """Wait until the providers of remote robots have answered the stops, locks and unlocks so far.

        Return their endpoints that command a motion and are not a robot's.

        Raises:
            DeviceGone: one of them has not answered.
        """
        return await self.providers.settled()

    def stop_at_once(self, drivables: Iterable[Drivable]) -> None:
        """Send zero at once, without the limits. Devices that it does not fit are skipped."""
        now_s = loop_time_s()
        for drivable in drivables:
            drivable.gate.stop_at_once()
            self._step(drivable, now_s, is_news=True)

    def lock(self, drivables: Iterable[Drivable], reason: str, *, by: str | None = None) -> None:
        """Send zero at once, and refuse commands until `unlock`. `by` is who locks.

        Raises:
            HostlinkError: the zero does not fit a device; its gate is locked nevertheless.
        """
        drivables, now_s, refusal = list(drivables), loop_time_s(), None
        for admission in {drivable.admission for drivable in drivables}:
            admission.lock(reason, now_s, by=by)
        for drivable in drivables:
            drivable.gate.stop_at_once()
            refusal = self._halt(drivable, now_s) or refusal
        if refusal is not None:
            raise refusal

    def _halt(self, drivable: Drivable, now_s: float) -> HostlinkError | None:
        """Send the velocity of a gate that was stopped. Return the error if the newest does not fit its device."""
        error = self._step(drivable, now_s, is_news=True)
        if error is None and drivable.connection is not None:
            error = drivable.refusals.error  # of an earlier zero, while the next one is not due
        return error

    def unlock(self, drivables: Iterable[Drivable], *, by: str | None = None) -> None:
        """Admit commands again. Unlocking moves nothing."""
        now_s = loop_time_s()
        for admission in {drivable.admission for drivable in drivables}:
            admission.unlock(now_s, came_s=self.came_s(now_s), by=by)

    def pauses(self, now_s: float) -> HostPauses:
        """Return the pauses of this process. One that has just ended interrupts every robot first."""
        self._notice_pause(now_s)
        return self._stalls.noticed

    def refuse_all(self) -> None:
        """Refuse every command from now on, because the daemon ends."""
        self.is_closed = True

    # -- the clock ----------------------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Step every active gate. Sleep while none is active."""
        loop = asyncio.get_running_loop()
        while True:
            now_s = loop.time()
            self._notice_pause(now_s)
            self._stalls.beat(now_s)
            driven = set[int]()
            for number, drivable in enumerate(list(self._active), 1):
                if number % MAX_STEPS == 0:
                    await asyncio.sleep(0)
                    now_s = loop.time()
                connection, gate = drivable.connection, drivable.gate
                if gate.driver is not None and now_s < drivable.sent_at_s + FEED_INTERVAL_S and gate.stays(now_s):
                    if connection is not None:
                        driven.add(connection.link.number)
                    continue  # it is driven at its target, and was sent that a short time ago
                if drivable.is_given_up and connection is not None and not gate.may_move:
                    self._detach_lost(drivable, connection)
                elif gate.may_move or (gate.is_active and connection is not None):
                    self._step(drivable, now_s)
                elif not gate.admission.is_held(now_s):
                    self._active.pop(drivable, None)
                if connection is not None and gate.may_move:
                    driven.add(connection.link.number)
            self._beat(driven)
            self.events.flush()
            if self._active:
                due_s = now_s + TICK_S
                for drivable in self._active:
                    driver = drivable.gate.driver
                    if driver is not None and driver.deadline_s < due_s:
                        due_s = driver.deadline_s
                self._stalls.expect(due_s)
                await asyncio.sleep(due_s - now_s)
            else:
                await self._idle()

    async def _idle(self) -> None:
        """Wait until a gate is active, or for BEAT_S: pauses must be noticed also while no robot moves."""
        self._wake.clear()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(BEAT_S):
                await self._wake.wait()

    def _activate(self, drivable: Drivable) -> None:
        self._active[drivable] = None
        self._wake.set()

    def _step(self, drivable: Drivable, now_s: float, *, is_news: bool = False) -> HostlinkError | None:
        """Send the gate's velocity if it is due. Return the error if it does not fit the device.

        `is_news`: the gate has just changed, so the velocity is due. A crash here ends the link of this device, with a
        zero as its last frame.
        """
        if is_news:
            self._active[drivable] = None
            self._wake.set()
        gate, connection = drivable.gate, drivable.connection
        is_fed = not is_news and now_s < drivable.sent_at_s + FEED_INTERVAL_S
        try:
            if is_fed and gate.stays(now_s):
                return None
            # The next of three zeros would replace one that waits for the device.
            is_next_zero = gate.is_stopping and gate.current.is_zero and drivable.sent.is_zero
            if is_next_zero and connection is not None and connection.link.session.outbox.has_urgent:
                return None
            is_first = gate.is_new_device
            velocity = gate.step(now_s)
            ended = gate.pop_ended()
            if ended is not None:
                self._note_ended(drivable, ended, now_s)
            if velocity is None or connection is None:
                return None
            link, is_zero = connection.link, velocity.is_zero
            if not is_zero and link.number not in self._driven:
                self._beat(self._driven | {link.number})  # before it moves
            if is_fed and velocity == drivable.sent and not is_zero:
                return None
            payloads = drivable.commands.encode(velocity, self.wall_ns())
            try:
                self._put(drivable, link, payloads, is_zero=is_zero, is_kept=is_first)
                # Frames that would delay a stop on a slow line are held back or refused while the robot moves.
                link.session.outbox.robot_moves = (
                    not is_zero or gate.may_move or any(each.gate.may_move for each in connection.drivables)
                )
            except HostlinkError as error:
                drivable.refusals.add(drivable.name, error)
                return error
            drivable.refusals.error = None
            drivable.sent, drivable.sent_at_s = velocity, now_s
            if self._unwritten is None:
                link.wake()
            else:
                self._unwritten[link] = None
            for topic, output in drivable.echoes.values():
                payload = velocity.encode() if output is None else payloads[output]
                topic.deliver(payload, source=drivable, at_s=now_s)
        except Exception as error:  # noqa: BLE001 - counted; the other gates are stepped
            if connection is not None:
                connection.link.end(LinkEnd.CRASHED)
            self._isolation.crashed("robot", error, robot=drivable.name)
            return DeviceGone(drivable.name)
        return None

    def note_end(self, drivable: Drivable, reason: str) -> None:
        """Note that a drive ends, if there is one. The caller ends it."""
        owner = drivable.gate.owner_name
        if owner is not None:
            self._note_stop(drivable, reason, owner)

    def _note_ended(self, drivable: Drivable, ended: EndedLease, now_s: float) -> None:
        was_away = self._stalls.pauses(now_s).was_paused(now_s - LEASE_S)
        reason = LET_GO if ended.was_let_go else HOST_AWAY if was_away else LEASE_ENDED
        self._note_stop(drivable, reason, str(ended.lease.source))

    def _note_stop(self, drivable: Drivable, reason: str, owner: str) -> None:
        log.info("robot.stopped", robot=drivable.name, reason=reason, owner=owner)
        self.events.note(EventKind.STOPPED, drivable.name, reason=reason, owner=owner)

    def _put(
        self, drivable: Drivable, link: Link, payloads: tuple[bytes, ...], *, is_zero: bool, is_kept: bool = False
    ) -> None:
        """Queue a velocity for each command topic; a zero for the endpoints that took the ones before.

        Raises:
            HostlinkError: it does not fit the device; a zero was queued for the topics that it fits.
        """
        refusal: HostlinkError | None = None
        if is_zero and drivable.stop_call is not None:
            link.session.send_zero(drivable.stop_call, b"", is_kept=is_kept)
        for topic, payload, info in zip(drivable.commands.topics, payloads, drivable.endpoints, strict=True):
            if info is not None and is_zero and link.session.send_zero(info, payload, is_kept=is_kept):
                continue
            try:
                link.session.publish(topic.name, payload, is_urgent=True, is_kept=is_kept)
            except HostlinkError as error:
                refusal = error
                if not is_zero:  # the caller stops the other wheels, too
                    break
        if refusal is not None:
            raise refusal

    def _send_last_zero(self, drivable: Drivable, connection: Connection) -> None:
        """Send the last zero. The device may have announced other topics, may have another link, or may be gone."""
        link = connection.link
        if drivable.gate.may_move:
            with contextlib.suppress(HostlinkError):
                self._put(drivable, link, drivable.zeros, is_zero=True)
            link.wake()
        for info, zero in zip(drivable.endpoints, drivable.zeros, strict=True):
            if info is not None and not link.session.has(info):
                connection.lost[info.name] = LostEndpoint(info, zero)

    def _beat(self, driven: set[int]) -> None:
        """Report to the guardian that this process runs, and which links have robots that may move."""
        self._driven = driven
        if self._guardian is not None:
            self._guardian.beat(driven)

    def _endpoints_of(self, drivable: Drivable, connection: Connection) -> tuple[DeviceEndpoint | None, ...]:
        """Return the endpoints that take zeros: each the announced one, or the earlier one if a zero does not fit."""
        session, found = connection.link.session, list[DeviceEndpoint | None]()
        for topic, zero in zip(drivable.commands.topics, drivable.zeros, strict=True):
            lost = connection.lost.get(topic.name)
            try:
                found.append(session.endpoint_of(topic.name, zero))
            except HostlinkError:
                found.append(lost.info if lost is not None and session.may_have(lost.info) else None)
        return tuple(found)

    def _guard(self, drivable: Drivable, connection: Connection) -> None:
        """Give link and guardian the frames that stop the device when this process cannot."""
        link, stops = connection.link, connection.stop_frames
        # Without a stamp: that of now would be old by then.
        zeros = [*zip(drivable.endpoints, drivable.commands.encode(ZERO), strict=True), (drivable.stop_call, b"")]
        for info, zero in zeros:
            if info is not None:
                before = len(stops)
                stops += link.session.zero_frames(info, zero)
                if before <= MAX_GUARDED < len(stops) and self._guardian is not None:
                    log.warning("guardian.frames_dropped", link=link.number, guarded=MAX_GUARDED)
        link.last_frames = link.session.stop_frames(tuple(stops)).last_writes
        if self._guardian is not None and stops:
            self._guardian.watch(link.number, link.descriptor, link.session.stop_frames(tuple(stops[:MAX_GUARDED])))
