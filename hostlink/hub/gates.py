"""Gates: every velocity gate, and the one clock of all. No velocity reaches a device but through here."""

import asyncio
import contextlib
import weakref
from collections.abc import Callable, Hashable, Iterable
from typing import Any

import structlog

from hostlink.errors import CommandRefused, DeviceGone, HostlinkError, RefusalKind, WrongType
from hostlink.host_pauses import HostPauses
from hostlink.hub.drivable import Drivable
from hostlink.hub.guard import Guard
from hostlink.hub.isolation import Isolation
from hostlink.hub.message import Message
from hostlink.hub.node import address_of
from hostlink.hub.remote_robot import Elsewhere, RemoteRobot
from hostlink.hub.robot import Robot
from hostlink.hub.robot_events import HOST_AWAY, LEASE_ENDED, LET_GO, OWNER_LEFT, WAS_STOPPED, EventKind, RobotEvents
from hostlink.hub.stall_watch import BEAT_S, StallWatch
from hostlink.hub.topic import Topic
from hostlink.link.link import Link, LinkEnd
from hostlink.robot.admission import LEASE_S, Admission, Command
from hostlink.robot.velocity import TWIST_TYPE, ZERO, Kinematics, PlanarVelocity, Twist
from hostlink.robot.velocity_gate import V, VelocityGate

log = structlog.get_logger()

TICK_S = 0.05  # between two steps of a ramp; the end of a lease is not waited past
MAX_STEPS = 64  # of gates in one turn of the loop: a device may have 256, and a stop comes in between
FEED_INTERVAL_S = 0.125  # a source that commands at 10 Hz feeds the device by itself; a quarter of its own watchdog
MAX_GUARDED = 16  # velocity topics of a device that the guard stops; each that comes must be sent to it
ENDING = "hostlink is stopping, and drives no robot any more"


