"""Admission: what holds after any history of commands, stops, locks, reconnections, pauses, priorities and clocks.

The oracle keeps the whole history and decides from it alone, by the definitions of the tables: it has no states.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from hostlink.errors import RefusalKind
from hostlink.robot.admission import BUNCH_S, LEASE_S, UNORDERED_S, Admission, Command
from hostlink.robot.velocity import ZERO, Kinematics, PlanarVelocity

OWNERS = st.sampled_from(["ann", "bob", "eve"])
TOPICS = st.sampled_from(["cmd_vel", "arm_vel"])
PRIORITIES = st.sampled_from([0, 50, 100])
FORWARD, SIDEWAYS = PlanarVelocity(0.2), PlanarVelocity(0.2, 0.1)
MAX_STAMP_AGE_S = 1.0
TICK_S = 0.125  # every time is a multiple, so that no sum is rounded


@dataclass
class Heard:
    """Commands of one source since it joined."""

    commanded_s: list[float] = field(default_factory=list)  # of every non-zero command since the last zero
    sent_s: list[float] = field(default_factory=list)  # earliest time at which each of them may have been sent
    interrupted_s: float | None = None  # the last interruption that met it while it was commanding
    has_seen: bool = False  # its last command had the current epoch
    has_missed: bool = False  # its last command had another epoch, or came before an interruption
    held_until_s: float = float("-inf")
    priority: int = 0
    has_lost_device: bool = False  # it was commanding when the device left

    resumed_s: float = float("-inf")  # end of a silence before or in which it was interrupted
    admitted_s: dict[str, float] = field(default_factory=dict)  # by topic

    def resume(self, sent_s: float, now_s: float, interrupted_s: float) -> None:
        """Note a non-zero command if a silence ends with it. `interrupted_s`: the robot's last interruption."""
        last_s = max(self.commanded_s, default=float("-inf"))
        was_interrupted = self.interrupted_s is not None or self.has_missed or interrupted_s >= last_s
        if self.commanded_s and sent_s >= last_s + LEASE_S and was_interrupted:
            self.resumed_s = now_s

    def is_bunched(self, topic: str, now_s: float) -> bool:
        """Whether a command follows an admitted one so closely, after a silence, that both waited for the network."""
        is_close = now_s < self.admitted_s.get(topic, float("-inf")) + BUNCH_S
        return is_close and now_s < self.resumed_s + LEASE_S

    def is_armed(self, sent_s: float) -> bool:
        """Whether it has let go, or has seen the interruption, since the last one, and before what was sent then."""
        if self.interrupted_s is None and not self.has_missed:
            return True
        gaps = [after - before for before, after in zip(self.commanded_s, [*self.sent_s[1:], sent_s], strict=True)]
        return self.has_seen or any(gap >= LEASE_S for gap in gaps)

    def note(self, sent_s: float, now_s: float) -> None:
        """Note a non-zero command."""
        self.commanded_s.append(now_s)
        self.sent_s.append(sent_s)

    def forget(self) -> None:
        """Forget all commands."""
        self.commanded_s, self.sent_s = [], []


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
        kinematics=st.sampled_from([Kinematics.PLANAR, Kinematics.DIFFERENTIAL]),
    )
    def build(self, resume_s: float, is_connected: bool, kinematics: Kinematics) -> None:
        self.now_s = 128.0
        self.resume_s = resume_s
        self.admission = Admission(
            "robot_0",
            resume_after_reconnect_s=resume_s,
            max_stamp_age_s=MAX_STAMP_AGE_S,
            kinematics=kinematics,
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
        velocity=st.sampled_from([FORWARD, FORWARD, SIDEWAYS, ZERO]),
        is_planar=st.sampled_from([True, True, True, False]),
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
    ) -> None:
        if velocity.is_zero:
            is_planar = False  # else it would be a zero
        is_supported = is_planar and not (velocity.y_m_s and self.admission.kinematics is Kinematics.DIFFERENTIAL)
        epoch = None if seen is None else self.admission.epoch - 1 + seen
        heard = self.sources.setdefault(owner, Heard())
        waited_s = waited * TICK_S
        holders = {other for other, each in self.sources.items() if other != owner and self.now_s < each.held_until_s}
        strongest = max((self.sources[other].priority for other in holders), default=0)
        heard.resume(self.now_s - waited_s, self.now_s, self.interrupted_s)
        if heard.is_armed(self.now_s - waited_s):
            heard.interrupted_s, heard.has_missed = None, False
            heard.forget()
        if seen is None and heard.is_bunched(topic, self.now_s):
            heard.has_missed, heard.held_until_s = True, float("-inf")
            self.drives = {by: drive for by, drive in self.drives.items() if drive.source != owner}
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
                heard.has_seen, heard.has_missed = bool(seen), not seen
                heard.interrupted_s = None if seen else heard.interrupted_s
            if not seen and (heard.has_missed or not heard.is_armed(self.now_s - waited_s)):
                expected = RefusalKind.DISARMED
            elif priority < strongest:
                expected = RefusalKind.HELD
        heard.has_seen = False
        heard.note(self.now_s - waited_s, self.now_s)
        received_s = self.now_s - waited_s
        command = Command(velocity, owner, priority, received_s, None, epoch, stamp_age_s, is_planar)
        decision = self.admission.decide(command, self.now_s, topic=topic)
        assert decision.kind is expected
        assert decision.holder in holders | {None}
        if decision.is_admitted:
            heard.held_until_s, heard.priority = self.now_s - waited_s + LEASE_S, priority
            heard.admitted_s[topic] = self.now_s
            self.drives[topic] = Drive(owner, self.now_s - waited_s, priority)
            self.drives = {
                by: drive for by, drive in self.drives.items() if drive.source == owner or drive.priority >= priority
            }
            for other, each in self.sources.items():
                if other != owner:
                    each.held_until_s = self.driven_until_s(other)

    @rule(owner=OWNERS, priority=PRIORITIES, topic=TOPICS, waited=st.integers(0, 2), has_seen=st.booleans())
    def source_drives_in_time(self, owner: str, priority: int, topic: str, waited: int, *, has_seen: bool) -> None:
        """Give a command that most states admit: few of the commands with everything drawn are admitted."""
        seen = 1 if has_seen else None
        self.source_drives(owner, priority, topic, waited, seen, None, FORWARD, is_planar=True)

    @rule(owner=OWNERS, topic=TOPICS)
    def source_lets_go(self, owner: str, topic: str) -> None:
        driver = self.admission.driver(topic, self.now_s)
        decision = self.admission.decide(Command(ZERO, owner, 50, self.now_s), self.now_s, topic=topic)
        held = self.sources.pop(owner, Heard())
        if topic in self.drives and self.drives[topic].source == owner:
            del self.drives[topic]
        self.sources[owner] = Heard(held_until_s=self.driven_until_s(owner), priority=held.priority)
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
            last_s = max(heard.commanded_s, default=float("-inf"))
            if heard.has_lost_device or since_s < last_s + LEASE_S:
                heard.interrupted_s, heard.has_missed = self.now_s, False
                heard.forget()
                heard.note(self.now_s, self.now_s)

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
                    heard.has_lost_device |= self.now_s < max(heard.commanded_s, default=float("-inf")) + LEASE_S
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
