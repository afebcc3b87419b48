"""Admission: the one rule that decides whether a velocity may move a robot. Pure.

Every way in (rosbridge, REST, the page, Foxglove, the client, ROS, the fleet, recordings) fills in a `Command`. The
robot's `Admission` answers with a `Decision`. No other module decides by ages, epochs, locks or leases.

A *source* of commands is a program, a REST owner, a publisher of another graph. It is in one of four states. A source
*lets go* of a robot by a zero that is not late, by a lease without a command, or by leaving. A source that commands
another velocity topic of the robot does not let go by a zero to one of them. Velocity topics command one *motion* if
they are ways to command the same thing, as a Twist and a TwistStamped of one base; else each is a motion of its own.

| state    | event                                                     | next     | decision              |
|----------|-----------------------------------------------------------|----------|-----------------------|
| quiet    | non-zero command                                          | driving  | admitted for a lease  |
| driving  | non-zero command                                          | driving  | admitted for a lease  |
| driving  | zero                                                      | quiet    | admitted; the drive ends |
| driving  | a lease without a command                                 | quiet    | the robot stops       |
| driving  | interruption: stop, lock, unlock, reconnect, pause        | disarmed | the robot stops       |
| driving  | another source of the same priority takes over            | taken over | the other one drives |
| taken over | non-zero command, while another drives                  | taken over | refused: held      |
| taken over | non-zero command                                        | taken over | refused: disarmed  |
| taken over | zero that is not late, or a lease without a command     | quiet    | that of the zero      |
| disarmed | non-zero command without the current epoch                | disarmed | refused: disarmed     |
| disarmed | non-zero command with the current epoch                   | driving  | admitted for a lease  |
| disarmed | zero that is not late, or a lease without a command       | quiet    | a zero is admitted    |
| any      | non-zero command with an epoch that is not the current one | disarmed | refused: disarmed     |
| any      | non-zero command from before the newest stop or pause     | disarmed | refused: disarmed     |
| any      | the source leaves                                         | quiet    | its robot stops       |

Before that, in this order, each of which leaves a source that was quiet or driving as it is, unless the command has an
epoch that is not the current one or is from before the newest stop or pause: that disarms it all the same.

| event                                                               | decision             |
|---------------------------------------------------------------------|----------------------|
| a component is NaN or infinite                                      | refused: not_finite  |
| non-zero command while the robot is locked                          | refused: locked      |
| a velocity that is impossible for the robot's `drive` at any speed  | refused: unsupported |
| command while the device is not connected                           | refused: not_connected |
| non-zero command while another device of the robot is not connected | refused: not_connected |
| non-zero command that was sent or received a lease ago, or earlier  | refused: late        |
| non-zero command whose stamp is older than `max_stamp_age_s`        | refused: late        |
| command while another source holds the robot at a higher priority   | refused: held        |
| command of a motion that another source of the same priority drives, without `take_over` | refused: held |
| zero while another source drives                                    | refused: held        |
| non-zero command of one more source than MAX_SOURCES                | refused: crowded     |

Each refused non-zero command counts as one that the source still gives: an interruption disarms this source, too. That
holds without a record of it: after an interruption that followed a `crowded` refusal, or a dropped record, within a
lease, every source without a record is disarmed until a lease has passed without such a refusal. A
zero that is refused arms its source all the same. An admitted command holds the robot at its priority for a lease. The
lease of a command that waited is shorter by that time. A stop and a lock do not shorten the time for which the robot is
held from lower priorities; a source of the same priority may drive at once. A zero ends it, except for a source that
drives another velocity topic of the robot. So does an admitted velocity of another source: a source that was overruled
holds the robot no more, except for one that drives another velocity topic at the same priority.

A source that drives keeps its velocity topic from sources of the same priority until it lets go. One of them may say
`take_over`: what the source drove, on all velocity topics, ends. The source that was taken over must let go before it
drives or takes over again, and no epoch replaces that: of two that say `take_over` with each command, one drives. A
source that a higher priority overruled may drive as soon as the higher one lets go.

A command without the current epoch is from before a stop if it has waited, here or on its way, since more than
UNORDERED_S before it. Two arrivals that are closer have no known order, because a loop that is late reads both at once.
A pause counts from its beginning: of a stop and a command that arrived in it the order is not known. A command that has
waited for a lease counts as earlier then: it is refused, and its source may have begun before the stop.

A lease without a command is one of the source's own making: from the arrival of a command to the earliest time at which
the next one may have been sent. A network or a daemon that delays commands makes none. Of a command without `sent_s`
the network's delay is unknown. Where a silence ends that armed a disarmed source, or in which the robot was
interrupted, two commands for one topic that come within BUNCH_S in the lease after it have waited together for the
network: the source is disarmed, and what it drives stops. Of a source whose commands usually come less than SLOW_S
apart this cannot be told; it should send `sent_s`.

An interruption increments the epoch. Answers to commands carry the epoch, so that a program can say that it has seen
the interruption. A reconnection disarms the sources that were driving when the device left, too. A reconnection within
`resume_after_reconnect_s` is not an interruption.

A publisher that was there before the robot may be in the middle of a motion: `join` names it. Its first non-zero
command within a lease counts as one with an earlier epoch.
"""