class Gates:
    """What each link can be driven by. Methods are synchronous; `run` is the clock."""

    def __init__(self, isolation: Isolation, guard: Guard | None = None, events: RobotEvents | None = None) -> None:
        """`guard` stops the devices when this process cannot any more; `events` has what is commanded and stopped."""
        self.events = RobotEvents() if events is None else events
        self.is_closed = False  # the daemon ends, and drives nobody any more
        self.elsewhere: Elsewhere | None = None  # the way to the gates of other daemons
        self._isolation, self._guardian = isolation, guard
        self._of_link: dict[Link, list[Drivable]] = {}
        self._topic_ids: dict[Link, list[int]] = {}  # that the guard knows
        self._driven = set[int]()  # links, as the guard knows them
        self._remote: weakref.WeakSet[RemoteRobot] = weakref.WeakSet()  # that were commanded here
        self._active: dict[Drivable, None] = {}  # whose gate may have something to send
        self._wake = asyncio.Event()
        self._stalls = StallWatch()

    # -- which there are ----------------------------------------------------------------------------------------------

    def attach(self, drivable: Drivable, link: Link) -> None:
        """Its device is ready: no earlier command is valid any more, and its first velocity is zero."""
        drivable.link, drivable.last_frame = link, b""
        if drivable.gate.admission.connect(_now_s()) and isinstance(drivable, Robot):
            drivable.resumed_link = link.number
        drivable.gate.restart()
        if link not in self._of_link:
            self._of_link[link], self._topic_ids[link] = [], []
            link.last_frame = b""
        self._of_link[link].append(drivable)
        self._guard(drivable, link)
        self._activate(drivable)

    def detach(self, link: Link) -> None:
        """Nothing is driven by this link any more: what may move is sent a zero."""
        drivables = self._of_link.pop(link, [])
        for drivable in drivables:
            with self._isolation.around("robot", robot=drivable.name):  # the others must be detached, too
                self._send_last_zero(drivable, link)
            drivable.link = None
            drivable.echoes.clear()
            drivable.gate.admission.disconnect(_now_s())
            drivable.gate.restart()
            self._activate(drivable)
        if self._topic_ids.pop(link, None) and self._guardian is not None:
            self._guardian.release(link.number)

    def all(self) -> list[Drivable]:
        """Whatever can be driven now."""
        return [drivable for drivables in self._of_link.values() for drivable in drivables]

    def of_link(self, link: Link | None) -> list[Drivable]:
        """What is driven by this link, a robot's own velocity first."""
        return [] if link is None else list(self._of_link.get(link, ()))

    def beside(self, drivable: Drivable) -> list[Drivable]:
        """This one, and whatever else is driven by the same link."""
        return self.of_link(drivable.link) or [drivable]

    def reach(self, elsewhere: Elsewhere | None) -> None:
        """This is the way to the gates of other daemons from now on; None: there is none any more."""
        self.elsewhere = elsewhere
        self._wake.set()

    # -- driving ------------------------------------------------------------------------------------------------------

    def join(self, drivable: Drivable | RemoteRobot, topic: Topic) -> None:
        """Note that a gate subscribes to a topic which others may be publishing already."""
        drivable.gate.admission.join(topic.publishers, _now_s())

    def receive(self, drivable: Drivable, message: Message) -> None:
        """The gate's end of a velocity topic: a Twist is a command of its publisher.

        Raises:
            HostlinkError: as `command`.
            WrongType: it is not a Twist.
        """
        if message.type_name != TWIST_TYPE:
            raise WrongType(message.topic, TWIST_TYPE, message.type_name)
        self.follow(drivable, Twist.decode(message.payload), message)

    def follow(
        self,
        drivable: Drivable | RemoteRobot,
        twist: Twist,
        message: Message,
        *,
        stamp_age_s: float | None = None,
    ) -> None:
        """Obey a velocity that was published. A joystick at rest publishes zeros beside the driver: that is no error.

        A robot has three of the six numbers; a velocity topic that belongs to no robot has them all.

        Raises:
            HostlinkError: as `command`.
        """
        is_spatial = drivable.gate.admission.kinematics is Kinematics.SPATIAL
        velocity: PlanarVelocity | Twist = twist if is_spatial else twist.planar
        command: Command[Any] = Command(
            velocity,
            message.source,
            message.priority,
            message.at_s,
            epoch=message.epoch,
            stamp_age_s=stamp_age_s,
            is_planar=is_spatial or twist.is_planar,
        )
        try:
            self.command(drivable, command)
        except CommandRefused as refused:
            if not (velocity.is_zero and refused.kind is RefusalKind.HELD):
                raise

    def command(self, drivable: Drivable | RemoteRobot, command: Command[V]) -> V:
        """Drive for the length of a lease, if the command is admitted; returns the velocity after the limits.

        Raises:
            CommandRefused: the robot's admission has refused it, or the daemon stops.
            FrameTooLarge, WrongType, UnknownTopic: the command does not fit the device; then its source drives no more.
            DeviceGone: another daemon has the robot, and does not answer.
        """
        velocity = command.velocity
        owner = command.source
        facts = {"owner": str(owner), "address": address_of(owner), "priority": command.priority, "velocity": velocity}
        try:
            limited: V = self._command(drivable, command)
        except HostlinkError as error:
            if isinstance(drivable, Drivable) and not (velocity.is_zero and command.is_planar):
                self.events.note(EventKind.REFUSED, drivable.name, **facts, reason=str(error))
            raise
        if isinstance(drivable, Drivable):
            self.events.note(EventKind.COMMANDED, drivable.name, **facts, limited=limited)
        return limited

    def _command(self, drivable: Drivable | RemoteRobot, command: Command[Any]) -> Any:
        if self.is_closed:
            raise CommandRefused(drivable.name, RefusalKind.ENDING, f"{drivable.name}: {ENDING}")
        now_s = _now_s()
        self._notice_pause(now_s)
        command = command._replace(received_s=min(command.received_s, self.came_s(now_s)))
        if isinstance(drivable, RemoteRobot):
            self._remote.add(drivable)
            return drivable.command(command, now_s)
        gate, velocity = drivable.gate, command.velocity
        # Two zeros of one moment would leave a slow line as one.
        is_stopping = velocity.is_zero and gate.is_stopping and drivable.refusals.cause is None
        limited = gate.command(command, now_s=now_s)
        if not is_stopping:
            refusal = self._send_news(drivable)
            if refusal is not None:
                gate.admission.withdraw(command.source)
                gate.stop(now_s=now_s)
                raise refusal
        beside = self._of_link.get(drivable.link, []) if drivable.link is not None else []
        if len(beside) > 1 and not velocity.is_zero:
            self._overrule(beside, drivable, command.source, command.priority)
        return limited

    def came_s(self, now_s: float) -> float:
        """Since when something that is read at this moment may have waited for it."""
        return now_s - self._stalls.late_s(now_s)

    def _notice_pause(self, now_s: float) -> None:
        """Interrupt every robot, here or of another daemon, if this process has just gone on after a pause."""
        since_s = self._stalls.pop_pause(now_s)
        if since_s is not None:
            for admission in self._admissions(self._active) | {robot.gate.admission for robot in self._remote}:
                admission.interrupt(now_s, since_s=since_s)

    def _overrule(self, beside: list[Drivable], drivable: Drivable, owner: Hashable, priority: int) -> None:
        """Stop what somebody less important drives of the same robot; its next command is refused."""
        for other in beside:
            gate = other.gate
            is_other = gate is not drivable.gate and gate.admission is drivable.gate.admission
            if is_other and gate.owner != owner and gate.priority is not None and gate.priority < priority:
                self._note_stop(other, "overruled", str(gate.owner_name))
                gate.stop(now_s=_now_s())
                self._send_news(other)

    def release(self, owner: Hashable) -> None:
        """A source of commands is gone: what it drives stops."""
        if self.elsewhere is not None:
            self.elsewhere.release(owner)
        for robot in self._remote:
            robot.gate.admission.withdraw(owner)
        now_s = _now_s()
        for drivable in list(self._active):
            gate = drivable.gate
            is_driving = gate.owner == owner
            gate.admission.withdraw(owner)  # also what it holds without driving now
            if is_driving:
                gate.stop(now_s=now_s)
                self._note_stop(drivable, OWNER_LEFT, str(owner))
                self._send_news(drivable)

    def stop(self, robot: Robot | RemoteRobot) -> None:
        """Stop it, and whatever else its link drives, as fast as decelerations allow, whoever drives.

        Raises:
            HostlinkError: the zero does not fit the device.
        """
        if self.elsewhere is not None and (isinstance(robot, RemoteRobot) or robot.also_at):
            self.elsewhere.stop(robot.name)
        if not isinstance(robot, RemoteRobot):
            self.stop_here(robot)

    def stop_here(self, robot: Robot) -> None:
        """Stop a robot of this daemon.

        Raises:
            HostlinkError: the zero does not fit the device.
        """
        self._stop(self.beside(robot))

    def stop_all(self) -> None:
        """Stop whatever can be driven.

        Raises:
            HostlinkError: the zero does not fit a device; all others have been stopped.
        """
        if self.elsewhere is not None:
            self.elsewhere.stop(None)
        self.stop_all_here()

    def stop_all_here(self) -> None:
        """Stop whatever this daemon drives.

        Raises:
            HostlinkError: the zero does not fit a device; all others have been stopped.
        """
        self._stop(self.all())

    async def settled(self) -> None:
        """Wait until other daemons have answered the stops, locks and unlocks so far.

        Raises:
            DeviceGone: one of them has not answered.
        """
        if self.elsewhere is not None:
            await self.elsewhere.settled()

    def stop_at_once(self, drivables: Iterable[Drivable]) -> None:
        """Zero, whatever the limits; a device that it does not fit is passed over."""
        for drivable in drivables:
            drivable.gate.stop_at_once()
            self._send_news(drivable)

    def lock(self, drivables: Iterable[Drivable], reason: str) -> None:
        """Zero at once, and no command until the gates are unlocked.

        Raises:
            HostlinkError: the zero does not fit a device; its gate is locked all the same.
        """
        drivables = list(drivables)
        for admission in self._admissions(drivables):
            admission.lock(reason, _now_s())
        for drivable in drivables:
            drivable.gate.counts.locks += 1
        self._apply(VelocityGate.stop_at_once, drivables)

    def unlock(self, drivables: Iterable[Drivable]) -> None:
        """Admit commands again; nothing moves by it."""
        for admission in self._admissions(drivables):
            admission.unlock(_now_s())

    def pauses(self, now_s: float) -> HostPauses:
        """When this process did not run."""
        return self._stalls.pauses(now_s)

    def close(self) -> None:
        """The daemon ends: no command is accepted any more, for good."""
        self.is_closed = True

    # -- the clock ----------------------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Step every gate that is active; sleep while none is."""
        while True:
            now_s = _now_s()
            self._notice_pause(now_s)
            self._stalls.beat(now_s)
            driven = set[int]()
            for number, drivable in enumerate(list(self._active), 1):
                if number % MAX_STEPS == 0:
                    await asyncio.sleep(0)
                    now_s = _now_s()
                if drivable.gate.may_move or (drivable.gate.is_active and drivable.link is not None):
                    self._step(drivable, now_s)
                elif not drivable.gate.admission.is_held(now_s):
                    self._active.pop(drivable, None)
                if drivable.link is not None and drivable.gate.may_move:
                    driven.add(drivable.link.number)
            self._beat(driven)
            if self._active:
                due_s = min(now_s + TICK_S, *(drivable.gate.lease_ends_s for drivable in self._active))
                self._stalls.expect(due_s)
                await asyncio.sleep(due_s - now_s)
            else:
                await self._idle()

    async def _idle(self) -> None:
        """Wait until a gate is active, or for a beat: what was paused must be known of every link."""
        self._wake.clear()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(BEAT_S):
                await self._wake.wait()

    def _stop(self, drivables: Iterable[Drivable]) -> None:
        now_s, drivables = _now_s(), list(drivables)
        for admission in self._admissions(drivables):
            admission.interrupt(now_s)
        for drivable in drivables:
            drivable.gate.counts.stops += 1
            if drivable.gate.owner is not None:
                self._note_stop(drivable, WAS_STOPPED, str(drivable.gate.owner))
        self._apply(lambda gate: gate.stop(now_s=now_s), drivables)

    def _apply(self, change: Callable[[VelocityGate[Any]], None], drivables: Iterable[Drivable]) -> None:
        """Change each gate and send what follows; the last refusal is raised once all are done."""
        refusal = None
        for drivable in drivables:
            change(drivable.gate)
            refusal = self._send_news(drivable) or refusal
        if refusal is not None:
            raise refusal

    @staticmethod
    def _admissions(drivables: Iterable[Drivable]) -> set[Admission]:
        """Of these, each once: the velocity topics of one robot share one."""
        return {drivable.gate.admission for drivable in drivables}

    def _activate(self, drivable: Drivable) -> None:
        self._active[drivable] = None
        self._wake.set()

    def _send_news(self, drivable: Drivable) -> HostlinkError | None:
        self._activate(drivable)
        return self._step(drivable, _now_s(), is_news=True)

    def _step(self, drivable: Drivable, now_s: float, *, is_news: bool = False) -> HostlinkError | None:
        """Send what the gate gives, if it is time; returns why it does not fit the device.

        A crash here is this device's own: its link ends, with a zero as its last frame.
        """
        try:
            return self._send(drivable, now_s, is_news=is_news)
        except Exception as error:  # noqa: BLE001 - counted; no other gate may miss its turn
            if drivable.link is not None:
                drivable.link.end(LinkEnd.CRASHED)
            self._isolation.crashed("robot", error, robot=drivable.name)
            return DeviceGone(drivable.name)

    def _send(self, drivable: Drivable, now_s: float, *, is_news: bool) -> HostlinkError | None:
        gate, link = drivable.gate, drivable.link
        previous_owner, is_first, was_let_go = gate.owner, gate.is_new_device, gate.is_let_go
        velocity = gate.step(now_s)
        if previous_owner is not None and gate.owner is None:
            was_away = self._stalls.pauses(now_s).was_paused(now_s - LEASE_S)
            reason = HOST_AWAY if was_away else LET_GO if was_let_go else LEASE_ENDED
            self._note_stop(drivable, reason, str(previous_owner))
        if velocity is None or link is None:
            return None
        if not velocity.is_zero and link.number not in self._driven:
            self._beat(self._driven | {link.number})  # before it moves
        is_repeat = velocity == drivable.sent and not velocity.is_zero and not is_news
        if is_repeat and now_s < drivable.sent_at_s + FEED_INTERVAL_S:
            return None
        payload = velocity.encode()
        try:
            link.session.publish(drivable.velocity_topic, payload, is_urgent=True, is_kept=is_first)
            link.session.keep_clear(robot_moves=any(each.gate.may_move for each in self._of_link.get(link, ())))
        except HostlinkError as error:
            drivable.refusals.add(drivable.name, error)
            return error
        drivable.refusals.cause = None
        drivable.sent, drivable.sent_at_s = velocity, now_s
        link.wake()
        for topic in drivable.echoes.values():
            topic.deliver(payload, source=drivable, at_s=now_s)
        return None

    def _note_stop(self, drivable: Drivable, reason: str, owner: str) -> None:
        log.info("robot.stopped", robot=drivable.name, reason=reason, owner=owner)
        self.events.note(EventKind.STOPPED, drivable.name, reason=reason, owner=owner)

    def _send_last_zero(self, drivable: Drivable, link: Link) -> None:
        """To a device that may have announced other topics, or has another link by now; most often it is gone."""
        if drivable.gate.may_move:
            try:
                link.session.publish(drivable.velocity_topic, ZERO.encode(), is_urgent=True)
            except HostlinkError:
                if drivable.last_frame:
                    link.session.send_last(drivable.last_frame)
            link.wake()

    def _beat(self, driven: set[int]) -> None:
        """Notify the guard that this process runs, and which links have robots that may move."""
        self._driven = driven
        if self._guardian is not None:
            self._guardian.beat(driven)

    def _guard(self, drivable: Drivable, link: Link) -> None:
        """Let link and guard stop it when nobody else can; what subscribes to no velocity cannot be driven."""
        with contextlib.suppress(HostlinkError):
            drivable.last_frame = link.session.frame_to(drivable.velocity_topic, ZERO.encode())
            link.last_frame += drivable.last_frame
            topic_ids = self._topic_ids[link]
            if self._guardian is not None and len(topic_ids) < MAX_GUARDED:
                topic_ids.append(link.session.topic_id(drivable.velocity_topic))
                longest_bytes = link.session.longest_to_device_bytes
                self._guardian.watch(link.number, link.descriptor, topic_ids=topic_ids, claim_bytes=longest_bytes)


def _now_s() -> float:
    return asyncio.get_running_loop().time()
