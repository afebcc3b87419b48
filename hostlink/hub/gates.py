"""Gates: every velocity gate, and the one clock of all. No velocity reaches a device but through here."""

import asyncio
import contextlib
from collections.abc import Callable, Hashable, Iterable

import structlog

from hostlink.errors import BadRequest, DeviceGone, HostlinkError, WrongType
from hostlink.hub.drivable import Drivable
from hostlink.hub.guard import Guard
from hostlink.hub.isolation import Isolation
from hostlink.hub.message import PROGRAM_PRIORITY, Message
from hostlink.hub.node import address_of
from hostlink.hub.remote_robot import Elsewhere, RemoteRobot
from hostlink.hub.robot import Robot
from hostlink.hub.robot_events import EventKind, RobotEvents
from hostlink.hub.stall_watch import BEAT_S, StallWatch
from hostlink.link.link import Link, LinkEnd
from hostlink.robot.velocity import TWIST_TYPE, ZERO, Velocity
from hostlink.robot.velocity_gate import VelocityGate

log = structlog.get_logger()

TICK_S = 0.05  # how late the end of a lease may be noticed
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
        self._active: dict[Drivable, None] = {}  # whose gate may have something to send
        self._wake = asyncio.Event()
        self._stalls = StallWatch()

    # -- which there are ----------------------------------------------------------------------------------------------

    def attach(self, drivable: Drivable, link: Link) -> None:
        """Its device is ready: no earlier command is valid any more, and its first velocity is zero."""
        drivable.link, drivable.last_frame = link, b""
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

    def receive(self, drivable: Drivable, message: Message) -> None:
        """The gate's end of a velocity topic: a Twist is a command of who published it.

        Raises:
            HostlinkError: as `command`.
            WrongType: it is none.
            BadRequest: it arrived a lease ago or earlier, and means nothing any more; or a lock has interrupted it.
        """
        if message.type_name != TWIST_TYPE:
            raise WrongType(message.topic, TWIST_TYPE, message.type_name)
        check_age(drivable, message)
        velocity = Velocity.decode(message.payload)
        self.follow(drivable, velocity, message)

    def follow(self, drivable: Drivable | RemoteRobot, velocity: Velocity, message: Message) -> None:
        """Obey the velocity of a message that was published: its source goes on without waiting for answers.

        Raises:
            HostlinkError: as `command`.
            BadRequest: a lock has interrupted it.
        """
        check_stream(drivable, velocity, message.source)
        self.command(drivable, velocity, owner=message.source, priority=message.priority, now_s=message.at_s)

    def command(
        self,
        drivable: Drivable | RemoteRobot,
        velocity: Velocity,
        *,
        owner: Hashable,
        priority: int = PROGRAM_PRIORITY,
        now_s: float | None = None,
        stops: int | None = None,
    ) -> Velocity:
        """Drive for the length of a lease; returns the velocity after the limits.

        `stops`: as the sender knew them, of a robot of another daemon, which refuses the command after a stop since.

        Raises:
            DeviceGone: the device is not connected, or the daemon stops.
            RobotHeld: another drives with a higher priority, or it is locked.
            BadRequest: the velocity is not finite, or the daemon stood still and the command may be old.
            FrameTooLarge, WrongType, UnknownTopic: the command does not fit the device; then nobody drives.
        """
        if isinstance(drivable, RemoteRobot):
            if self.is_closed:
                raise DeviceGone(drivable.name, ENDING)
            self._check_pause(velocity)
            return drivable.command(velocity, owner=owner, priority=priority, stops=stops)
        now_s = _now_s() if now_s is None else now_s
        facts = {"owner": str(owner), "address": address_of(owner), "priority": priority, "velocity": velocity}
        try:
            limited = self._command(drivable, velocity, owner=owner, priority=priority, now_s=now_s)
        except HostlinkError as error:
            self.events.note(EventKind.REFUSED, drivable.name, **facts, reason=str(error))
            raise
        self.events.note(EventKind.COMMANDED, drivable.name, **facts, limited=limited)
        return limited

    def _command(
        self, drivable: Drivable, velocity: Velocity, *, owner: Hashable, priority: int, now_s: float
    ) -> Velocity:
        if self.is_closed:
            raise DeviceGone(drivable.name, ENDING)
        if drivable.link is None:
            raise DeviceGone(drivable.name)
        self._check_pause(velocity)
        gate = drivable.gate
        # Two zeros of one moment would leave a slow line as one.
        is_stopping = velocity.is_zero and gate.is_stopping and drivable.refusals.cause is None
        limited = gate.command(owner, velocity, priority=priority, now_s=now_s)
        if gate.owner in (owner, None) and not is_stopping:  # another's idle zero is nothing that the device must hear
            refusal = self._send_news(drivable)
            if refusal is not None:
                gate.release(owner, now_s=now_s)
                raise refusal
        beside = self._of_link[drivable.link]
        if len(beside) > 1 and not velocity.is_zero:
            self._overrule(beside, drivable, owner, priority)
        return limited

    def _check_pause(self, velocity: Velocity) -> None:
        """Whether a velocity that arrives now may be old, here or for another daemon, which cannot know it."""
        if not velocity.is_zero:
            self._stalls.check(_now_s())

    def _overrule(self, beside: list[Drivable], drivable: Drivable, owner: Hashable, priority: int) -> None:
        """Stop what somebody less important drives of the same robot; its next command is refused."""
        for other in beside:
            gate = other.gate
            is_other = gate is not drivable.gate and gate.claims is drivable.gate.claims
            if is_other and gate.owner != owner and gate.priority is not None and gate.priority < priority:
                self._note_stop(other, "overruled", str(gate.owner_name))
                gate.stop(now_s=_now_s())
                self._send_news(other)

    def release(self, owner: Hashable) -> None:
        """A source of commands is gone: what it drives stops."""
        if self.elsewhere is not None:
            self.elsewhere.release(owner)
        now_s = _now_s()
        for drivable in list(self._active):
            is_driving = drivable.gate.owner == owner
            drivable.gate.release(owner, now_s=now_s)  # also what it has claimed without driving now
            if is_driving:
                self._note_stop(drivable, "owner left", str(owner))
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
        self._apply(lambda gate: gate.lock(reason), drivables)

    def close(self) -> None:
        """The daemon ends: no command is accepted any more, for good."""
        self.is_closed = True

    # -- the clock ----------------------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Step every gate that is active; sleep while none is."""
        while True:
            now_s = _now_s()
            self._stalls.beat(now_s)
            for number, drivable in enumerate(list(self._active), 1):
                if number % MAX_STEPS == 0:
                    await asyncio.sleep(0)
                    now_s = _now_s()
                if drivable.gate.may_move or (drivable.gate.is_active and drivable.link is not None):
                    self._step(drivable, now_s)
                elif not drivable.gate.is_claimed(now_s):
                    self._active.pop(drivable, None)
            if self._active:
                await asyncio.sleep(TICK_S)
            else:
                await self._idle()

    async def _idle(self) -> None:
        """Wait until a gate is active, or for a beat while there are any, here or elsewhere."""
        self._wake.clear()
        is_watching = bool(self._of_link) or self.elsewhere is not None
        if not is_watching:
            self._stalls.rest()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(BEAT_S if is_watching else None):
                await self._wake.wait()

    def _stop(self, drivables: Iterable[Drivable]) -> None:
        now_s = _now_s()
        self._apply(lambda gate: gate.stop(now_s=now_s), drivables)

    def _apply(self, change: Callable[[VelocityGate], None], drivables: Iterable[Drivable]) -> None:
        """Change each gate and send what follows; the last refusal is raised once all are done."""
        refusal = None
        for drivable in drivables:
            change(drivable.gate)
            refusal = self._send_news(drivable) or refusal
        if refusal is not None:
            raise refusal

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
        previous_owner, is_first = gate.owner, gate.is_new_device
        velocity = gate.step(now_s)
        if previous_owner is not None and gate.owner is None:
            self._note_stop(drivable, "no command came", str(previous_owner))
        if velocity is None or link is None:
            return None
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


def check_age(drivable: Drivable | RemoteRobot, message: Message) -> None:
    """Whether a velocity may still be obeyed.

    Raises:
        BadRequest: it arrived a lease ago or earlier, and means nothing any more.
    """
    if _now_s() >= message.at_s + drivable.gate.lease_s:
        raise BadRequest(f"{drivable.name}: the command waited longer than it holds")


def check_stream(drivable: Drivable | RemoteRobot, velocity: Velocity, owner: Hashable) -> None:
    """Whether a velocity may be obeyed whose source goes on without waiting for answers.

    Raises:
        BadRequest: it went on through a lock, and its source may not know; while that holds, `command` says so.
    """
    gate = drivable.gate
    is_locked = gate.lock_reason is not None
    is_admitted = drivable.streams.admit(
        owner, is_zero=velocity.is_zero, is_locked=is_locked, now_s=_now_s(), lease_s=gate.lease_s
    )
    if not (is_admitted or is_locked):
        raise BadRequest(
            f"{drivable.name}: it was locked while this stream of velocities went on, which drives again after a zero, "
            f"or {gate.lease_s:g} s without velocities"
        )


def _now_s() -> float:
    return asyncio.get_running_loop().time()