import math
import shlex
from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field
from typing import Any, Final, Generic, NamedTuple, Self, TypeVar

from hostlink.core.robot.kinematics import PLANAR, Drive
from hostlink.core.robot.velocity import AnyVelocity, Kinematics
from hostlink.errors import RefusalKind

DRIFT = 0.001  # two clocks drift far less; a route that became slower for good is accepted at this pace

LEASE_S = 0.5  # the time-out of diff_drive_controller and of the robot's own watchdog
MAX_SOURCES = 64  # that one robot keeps apart
BUNCH_S = 0.01  # commands that waited for the network arrive together
SLOW_S = 4 * BUNCH_S  # shortest usual interval at which that is told: a faster source often sends two together
INTERVAL_WEIGHT = 1 / 8  # of the newest interval
UNORDERED_S = 0.1  # between two arrivals whose order is not known: a loop that was late is noticed by its next beat
EPOCH_BITS = 40  # the first epoch is drawn at random: that of an earlier daemon is never the current one
EARLIER_EPOCH = -1  # of a motion that may have begun before an interruption
NOT_PLANAR = "a robot moves in the plane: send 0 as linear.z, angular.x and angular.y"

V = TypeVar("V", bound=AnyVelocity)

MAX_EARLIER = 1024  # commands to what does not exist, of the last lease
ANY_SOURCE: Final = object()  # among the sources that commanded earlier: there were more than are known


class Freshness:
    """Delay of a message beyond the quickest of its kind, by the sender's clock and ours."""

    def __init__(self) -> None:
        self._quickest_s = float("inf")  # the smallest difference of the clocks: no wait in it
        self._updated_at_s = 0.0

    def late_s(self, sent_s: float, now_s: float) -> float:
        """Seconds that it waited on the way; `sent_s` is of the sender's own clock, from any beginning."""
        difference_s = now_s - sent_s
        self._quickest_s = min(difference_s, self._quickest_s + DRIFT * (now_s - self._updated_at_s))
        self._updated_at_s = now_s
        return difference_s - self._quickest_s


class Command(NamedTuple, Generic[V]):
    """One velocity on its way to a robot.

    `received_s` is the earliest time at which this daemon may have received it. `sent_s` is a time of the sender's own
    clock. `epoch` is the robot's epoch as the sender last saw it. `stamp_age_s` is the age of its stamp by this host's
    clock. The last three are None where the sender gave none. `is_planar` is False for a Twist whose other components
    are not zero: `velocity` lacks them. `take_over` takes the robot over from another source of the same priority.
    """

    velocity: V
    source: Hashable
    priority: int
    received_s: float
    sent_s: float | None = None
    epoch: int | None = None
    stamp_age_s: float | None = None
    is_planar: bool = True
    take_over: bool = False


