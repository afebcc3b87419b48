"""Admission: what holds after any history of commands, stops, locks, reconnections, pauses, priorities and clocks.

The oracle keeps the whole history and decides from it alone, by the definitions of the tables: it has no states.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from hostlink.core.robot.admission import BUNCH_S, LEASE_S, SLOW_S, UNORDERED_S, Admission, Command
from hostlink.core.robot.kinematics import PLANAR, AckermannDrive, DifferentialDrive, MecanumDrive
from hostlink.core.robot.kinematics import Drive as RobotDrive
from hostlink.core.robot.velocity import ZERO, Kinematics, PlanarVelocity
from hostlink.errors import RefusalKind

OWNERS = st.sampled_from(["ann", "bob", "eve"])
TOPICS = st.sampled_from(["cmd_vel", "arm_vel"])
PRIORITIES = st.sampled_from([0, 50, 100])
FORWARD, SIDEWAYS, IN_PLACE = PlanarVelocity(0.2), PlanarVelocity(0.2, 0.1), PlanarVelocity(yaw_rad_s=0.5)
WITHOUT_Y = (Kinematics.DIFFERENTIAL, Kinematics.ACKERMANN)
MAX_STAMP_AGE_S = 1.0
FAR_S = 3 * SLOW_S  # between commands, so that few of them tell that their source is slow
RECENT, MANY = 8, 20  # intervals
TICK_S = 0.125  # every time is a multiple, so that no sum is rounded
GAPS = st.one_of(  # ticks between the commands of a source: it is fast, slow, or first the one and then the other
    st.lists(st.just(0), max_size=24),
    st.lists(st.integers(1, 3), max_size=12),
    st.tuples(st.lists(st.integers(0, 3), max_size=24), st.lists(st.integers(1, 3), max_size=12)).map(
        lambda two: two[0] + two[1]
    ),
)


@dataclass
class Heard:
    """Commands of one source since it joined, or has last let go."""

    commanded_s: dict[str, float] = field(default_factory=dict)  # by topic: the newest non-zero command since a zero
    was_interrupted: bool = False  # while it was commanding
    has_missed: bool = False  # its last command had another epoch, or came before an interruption
    was_taken_over: bool = False
    held_until_s: float = float("-inf")
    priority: int = 0
    has_lost_device: bool = False  # it was commanding when the device left
    resumed_s: float = float("-inf")  # end of a silence before or in which it was interrupted
    admitted_s: dict[str, float] = field(default_factory=dict)  # by topic
    intervals_s: list[float] = field(default_factory=list)  # between commands for one topic, without a silence

    @property
    def is_slow(self) -> bool | None:
        """Whether two commands at once are unusual for the source; None if neither is promised.

        It is unusual, if commands have always come apart, or if most of the last eight came far apart. It is usual, if
        commands have always come together, or twenty times in a row.
        """
        are_apart = [each >= SLOW_S for each in self.intervals_s]
        if all(are_apart):
            return True
        if not any(are_apart) or (len(are_apart) >= MANY and not any(are_apart[-MANY:])):
            return False
        are_far = [each >= FAR_S for each in self.intervals_s[-RECENT:]]
        return True if len(are_far) == RECENT and 2 * sum(are_far) > RECENT else None

    def note_interval(self, topic: str, now_s: float) -> None:
        """Note the time since the command before, unless one of them ended a silence."""
        before_s = self.commanded_s.get(topic, float("-inf"))
        if self.resumed_s + LEASE_S <= now_s < before_s + LEASE_S:
            self.intervals_s.append(now_s - before_s)

    @property
    def last_s(self) -> float:
        return max(self.commanded_s.values(), default=float("-inf"))

    def resume(self, sent_s: float, now_s: float, interrupted_s: float) -> None:
        """Note a non-zero command if a silence ends with it. `interrupted_s`: the robot's last interruption."""
        was_interrupted = self.was_interrupted or self.has_missed or interrupted_s >= self.last_s
        if self.commanded_s and self.has_let_go(sent_s) and was_interrupted:
            self.resumed_s = now_s

    def is_bunched(self, topic: str, now_s: float) -> bool:
        """Whether a command follows an admitted one so closely, after a silence, that both waited for the network."""
        return self.may_be_bunched(topic, now_s) and self.is_slow is True

    def may_be_bunched(self, topic: str, now_s: float) -> bool:
        """Whether it is bunched, if two commands at once are unusual for the source."""
        is_close = now_s < self.admitted_s.get(topic, float("-inf")) + BUNCH_S
        return is_close and now_s < self.resumed_s + LEASE_S

    def has_let_go(self, now_s: float) -> bool:
        return now_s >= self.last_s + LEASE_S