@dataclass(slots=True)
class EarlierMotion:
    """Whether a source that is heard from now on may be in the middle of a motion, for who bridges another graph.

    A subscription to a publisher that was there before joins what it does: its first velocity until `until_s` may be
    from before an interruption. A source that is silent until then begins anew.
    """

    until_s: float = float("-inf")

    @classmethod
    def within_a_lease(cls, now_s: float) -> Self:
        """An earlier motion whose first velocity arrives within a lease."""
        return cls(now_s + LEASE_S)

    def pop_epoch(self, received_s: float) -> int | None:
        """Return the epoch of a command: EARLIER_EPOCH for the first one if it came in time, then None."""
        epoch = EARLIER_EPOCH if received_s < self.until_s else None
        self.until_s = float("-inf")  # the admission knows from now on that the motion is an earlier one
        return epoch


class Resumption:
    """Detector of arrivals that may end a silence that the network made: none of them may be left out."""

    def __init__(self) -> None:
        self._came_s, self._until_s = math.inf, -math.inf

    def is_recent(self, came_s: float) -> bool:
        """Note an arrival. Return whether it follows a lease without any, or one that does by less than a lease."""
        if came_s >= self._came_s + LEASE_S:
            self._until_s = came_s + LEASE_S
        self._came_s = came_s
        return came_s < self._until_s


@dataclass(slots=True)
class EarlierCommands:
    """Sources that commanded a robot or a topic before it existed.

    A source that continues when it exists is in the middle of a motion. The newest MAX_EARLIER of one lease are known;
    while one of the others may continue, ANY_SOURCE is one of the sources of each name.
    """

    _at_s: dict[tuple[str, Hashable], float] = field(default_factory=dict)  # the newest is the last one
    _forgotten_s: float = float("-inf")  # the newest command that is not kept

    @property
    def is_empty(self) -> bool:
        """Whether nothing was noted."""
        return not self._at_s

    def note(self, name: str, source: Hashable, now_s: float) -> None:
        """Note a command of a source to a name that means nothing."""
        self._at_s.pop((name, source), None)
        self._at_s[name, source] = now_s
        while len(self._at_s) > MAX_EARLIER or now_s >= next(iter(self._at_s.values())) + LEASE_S:
            self._forgotten_s = self._at_s.pop(next(iter(self._at_s)))

    def sources(self, name: str, now_s: float) -> tuple[Hashable, ...]:
        """Return the sources that have commanded this name within a lease."""
        found = [source for (known, source), at_s in self._at_s.items() if known == name and now_s < at_s + LEASE_S]
        if now_s < self._forgotten_s + LEASE_S:
            found.append(ANY_SOURCE)
        return tuple(found)


class Decision(NamedTuple):
    """`kind` is None for an admitted command. `reason` says why a command was refused, and what to do next."""

    kind: RefusalKind | None = None
    reason: str = ""
    holder: Hashable = None  # the source that holds the robot, for `held`
    by: str | None = None  # who locked it, or what disarmed the source; None: unknown

    @property
    def is_admitted(self) -> bool:
        """Whether the velocity may move the robot."""
        return self.kind is None


def named(what: str, by: str | None) -> str:
    """Return the text of an interruption: "a stop by teleop", or "a stop" when it is unknown by whom."""
    return f"{what} by {by}" if by else what


class Lease(NamedTuple):
    """The source that drives one velocity topic of a robot, its priority, and the end of its lease."""

    source: Hashable
    priority: int
    deadline_s: float
    motion: str = ""  # topics of one motion are ways to command the same thing; empty: no other topic commands it


def _is_one(driven: Hashable, lease: Lease, topic: Hashable, motion: str) -> bool:
    """Whether the lease of a topic drives what the other topic commands."""
    return driven == topic or (motion != "" and lease.motion == motion)


ADMITTED = Decision()


@dataclass(slots=True)
class _Source:
    """Record of one source of commands."""

    is_armed: bool = True
    taken_by: str | None = None  # who has taken over what it drove; None: it was not, or has let go since
    commanded: dict[Hashable, float] = field(default_factory=dict)  # by topic: newest non-zero command, admitted or not
    priority: int = 0
    held_until_s: float = float("-inf")
    has_lost_device: bool = False  # it was commanding when the device left, and has not let go since
    freshness: Freshness = field(default_factory=Freshness)
    resumed_s: float = float("-inf")  # end of a silence before or in which the robot was interrupted
    came_s: dict[Hashable, float] = field(default_factory=dict)  # by topic: arrival of the newest admitted command
    interval_s: float = math.inf  # usual time between two commands for one topic; infinite: not known

    def note_interval(self, interval_s: float) -> None:
        """Note the time between two commands for one topic, without a silence between them."""
        known_s = interval_s if self.interval_s == math.inf else self.interval_s
        self.interval_s = known_s + (interval_s - known_s) * INTERVAL_WEIGHT

    def is_bunched(self, command: Command[Any], now_s: float, topic: Hashable) -> bool:
        """Whether a command waited with the admitted one before it: then a silence before both was the network's."""
        tells_more = command.sent_s is not None or command.epoch is not None or self.interval_s < SLOW_S
        return not tells_more and now_s < self.came_s.get(topic, float("-inf")) + BUNCH_S

    def note_admitted(self, command: Command[Any], now_s: float, topic: Hashable) -> None:
        """Note when an admitted command arrived."""
        is_late = BUNCH_S <= now_s - command.received_s < UNORDERED_S  # then a slightly late loop may read two at once
        self.came_s[topic] = command.received_s if is_late else now_s

    @property
    def commanded_s(self) -> float:
        """The newest non-zero command to a topic to which no zero followed; -inf: there is none."""
        return max(self.commanded.values(), default=float("-inf"))

    def arm(self) -> None:
        """Note that the source has let go."""
        self.is_armed, self.taken_by = True, None
        self.commanded.clear()

    def waited_s(self, command: Command[Any], now_s: float) -> float:
        """Return the age of a command: how long it waited here; or, if that is longer, than the quickest one did."""
        waited_s = now_s - command.received_s
        if command.sent_s is not None:  # by the time now: `received_s` may be far too early, after a pause
            waited_s = max(waited_s, self.freshness.late_s(command.sent_s, now_s))
        return waited_s