class Drive(NamedTuple):
    """Last admitted velocity for a topic, which no zero, stop or leave has followed."""

    source: str
    at_s: float
    priority: int


class History(RuleBasedStateMachine):
    """One robot with two velocity topics, three sources, and the oracle."""

    @initialize(
        resume_s=st.sampled_from([0.0, 1.0]),
        is_connected=st.sampled_from([True, True, False]),
        drive=st.sampled_from([PLANAR, DifferentialDrive(), MecanumDrive(), AckermannDrive()]),
    )
    def build(self, resume_s: float, is_connected: bool, drive: RobotDrive) -> None:
        self.now_s = 128.0
        self.resume_s = resume_s
        self.admission = Admission(
            "robot_0",
            resume_after_reconnect_s=resume_s,
            max_stamp_age_s=MAX_STAMP_AGE_S,
            drive=drive,
        )
        self.sources: dict[str, Heard] = {}
        self.drives: dict[str, Drive] = {}  # by topic
        self.is_locked, self.is_connected = False, is_connected
        self.away_s = self.stopped_s = self.interrupted_s = float("-inf")
        if is_connected:
            self.admission.connect(self.now_s)
            self.interrupted_s = self.now_s

    @rule(ticks=st.integers(0, 6))
    def time_passes(self, ticks: int) -> None:
        self.now_s += ticks * TICK_S

    @rule(
        owner=OWNERS,
        priority=PRIORITIES,
        topic=TOPICS,
        waited=st.integers(0, 8),
        seen=st.sampled_from([None, 0, 1]),
        stamp_age_s=st.sampled_from([None, 1.0, 2.0]),
        velocity=st.sampled_from([FORWARD, FORWARD, SIDEWAYS, IN_PLACE, ZERO]),
        is_planar=st.sampled_from([True, True, True, False]),
        take_over=st.booleans(),
    )
    def source_drives(
        self,
        owner: str,
        priority: int,
        topic: str,
        waited: int,
        seen: int | None,
        stamp_age_s: float | None,
        velocity: PlanarVelocity,
        is_planar: bool,
        take_over: bool,
    ) -> None:
        if velocity.is_zero:
            is_planar = False  # else it would be a zero
        is_supported = is_planar and not (velocity.y_m_s and self.admission.kinematics in WITHOUT_Y)
        if self.admission.kinematics is Kinematics.ACKERMANN and velocity.yaw_rad_s and not velocity.x_m_s:
            is_supported = False
        epoch = None if seen is None else self.admission.epoch - 1 + seen
        heard = self.sources.setdefault(owner, Heard())
        waited_s = waited * TICK_S
        holders = {other for other, each in self.sources.items() if other != owner and self.now_s < each.held_until_s}
        strongest = max((self.sources[other].priority for other in holders), default=0)
        drive = self.drives.get(topic)
        if drive is not None and (drive.source == owner or self.now_s >= drive.at_s + LEASE_S):
            drive = None
        heard.note_interval(topic, self.now_s)
        heard.resume(self.now_s - waited_s, self.now_s, self.interrupted_s)
        if heard.is_slow is None and heard.may_be_bunched(topic, self.now_s):
            seen, epoch = 1, self.admission.epoch  # what was not promised is not tried
        if heard.has_let_go(self.now_s - waited_s):
            heard.was_interrupted = heard.has_missed = heard.was_taken_over = False
            heard.commanded_s = {}
        if seen is None and heard.is_bunched(topic, self.now_s):
            heard.has_missed, heard.held_until_s = True, float("-inf")
            self.drives = {by: each for by, each in self.drives.items() if each.source != owner}
        if seen == 0 or (seen is None and self.now_s - waited_s < self.stopped_s - UNORDERED_S):
            heard.has_missed = True
        expected = None
        if self.is_locked:
            expected = RefusalKind.LOCKED
        elif not is_supported:
            expected = RefusalKind.UNSUPPORTED
        elif not self.is_connected:
            expected = RefusalKind.NOT_CONNECTED
        elif waited_s >= LEASE_S or (stamp_age_s is not None and stamp_age_s > MAX_STAMP_AGE_S):
            expected = RefusalKind.LATE
        else:
            if seen is not None:
                heard.has_missed = not seen
                heard.was_interrupted &= not seen
            may_take_over = take_over and not heard.was_taken_over
            if heard.has_missed or heard.was_interrupted:
                expected = RefusalKind.DISARMED
            elif priority < strongest or (drive is not None and drive.priority >= priority + may_take_over):
                expected = RefusalKind.HELD
            elif heard.was_taken_over:
                expected = RefusalKind.DISARMED
        heard.commanded_s[topic] = self.now_s
        received_s = self.now_s - waited_s
        command = Command(velocity, owner, priority, received_s, None, epoch, stamp_age_s, is_planar, take_over)
        decision = self.admission.decide(command, self.now_s, topic=topic)
        assert decision.kind is expected
        assert (decision.holder is not None) == (expected is RefusalKind.HELD)
        assert decision.holder in holders | {None, drive.source if drive is not None else None}
        if decision.is_admitted:
            if drive is not None and drive.priority == priority:  # taken over: all that it drove ends
                self.sources[drive.source].was_taken_over = True
                self.drives = {by: each for by, each in self.drives.items() if each.source != drive.source}
            heard.held_until_s, heard.priority = self.now_s - waited_s + LEASE_S, priority
            heard.admitted_s[topic] = self.now_s
            self.drives[topic] = Drive(owner, self.now_s - waited_s, priority)
            self.drives = {
                by: drive for by, drive in self.drives.items() if drive.source == owner or drive.priority >= priority
            }
            for other, each in self.sources.items():
                if other != owner:
                    each.held_until_s = self.driven_until_s(other)

    @rule(
        owner=OWNERS,
        priority=PRIORITIES,
        topic=TOPICS,
        waited=st.integers(0, 2),
        has_seen=st.booleans(),
        take_over=st.booleans(),
    )
    def source_drives_in_time(
        self, owner: str, priority: int, topic: str, waited: int, *, has_seen: bool, take_over: bool
    ) -> None:
        """Give a command that most states admit: few of the commands with everything drawn are admitted."""
        seen = 1 if has_seen else None
        self.source_drives(owner, priority, topic, waited, seen, None, FORWARD, is_planar=True, take_over=take_over)

    @rule(owner=OWNERS, topic=TOPICS, take_over=st.booleans(), has_seen=st.booleans())
    def equal_drives(self, owner: str, topic: str, *, take_over: bool, has_seen: bool) -> None:
        """Give a command of the priority of most programs: with drawn ones, few sources are equal."""
        seen = 1 if has_seen else None
        self.source_drives(owner, 50, topic, 0, seen, None, FORWARD, is_planar=True, take_over=take_over)

    @rule(owner=OWNERS, topic=TOPICS, gaps=GAPS, silence=st.integers(3, 6), after=st.integers(0, 1))
    def commands_wait_together_over_a_stop(
        self, owner: str, topic: str, gaps: list[int], silence: int, after: int
    ) -> None:
        """Drive, be stopped, and go on with two commands that the network may have delivered together."""
        for ticks in (*gaps, 0):
            self.time_passes(ticks)
            self.equal_drives(owner, topic, take_over=False, has_seen=False)
        self.robot_is_interrupted("stop", 8)
        for ticks in (silence, after):
            self.time_passes(ticks)
            self.equal_drives(owner, topic, take_over=False, has_seen=False)

    @rule(owner=OWNERS, topic=TOPICS)
    def source_lets_go(self, owner: str, topic: str) -> None:
        driver = self.admission.driver(topic, self.now_s)
        decision = self.admission.decide(Command(ZERO, owner, 50, self.now_s), self.now_s, topic=topic)
        heard = self.sources.setdefault(owner, Heard())
        if topic in self.drives and self.drives[topic].source == owner:
            del self.drives[topic]
        heard.held_until_s = self.driven_until_s(owner)
        heard.commanded_s.pop(topic, None)
        if heard.has_let_go(self.now_s):
            self.sources[owner] = Heard(
                held_until_s=heard.held_until_s, priority=heard.priority, intervals_s=heard.intervals_s
            )
        if not self.is_connected:
            assert decision.kind is RefusalKind.NOT_CONNECTED
        else:
            assert decision.is_admitted == (driver is None or driver.source == owner)

    @rule(owner=OWNERS)
    def source_leaves(self, owner: str) -> None:
        self.admission.withdraw(owner)
        self.sources.pop(owner, None)
        self.drives = {topic: drive for topic, drive in self.drives.items() if drive.source != owner}

    def interruption(self, since_s: float) -> None:
        self.drives.clear()
        self.interrupted_s = self.now_s
        for heard in self.sources.values():
            commanding = [
                topic for topic, at_s in heard.commanded_s.items() if heard.has_lost_device or since_s < at_s + LEASE_S
            ]
            if commanding:
                heard.was_interrupted, heard.commanded_s = True, dict.fromkeys(commanding, self.now_s)

    @rule(event=st.sampled_from(["stop", "pause", "lock", "unlock", "connect", "disconnect"]), ticks=st.integers(5, 40))
    def robot_is_interrupted(self, event: str, ticks: int) -> None:
        epoch = self.admission.epoch
        match event:
            case "stop":
                came_s = self.now_s - ticks % 8 * TICK_S  # the loop may be late
                self.admission.interrupt(self.now_s, came_s=came_s)
                self.stopped_s, is_one = max(self.stopped_s, came_s), False
                self.interruption(came_s)
                epoch += 1
            case "pause":
                began_s = self.now_s
                self.now_s += ticks * TICK_S
                self.admission.interrupt(self.now_s, since_s=began_s, came_s=began_s)
                self.stopped_s = max(self.stopped_s, began_s)
                self.interruption(began_s)
                is_one = False
                epoch += 1
            case "lock":
                self.admission.lock("smoke", self.now_s)
                self.is_locked = is_one = True
            case "unlock":
                self.admission.unlock(self.now_s)
                self.is_locked, is_one = False, self.is_locked
            case "connect":
                self.admission.connect(self.now_s)
                self.is_connected, is_one = True, self.now_s >= self.away_s + self.resume_s
                self.drop_holds()
            case "disconnect":
                self.admission.disconnect(self.now_s)
                self.is_connected, self.away_s, is_one = False, self.now_s, False
                self.drives.clear()
                self.drop_holds()
                for heard in self.sources.values():
                    heard.has_lost_device |= not heard.has_let_go(self.now_s)
        if is_one:
            self.interruption(self.now_s)
        if event == "connect":
            for heard in self.sources.values():
                heard.has_lost_device = False
        assert self.admission.epoch == epoch + is_one

    def driven_until_s(self, owner: str) -> float:
        ends = (drive.at_s + LEASE_S for drive in self.drives.values() if drive.source == owner)
        return max(ends, default=float("-inf"))

    def drop_holds(self) -> None:
        for heard in self.sources.values():
            heard.held_until_s = float("-inf")

    @invariant()
    def nothing_moves_without_an_admitted_command_within_the_lease(self) -> None:
        if not hasattr(self, "admission"):
            return
        for topic in ("cmd_vel", "arm_vel"):
            driver = self.admission.driver(topic, self.now_s)
            drive = self.drives.get(topic)
            if drive is not None and self.now_s < drive.at_s + LEASE_S:
                assert driver.source == drive.source
            else:
                assert driver is None
        held = any(self.now_s < heard.held_until_s for heard in self.sources.values())
        assert self.admission.is_held(self.now_s) == held


TestHistory = History.TestCase