@dataclass(slots=True, eq=False)
class Admission:
    """Rule for one robot. A robot with several velocity topics has one `Admission` and one driver for each topic.

    Methods take the loop time `now_s`, which never decreases.
    """

    robot: str
    lease_s: float = LEASE_S
    resume_after_reconnect_s: float = 0.0
    max_stamp_age_s: float = math.inf  # of senders whose clocks agree with this host's
    drive: Drive | None = PLANAR  # None: a velocity topic that belongs to no robot, which takes all six numbers
    sees_bunches: bool = True  # False: another daemon, which has the robot, sees them
    epoch: int = 0
    lock_reason: str | None = None
    locked_by: str | None = None
    interrupted_by: str | None = None  # the newest interruption
    is_connected: bool = False
    unlocked_by: str = ""  # robot with which it is locked and unlocked; empty: `robot`
    missing: str = ""  # why a robot of several devices cannot be driven: one of them is not connected
    refused: dict[RefusalKind, int] = field(default_factory=dict)
    _sources: dict[Hashable, _Source] = field(default_factory=dict)  # the one that commanded last is the last one
    _drivers: dict[Hashable, Lease] = field(default_factory=dict)  # by velocity topic
    _joined: dict[Hashable, EarlierMotion] = field(default_factory=dict)
    _disconnected_s: float = float("-inf")
    _stopped_s: float = float("-inf")  # arrival of the newest interruption of which it is known
    _obeyed_s: float = float("-inf")  # when the newest stop, unlock or reconnection took effect
    _interrupted_s: float = float("-inf")
    _unrecorded_s: float = float("-inf")  # the newest non-zero command of a source without a record
    _unarmed_until_s: float = float("-inf")  # sources without a record are disarmed until then

    @property
    def kinematics(self) -> Kinematics:
        """Kind of the drive."""
        return Kinematics.SPATIAL if self.drive is None else self.drive.kinematics

    # -- commands -----------------------------------------------------------------------------------------------------

    def decide(self, command: Command[Any], now_s: float, *, topic: Hashable = "", motion: str = "") -> Decision:
        """Decide about a command for one velocity topic of the robot, and remember what follows from it.

        Topics of one `motion` are ways to command the same thing; empty: no other topic commands it.
        """
        velocity, owner = command.velocity, command.source
        if velocity.is_zero and command.is_planar:
            return self._decide_zero(command, now_s, topic, motion)
        source = self._source(command, now_s, topic)
        if source is None:
            self._note_unrecorded(now_s, now_s)
            reason = f"more than {MAX_SOURCES} sources command this robot at once; stop some of them"
            return self._refuse(RefusalKind.CROWDED, reason)
        waited_s, before_s = source.waited_s(command, now_s), source.commanded.get(topic)
        if before_s is not None and source.resumed_s + self.lease_s <= now_s < before_s + self.lease_s:
            source.note_interval(now_s - before_s)
        if now_s - max(waited_s, 0.0) >= source.commanded_s + self.lease_s:
            if not source.is_armed or self._interrupted_s >= source.commanded_s > -math.inf:
                source.resumed_s = now_s
            source.arm()  # it let go
        if self.sees_bunches and now_s < source.resumed_s + self.lease_s and source.is_bunched(command, now_s, topic):
            source.is_armed = False
            self.end_drives(owner)
        source.commanded[topic] = now_s
        joined = self._joined.pop(owner, None)
        if joined is not None and command.epoch is None:
            command = command._replace(epoch=joined.pop_epoch(command.received_s))
        if command.epoch is None:
            stopped_s = self._stopped_s
            if waited_s >= self.lease_s:
                stopped_s = max(stopped_s, self._obeyed_s)
            is_earlier = now_s - waited_s < stopped_s - UNORDERED_S
        else:
            is_earlier = command.epoch != self.epoch
        if is_earlier:
            source.is_armed = False  # also if this command is refused: the next one continues its motion
        if not velocity.is_finite:
            return self._refuse(RefusalKind.NOT_FINITE, "a velocity must consist of finite numbers")
        if self.lock_reason is not None:
            return self._refuse(RefusalKind.LOCKED, self.locked_text, by=self.locked_by)
        if not command.is_planar:
            return self._refuse(RefusalKind.UNSUPPORTED, NOT_PLANAR)
        impossible = None if self.drive is None else self.drive.why_impossible(velocity)
        if impossible is not None:
            return self._refuse(RefusalKind.UNSUPPORTED, impossible)
        if not self.is_connected or self.missing:
            return self._refuse(RefusalKind.NOT_CONNECTED, self.missing or "its device is not connected")
        if waited_s >= self.lease_s or command.stamp_age_s is not None:
            late = self._late_text(command, waited_s)
            if late:
                return self._refuse(RefusalKind.LATE, late)
        if command.epoch == self.epoch:
            source.is_armed = True
        if not source.is_armed:
            return self._refuse_disarmed()
        if len(self._sources) > 1:
            held = self._refuse_held(command, source, topic, motion, now_s)
            if held is not None:
                return held
        if source.taken_by is not None:
            reason = f"{source.taken_by} took it over; to drive again, {self._let_go_text()}"
            return self._refuse(RefusalKind.DISARMED, reason, by=named("a take-over", source.taken_by))
        source.priority, source.held_until_s = command.priority, now_s - max(waited_s, 0.0) + self.lease_s
        if len(self._sources) > 1:
            self._overrule(owner, command.priority, topic, motion, now_s)
        self._drivers[topic] = Lease(owner, command.priority, source.held_until_s, motion)
        source.note_admitted(command, now_s, topic)
        return ADMITTED

    def _decide_zero(self, command: Command[Any], now_s: float, topic: Hashable, motion: str) -> Decision:
        """A zero is admitted at any age, but one that may be from before an interruption arms nothing."""
        owner = command.source
        source = self._sources.get(owner)
        has_room = len(self._sources) < MAX_SOURCES and now_s < command.received_s + self.lease_s
        if source is None and command.sent_s is not None and has_room:
            source = self._sources[owner] = _Source(priority=command.priority)  # tells how late a later command is
        if source is not None:
            self._let_go(source, owner, topic)
        waited_s = now_s - command.received_s if source is None else source.waited_s(command, now_s)
        if not self._late_text(command, waited_s):
            self._joined.pop(owner, None)
            if source is not None:
                source.commanded.pop(topic, None)
                if now_s >= source.commanded_s + self.lease_s:  # else it commands another topic of the robot
                    source.arm()
                    source.has_lost_device, source.resumed_s = False, float("-inf")
        if not self.is_connected:
            return self._refuse(RefusalKind.NOT_CONNECTED, self.missing or "its device is not connected")
        driver = self._rival(owner, topic, motion, now_s)
        if driver is not None:
            name = shlex.quote(self.robot)
            reason = (
                f"{driver.source} drives it, and a zero of another source does not stop it; "
                f"to stop it: hostlink stop {name}, or POST /api/robots/{self.robot}/stop"
            )
            return self._refuse(RefusalKind.HELD, reason, driver.source)
        return ADMITTED

    def _let_go(self, source: _Source, owner: Hashable, topic: Hashable) -> None:
        """End the lease of a source that gave a zero to one topic, and its hold, unless it drives another topic."""
        lease = self._drivers.get(topic)
        if lease is not None and lease.source == owner:
            del self._drivers[topic]
        source.held_until_s = self._driven_until_s(owner)

    def _overrule(self, owner: Hashable, priority: int, topic: Hashable, motion: str, now_s: float) -> None:
        """End the leases that a source takes over, and their holds.

        They are those of a lower priority, those of its motion, and all others of the source that drove the motion at
        the same priority: that one is taken over.
        """
        before = self._rival(owner, topic, motion, now_s)
        if before is not None and before.priority == priority:
            self._sources[before.source].taken_by = str(owner)
            self.end_drives(before.source)
        self._drivers = {
            driven: lease
            for driven, lease in self._drivers.items()
            if lease.source == owner or not (_is_one(driven, lease, topic, motion) or lease.priority < priority)
        }
        for other, source in self._sources.items():
            if other != owner:
                source.held_until_s = self._driven_until_s(other)

    def _driven_until_s(self, owner: Hashable) -> float:
        """Return the end of the last lease of a source; -inf if it has none."""
        return max((each.deadline_s for each in self._drivers.values() if each.source == owner), default=float("-inf"))

    def _source(self, command: Command[Any], now_s: float, topic: Hashable) -> _Source | None:
        """Return the record of a source, the last of all; None where there is room for no other.

        A record of a quiet source may be dropped, because a new source is armed, unless it may have been commanding
        without a record when the robot was interrupted. A disarmed one is never forgotten.
        """
        source = self._sources.pop(command.source, None)
        if source is None:
            if len(self._sources) >= MAX_SOURCES and not self._forget_one(command.priority, now_s):
                return None
            source = _Source(priority=command.priority)
            if now_s < self._unarmed_until_s:
                source.is_armed, source.commanded[topic] = False, now_s
        self._sources[command.source] = source
        return source

    def _forget_one(self, priority: int, now_s: float) -> bool:
        for owner, source in self._sources.items():
            if not source.has_lost_device and now_s >= max(source.commanded_s + self.lease_s, source.held_until_s):
                del self._sources[owner]
                return True
        driving = {driver.source for driver in self._drivers.values()}
        armed = [
            owner
            for owner, source in self._sources.items()
            if source.is_armed and source.taken_by is None and not source.has_lost_device and owner not in driving
        ]
        least = min(armed, key=lambda owner: self._sources[owner].priority, default=None)
        if least is None or self._sources[least].priority >= priority:
            return False
        self._note_unrecorded(self._sources.pop(least).commanded_s, now_s)
        return True

    def _note_unrecorded(self, commanded_s: float, now_s: float) -> None:
        """Note a non-zero command of a source that has no record, or has none from now on."""
        self._unrecorded_s = max(self._unrecorded_s, commanded_s)
        if now_s < self._unarmed_until_s:
            self._unarmed_until_s = now_s + self.lease_s

    def _other_holder(self, owner: Hashable, now_s: float) -> Hashable:
        """Return the other source of the highest priority that holds the robot; None: no other holds it."""
        others = (
            (source.priority, source.held_until_s, other)
            for other, source in self._sources.items()
            if other != owner and now_s < source.held_until_s
        )
        return max(others, key=lambda each: each[:2], default=(0, 0.0, None))[2]

    def _rival(self, owner: Hashable, topic: Hashable, motion: str, now_s: float) -> Lease | None:
        """Return the lease of another source for the same motion; None if there is none."""
        for driven, lease in self._drivers.items():
            if lease.source != owner and now_s < lease.deadline_s and _is_one(driven, lease, topic, motion):
                return lease
        return None

    def _refuse_held(
        self, command: Command[Any], source: _Source, topic: Hashable, motion: str, now_s: float
    ) -> Decision | None:
        """Refuse a command because another source holds the robot, or drives the motion; None: no other does."""
        holder = self._other_holder(command.source, now_s)
        if holder is not None and command.priority < self._sources[holder].priority:
            return self._refuse_less_important(holder)
        driver = self._rival(command.source, topic, motion, now_s)
        if driver is None or driver.priority < command.priority:
            return None
        if driver.priority > command.priority:
            return self._refuse_less_important(driver.source)
        if source.taken_by is not None:
            reason = f"{driver.source} has taken it over; to take it over again, {self._let_go_text()} first"
        elif command.take_over:
            return None
        else:
            advice = "wait until it lets go, stop it, or use take_over"
            reason = f"{driver.source} drives it with the same priority; {advice}"
        return self._refuse(RefusalKind.HELD, reason, driver.source)

    def _refuse_less_important(self, holder: Hashable) -> Decision:
        reason = f"{holder} drives it with a higher priority; wait until it lets go, or use stop"
        return self._refuse(RefusalKind.HELD, reason, holder)

    def _refuse_disarmed(self) -> Decision:
        cause = "" if self.interrupted_by is None else f" ({self.interrupted_by})"
        reason = (
            f"it was stopped, locked or reconnected while this source was driving{cause}; to drive again, "
            f"{self._let_go_text()}, or send epoch {self.epoch}"
        )
        return self._refuse(RefusalKind.DISARMED, reason, by=self.interrupted_by)

    def _let_go_text(self) -> str:
        return f"send a zero, or pause for {self.lease_s:g} s"

    def _refuse(self, kind: RefusalKind, reason: str, holder: Hashable = None, *, by: str | None = None) -> Decision:
        self.refused[kind] = self.refused.get(kind, 0) + 1
        return Decision(kind, f"{self.robot}: {reason}", holder, str(holder) if holder is not None else by)

    def _late_text(self, command: Command[Any], waited_s: float) -> str:
        """Return why a command is too old; empty: it is not."""
        if waited_s >= self.lease_s:
            return f"velocity is {waited_s:.1f} s old, and holds for {self.lease_s:g} s; send a new one"
        if command.stamp_age_s is not None and command.stamp_age_s > self.max_stamp_age_s:
            return f"its stamp is {command.stamp_age_s:.3f} s old, cmd_vel_max_age_s allows {self.max_stamp_age_s:g}"
        return ""

    @property
    def locked_text(self) -> str:
        """Reason of a refusal under a lock, with the command that ends it: without a robot, the unlock of all."""
        whom = "--all" if self.drive is None else shlex.quote(self.unlocked_by or self.robot)
        return f"locked: {self.lock_reason}; to drive it again: hostlink unlock {whom}"

    # -- who drives ---------------------------------------------------------------------------------------------------

    def driver(self, topic: Hashable, now_s: float) -> Lease | None:
        """Return the source that drives a velocity topic; None: no lease is valid."""
        found = self._drivers.get(topic)
        return found if found is not None and now_s < found.deadline_s else None

    def is_held(self, now_s: float) -> bool:
        """Whether a source holds the robot, so that one of a lower priority is refused."""
        return any(now_s < source.held_until_s for source in self._sources.values())

    def end(self, topic: Hashable) -> None:
        """End the lease of a velocity topic; its driver stays armed and holds the robot for the rest of the lease."""
        self._drivers.pop(topic, None)

    def withdraw(self, owner: Hashable) -> None:
        """Forget a source that has left; what it drove stops."""
        self._sources.pop(owner, None)
        self._joined.pop(owner, None)
        self.end_drives(owner)

    def end_drives(self, owner: Hashable) -> None:
        """End all leases of a source, whose command does not fit the device. The source still commands."""
        source = self._sources.get(owner)
        if source is not None:
            source.held_until_s = float("-inf")
        self._drivers = {topic: driver for topic, driver in self._drivers.items() if driver.source != owner}

    # -- interruptions ------------------------------------------------------------------------------------------------

    def interrupt(
        self, now_s: float, *, since_s: float | None = None, came_s: float | None = None, by: str | None = None
    ) -> None:
        """Stop the robot: disarm every source that was commanding within a lease before `since_s`, `came_s`, or now.

        `came_s` is the earliest time at which the interruption arrived, by the clock of commands: what came before it
        is from before the interruption. A lock has none: commands are refused from then on.
        `by` names the interruption for refusals; None: it is unknown.
        """
        is_pause = since_s is not None
        if since_s is None:
            since_s = now_s if came_s is None else min(came_s, now_s)
        self.epoch += 1
        self.interrupted_by, self._interrupted_s = by, now_s
        if came_s is not None:
            self._stopped_s = max(self._stopped_s, came_s)
            if not is_pause:
                self._obeyed_s = now_s
        self._drivers.clear()
        if since_s < self._unrecorded_s + self.lease_s:
            self.distrust(now_s)
        for source in self._sources.values():
            commanded = {
                topic: now_s  # commands that waited through a pause are read now, so a lease without them begins now
                for topic, commanded_s in source.commanded.items()
                if source.has_lost_device or since_s < commanded_s + self.lease_s
            }
            if commanded:
                source.is_armed, source.commanded = False, commanded

    def distrust(self, now_s: float) -> None:
        """Disarm every source without a record: it may be in the middle of a motion from before an interruption."""
        self._unarmed_until_s = now_s + self.lease_s

    def lock(self, reason: str, now_s: float, *, by: str | None = None) -> None:
        """Refuse every non-zero command until `unlock`. `by` is who locks."""
        self.lock_reason, self.locked_by = reason, by
        self.interrupt(now_s, by=named("a lock", by))

    def unlock(self, now_s: float, *, came_s: float | None = None, by: str | None = None) -> None:
        """Admit commands again. Unlocking moves nothing.

        A source that went on through the lock stays disarmed, and so does one whose command arrived before the unlock
        and is read after it. `came_s` is as for `interrupt`.
        """
        if self.lock_reason is not None:
            self.lock_reason = self.locked_by = None
            self.interrupt(now_s, came_s=came_s, by=named("an unlock", by))

    def join(self, sources: Iterable[Hashable], now_s: float) -> None:
        """Note sources that have published to the robot since before it was subscribed. ANY_SOURCE: so may each."""
        self._joined = {owner: motion for owner, motion in self._joined.items() if now_s < motion.until_s}
        joining = set(sources)
        if ANY_SOURCE in joining:
            joining = (joining - {ANY_SOURCE}) | self._sources.keys()
            self.distrust(now_s)
        self._joined |= {owner: EarlierMotion.within_a_lease(now_s) for owner in joining}

    def connect(self, now_s: float, *, came_s: float | None = None) -> bool:
        """Note that the device is connected, or has other topics. Return whether that is an interruption.

        `came_s` is as for `interrupt`.
        """
        is_interruption = now_s >= self._disconnected_s + self.resume_after_reconnect_s
        if is_interruption:
            self.interrupt(now_s, came_s=came_s, by="a reconnection of its device")
        self.is_connected = True
        self._drop_holds()
        for source in self._sources.values():
            source.has_lost_device = False
        return is_interruption

    def disconnect(self, now_s: float) -> None:
        """The device is gone."""
        self.is_connected, self._disconnected_s = False, now_s
        self._end_all_drives(now_s)

    def note_missing(self, missing: str, now_s: float, *, came_s: float | None = None) -> None:
        """Note why a robot of several devices cannot be driven; empty: all are connected, which is an interruption.

        `came_s` is as for `interrupt`.
        """
        if missing == self.missing:
            return
        self.missing = missing
        if missing:
            self._end_all_drives(now_s)
        else:
            self.interrupt(now_s, came_s=came_s, by="a reconnection of one of its devices")
            for source in self._sources.values():
                source.has_lost_device = False

    def _end_all_drives(self, now_s: float) -> None:
        for source in self._sources.values():
            source.has_lost_device |= now_s < source.commanded_s + self.lease_s
        self._drivers.clear()
        self._drop_holds()

    def _drop_holds(self) -> None:
        for source in self._sources.values():
            source.held_until_s = float("-inf")
