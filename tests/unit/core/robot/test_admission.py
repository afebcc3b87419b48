"""Admission: one test for each row of its tables."""

import itertools
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.robot.admission import (
    ANY_SOURCE,
    BUNCH_S,
    DRIFT,
    EARLIER_EPOCH,
    LEASE_S,
    MAX_EARLIER,
    MAX_SOURCES,
    UNORDERED_S,
    Admission,
    Command,
    Decision,
    EarlierCommands,
    EarlierMotion,
    Freshness,
    Resumption,
    named,
)
from hostlink.core.robot.kinematics import AckermannDrive, DifferentialDrive
from hostlink.core.robot.velocity import ZERO, Kinematics, PlanarVelocity, Twist
from hostlink.errors import RefusalKind

FORWARD = PlanarVelocity(0.3)


class Timeline:
    """An admission and a clock. `command` is a command of `ann` that is received now unless a test says otherwise."""

    def __init__(self, **settings: Any) -> None:
        self.now_s = 100.0
        self.admission = Admission("robot_0", **settings)  # type: ignore[arg-type]
        self.admission.connect(0.0)

    def wait(self, seconds: float) -> None:
        self.now_s += seconds

    def command(
        self,
        velocity: PlanarVelocity | Twist = FORWARD,
        *,
        source: str = "ann",
        priority: int = 50,
        waited_s: float = 0.0,
        sent_s: float | None = None,
        epoch: int | None = None,
        stamp_age_s: float | None = None,
        topic: str = "",
        is_planar: bool = True,
        take_over: bool = False,
    ) -> Decision:
        received_s = self.now_s - waited_s
        command = Command(velocity, source, priority, received_s, sent_s, epoch, stamp_age_s, is_planar, take_over)
        return self.admission.decide(command, self.now_s, topic=topic)

    def driver(self, topic: str = "") -> object:
        found = self.admission.driver(topic, self.now_s)
        return None if found is None else found.source

    def stop(self) -> None:
        self.admission.interrupt(self.now_s, came_s=self.now_s)


@pytest.fixture
def robot() -> Timeline:
    return Timeline()


@pytest.fixture
def driven(robot: Timeline) -> Timeline:
    assert robot.command().is_admitted
    return robot


def interruptions() -> list[object]:
    def lock_and_unlock(robot: Timeline) -> None:
        robot.admission.lock("smoke", robot.now_s)
        robot.admission.unlock(robot.now_s)

    def reconnect(robot: Timeline) -> None:
        robot.admission.disconnect(robot.now_s)
        robot.admission.connect(robot.now_s + 0.01)
        robot.wait(0.01)

    def pause(robot: Timeline) -> None:
        began_s = robot.now_s
        robot.wait(9.0)
        robot.admission.interrupt(robot.now_s, since_s=began_s)

    def change_topics(robot: Timeline) -> None:
        robot.admission.connect(robot.now_s)

    each = {
        "stop": Timeline.stop,
        "lock and unlock": lock_and_unlock,
        "reconnect": reconnect,
        "topics": change_topics,
        "pause": pause,
    }
    return [pytest.param(interrupt, id=name) for name, interrupt in each.items()]


def test_command_of_quiet_source_is_admitted_for_a_lease(robot: Timeline) -> None:
    assert robot.command().is_admitted
    robot.wait(LEASE_S - 0.01)
    assert robot.driver() == "ann"
    robot.wait(0.01)
    assert robot.driver() is None


def test_command_of_driving_source_prolongs_the_lease(driven: Timeline) -> None:
    driven.wait(0.4)
    assert driven.command().is_admitted
    driven.wait(0.4)
    assert driven.driver() == "ann"


@pytest.mark.parametrize("interrupt", interruptions())
def test_interruption_ends_the_lease_and_disarms_the_driver(driven: Timeline, interrupt: object) -> None:
    epoch = driven.admission.epoch
    interrupt(driven)  # type: ignore[operator]
    assert driven.driver() is None
    assert driven.admission.epoch > epoch
    for _ in range(20):
        driven.wait(LEASE_S - 0.01)
        refusal = driven.command()
        assert refusal.kind is RefusalKind.DISARMED
        assert f"pause for {LEASE_S:g} s, or send epoch {driven.admission.epoch}" in refusal.reason
    assert driven.driver() is None


@pytest.mark.parametrize("interrupt", interruptions())
def test_disarmed_source_with_current_epoch_is_admitted(driven: Timeline, interrupt: object) -> None:
    interrupt(driven)  # type: ignore[operator]
    assert driven.command(epoch=driven.admission.epoch).is_admitted
    assert driven.command().is_admitted


@pytest.mark.parametrize("interrupt", interruptions())
def test_disarmed_source_after_zero_is_admitted(driven: Timeline, interrupt: object) -> None:
    interrupt(driven)  # type: ignore[operator]
    assert driven.command(ZERO).is_admitted
    assert driven.command().is_admitted


@pytest.mark.parametrize("interrupt", interruptions())
def test_disarmed_source_after_a_lease_of_silence_is_admitted(driven: Timeline, interrupt: object) -> None:
    interrupt(driven)  # type: ignore[operator]
    driven.wait(LEASE_S)
    assert driven.command().is_admitted


def test_silence_that_only_this_daemon_made_arms_nothing(driven: Timeline) -> None:
    """A busy daemon reads late: what it reads after a lease was sent within the lease."""
    driven.stop()
    driven.wait(LEASE_S + 0.1)
    assert driven.command(waited_s=0.2).kind is RefusalKind.DISARMED
    driven.wait(LEASE_S + 0.1)
    assert driven.command(waited_s=0.1).is_admitted


def test_silence_that_only_the_network_made_arms_nothing(robot: Timeline) -> None:
    """After a gap of the network come the commands of the gap, the newest of which is as quick as those before it."""
    for sent_s in (7.0, 7.1, 7.2):
        assert robot.command(sent_s=sent_s).is_admitted
        robot.wait(0.1)
    robot.stop()
    robot.wait(1.05)
    kinds = [robot.command(sent_s=7.3 + number / 10).kind for number in range(11)]
    assert kinds == [RefusalKind.LATE] * 6 + [RefusalKind.DISARMED] * 5
    robot.wait(LEASE_S + 0.1)
    assert robot.command(sent_s=8.4 + LEASE_S).is_admitted


@pytest.mark.parametrize("silent_s", [0.0, LEASE_S + 0.1], ids=["after the stop", "also before the stop"])
def test_commands_that_come_together_after_a_silence_waited_for_the_network(driven: Timeline, silent_s: float) -> None:
    driven.wait(silent_s)
    driven.stop()
    driven.wait(LEASE_S + 0.1)
    assert driven.command().is_admitted  # nothing tells yet that it waited
    driven.wait(BUNCH_S / 2)
    assert driven.command().kind is RefusalKind.DISARMED
    assert driven.driver() is None
    for _ in range(10):
        driven.wait(0.1)
        assert driven.command().kind is RefusalKind.DISARMED
    driven.wait(LEASE_S)
    assert driven.command().is_admitted


def test_commands_that_come_together_later_in_the_lease_after_a_silence_waited_for_the_network(
    driven: Timeline,
) -> None:
    """The network brings the oldest command, and the others a round trip later."""
    driven.stop()
    driven.wait(LEASE_S + 0.1)
    assert driven.command().is_admitted
    driven.wait(0.06)
    assert driven.command().is_admitted
    assert driven.command().kind is RefusalKind.DISARMED


def test_commands_that_come_together_for_other_reasons_are_admitted(driven: Timeline) -> None:
    assert driven.command().is_admitted  # nothing has interrupted the robot
    driven.wait(LEASE_S)
    assert driven.command().is_admitted
    assert driven.command().is_admitted
    driven.stop()
    driven.wait(LEASE_S)
    assert driven.command(topic="cmd_vel").is_admitted
    assert driven.command(topic="arm_vel").is_admitted  # of one cycle of its program
    driven.wait(BUNCH_S)
    assert driven.command(topic="cmd_vel").is_admitted
    assert driven.command(topic="cmd_vel", epoch=driven.admission.epoch).is_admitted
    driven.wait(LEASE_S)
    assert driven.command(topic="cmd_vel").is_admitted
    assert driven.command(topic="cmd_vel").is_admitted  # it began anew a lease ago
    assert driven.command(source="bob").is_admitted
    assert driven.command(source="bob").is_admitted  # a new source
    assert driven.command(ZERO, source="bob").is_admitted
    driven.stop()
    assert driven.command(source="bob").is_admitted
    assert driven.command(source="bob").is_admitted  # it had let go by a zero


@pytest.mark.parametrize(("late_s", "kind"), [(0.05, None), (0.2, RefusalKind.DISARMED)])
def test_commands_that_a_slightly_late_loop_reads_together_after_a_silence_are_admitted(
    driven: Timeline, late_s: float, kind: RefusalKind | None
) -> None:
    driven.stop()
    driven.wait(2 * LEASE_S)
    assert driven.command(waited_s=late_s).is_admitted
    assert driven.command(waited_s=late_s).kind is kind


def test_command_that_is_repeated_at_once_because_it_was_refused_is_admitted(driven: Timeline) -> None:
    driven.stop()
    driven.wait(LEASE_S)
    assert driven.command(source="bob", priority=60).is_admitted
    assert driven.command().kind is RefusalKind.HELD
    assert driven.command(priority=70).is_admitted


def test_commands_that_tell_when_they_were_sent_may_come_together(robot: Timeline) -> None:
    assert robot.command(sent_s=0.0).is_admitted
    robot.stop()
    robot.wait(LEASE_S + 0.1)
    assert robot.command(sent_s=0.6).is_admitted
    assert robot.command(sent_s=0.6).is_admitted


@pytest.mark.parametrize(("rate_hz", "drives"), [(20, False), (200, True)])
def test_two_commands_at_once_after_a_silence_are_usual_of_a_fast_source(
    robot: Timeline, rate_hz: float, *, drives: bool
) -> None:
    for _ in range(100):
        assert robot.command().is_admitted
        robot.wait(1 / rate_hz)
    robot.stop()
    for _ in range(10):
        assert robot.command().kind is RefusalKind.DISARMED
        robot.wait(1 / rate_hz)
    robot.wait(LEASE_S)
    assert robot.command().is_admitted
    robot.wait(BUNCH_S / 2)
    assert robot.command().is_admitted is drives


def test_arrival_within_a_lease_after_a_silence_may_end_one_of_the_network() -> None:
    resumption = Resumption()
    times_s = [0.0, 0.4, 0.8, 1.3, 1.7, 1.9, 3.0]
    assert [at_s for at_s in times_s if resumption.is_recent(at_s)] == [1.3, 1.7, 3.0]


def test_silence_before_a_command_of_the_future_is_not_longer(driven: Timeline) -> None:
    driven.stop()
    driven.wait(LEASE_S - 0.1)
    assert driven.command(waited_s=-1.0).kind is RefusalKind.DISARMED


@pytest.mark.parametrize("interrupt", interruptions())
def test_quiet_source_after_an_interruption_is_admitted(driven: Timeline, interrupt: object) -> None:
    interrupt(driven)  # type: ignore[operator]
    assert driven.command(source="bob").is_admitted


def interrupt_while_waiting(robot: Timeline) -> float:
    """A stop, 0.1 s after a command of a quiet source began to wait; returns for how long it has waited."""
    robot.wait(2 * LEASE_S)
    robot.stop()
    robot.wait(0.1)
    return 0.1 + UNORDERED_S + 0.01


def test_command_from_before_a_stop_is_refused_and_disarms_its_source(driven: Timeline) -> None:
    waited_s = interrupt_while_waiting(driven)
    assert driven.command(waited_s=waited_s).kind is RefusalKind.DISARMED
    driven.wait(0.1)
    assert driven.command().kind is RefusalKind.DISARMED
    assert driven.command(ZERO).is_admitted
    assert driven.command().is_admitted


def test_late_command_from_before_a_stop_disarms_its_source(driven: Timeline) -> None:
    driven.wait(2 * LEASE_S)
    driven.stop()
    driven.wait(0.1)
    assert driven.command(waited_s=LEASE_S).kind is RefusalKind.LATE
    driven.wait(0.1)
    assert driven.command().kind is RefusalKind.DISARMED


def test_command_that_the_network_delayed_beyond_a_stop_is_refused(robot: Timeline) -> None:
    assert robot.command(sent_s=0.0).is_admitted
    waited_s = interrupt_while_waiting(robot)
    assert robot.command(sent_s=robot.now_s - 100.0 - waited_s).kind is RefusalKind.DISARMED


def test_command_from_before_a_stop_with_the_epoch_of_after_it_is_admitted(driven: Timeline) -> None:
    waited_s = interrupt_while_waiting(driven)
    assert driven.command(waited_s=waited_s, epoch=driven.admission.epoch).is_admitted


def test_command_that_a_slightly_late_loop_read_after_a_stop_is_admitted(driven: Timeline) -> None:
    waited_s = interrupt_while_waiting(driven)
    assert driven.command(waited_s=waited_s - 0.02).is_admitted


def test_stream_that_began_in_the_pause_in_which_a_stop_arrived_drives_after_it_let_go(robot: Timeline) -> None:
    """The loop reads both at once: the stop may have arrived after the stream began."""
    robot.admission.interrupt(robot.now_s, came_s=robot.now_s - 3.0)
    assert robot.command(waited_s=3.0).kind is RefusalKind.LATE
    robot.wait(0.1)
    assert robot.command().kind is RefusalKind.DISARMED
    robot.wait(LEASE_S)
    assert robot.command().is_admitted


def test_stream_from_before_a_pause_that_is_read_after_it_drives_after_it_let_go(robot: Timeline) -> None:
    began_s = robot.now_s - 1.0
    robot.admission.interrupt(robot.now_s, since_s=began_s, came_s=began_s)
    assert robot.command(waited_s=2.0).kind is RefusalKind.LATE
    robot.wait(0.1)
    assert robot.command().kind is RefusalKind.DISARMED


def test_command_that_a_late_loop_reads_after_a_stop_or_beside_other_interruptions_is_admitted(robot: Timeline) -> None:
    """The stop may have waited for the loop as long as the command did."""
    robot.admission.interrupt(robot.now_s, came_s=robot.now_s - 0.3)
    assert robot.command(waited_s=0.3).is_admitted
    robot.admission.lock("smoke", robot.now_s)
    robot.admission.unlock(robot.now_s)
    robot.admission.connect(robot.now_s)
    assert robot.command(source="bob", waited_s=0.3).is_admitted


@pytest.mark.parametrize(
    "admit_again",
    [
        lambda admission, now_s: admission.unlock(now_s, came_s=now_s),
        lambda admission, now_s: admission.connect(now_s, came_s=now_s),
        lambda admission, now_s: admission.note_missing("", now_s, came_s=now_s),
    ],
    ids=["unlock", "connection", "last device"],
)
def test_command_from_before_commands_were_admitted_again_moves_nothing(
    robot: Timeline, admit_again: Callable[[Admission, float], object]
) -> None:
    """The command of another source waited in its socket, while a request of a third one was read."""
    robot.admission.lock("smoke", robot.now_s)
    robot.admission.note_missing("its wheels are away", robot.now_s)
    robot.wait(1.0)
    admit_again(robot.admission, robot.now_s)
    robot.admission.lock_reason = None
    robot.admission.missing = ""
    assert robot.command(waited_s=0.2).kind is RefusalKind.DISARMED
    robot.wait(0.05)
    assert robot.command().kind is RefusalKind.DISARMED
    robot.wait(LEASE_S)
    assert robot.command().is_admitted


def test_velocity_behind_a_zero_that_waited_through_a_stop_is_refused(driven: Timeline) -> None:
    waited_s = interrupt_while_waiting(driven)
    assert driven.command(ZERO, waited_s=waited_s).is_admitted
    assert driven.command(waited_s=waited_s).kind is RefusalKind.DISARMED


def test_source_that_was_silent_for_a_lease_is_not_met_by_a_stop(driven: Timeline) -> None:
    driven.wait(LEASE_S)
    driven.stop()
    assert driven.command().is_admitted


def test_source_that_streams_is_met_by_a_stop_that_a_late_loop_obeys_before_what_waits(driven: Timeline) -> None:
    driven.wait(LEASE_S)
    driven.admission.interrupt(driven.now_s, came_s=driven.now_s - 0.3)
    assert driven.command(waited_s=0.3).kind is RefusalKind.DISARMED


def test_lock_ends_the_lease_at_once(driven: Timeline) -> None:
    epoch = driven.admission.epoch
    driven.admission.lock("smoke", driven.now_s)
    assert driven.driver() is None
    assert driven.admission.epoch == epoch + 1


def test_command_with_earlier_epoch_disarms_its_source(robot: Timeline) -> None:
    epoch = robot.admission.epoch
    robot.stop()
    assert robot.command(epoch=epoch).kind is RefusalKind.DISARMED
    robot.wait(0.1)
    assert robot.command().kind is RefusalKind.DISARMED


def test_command_with_the_epoch_of_another_daemon_is_refused(robot: Timeline) -> None:
    assert robot.command(epoch=robot.admission.epoch + 1).kind is RefusalKind.DISARMED


def test_zero_that_is_late_does_not_arm(driven: Timeline) -> None:
    driven.stop()
    driven.wait(0.1)
    assert driven.command(ZERO, waited_s=LEASE_S).is_admitted
    assert driven.command().kind is RefusalKind.DISARMED


def test_source_that_leaves_stops_the_topics_that_it_drove(driven: Timeline) -> None:
    assert driven.command(topic="other").is_admitted
    driven.admission.withdraw("bob")
    assert driven.driver() == driven.driver("other") == "ann"
    driven.admission.withdraw("ann")
    assert driven.driver() is driven.driver("other") is None


def test_source_that_leaves_holds_the_robot_no_more(driven: Timeline) -> None:
    driven.admission.withdraw("ann")
    assert not driven.admission.is_held(driven.now_s)
    assert driven.command(source="bob", priority=10).is_admitted


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_velocity_that_is_not_finite_is_refused(robot: Timeline, value: float) -> None:
    refusal = robot.command(PlanarVelocity(value))
    assert refusal == Decision(RefusalKind.NOT_FINITE, "robot_0: a velocity must consist of finite numbers")


def test_sideways_velocity_is_refused_for_a_differential_drive_alone(robot: Timeline) -> None:
    sideways = PlanarVelocity(0.2, -0.1)
    assert robot.command(sideways).is_admitted
    robot.admission.drive = DifferentialDrive()
    refusal = robot.command(sideways)
    assert refusal == Decision(
        RefusalKind.UNSUPPORTED,
        "robot_0: a differential drive cannot move sideways: send 0 as linear.y; if this robot can, remove "
        'kinematics = "differential" from its settings',
    )
    assert robot.command().is_admitted
    assert robot.driver() == "ann"


def test_turn_in_place_is_refused_for_a_car_and_a_curve_is_not(robot: Timeline) -> None:
    robot.admission.drive = AckermannDrive()
    refusal = robot.command(PlanarVelocity(yaw_rad_s=0.5))
    assert refusal == Decision(
        RefusalKind.UNSUPPORTED,
        "robot_0: a car with steered wheels cannot turn in place: send a linear.x that is not 0 together with "
        "angular.z",
    )
    assert robot.command(PlanarVelocity(0.2, yaw_rad_s=0.5)).is_admitted


@pytest.mark.parametrize(
    ("velocity", "is_planar"), [(PlanarVelocity(0.2, -0.1), True), (FORWARD, False), (ZERO, False)]
)
def test_locked_robot_answers_with_its_lock_also_what_it_could_not_do(
    robot: Timeline, velocity: PlanarVelocity, *, is_planar: bool
) -> None:
    robot.admission.drive = DifferentialDrive()
    robot.admission.lock("smoke", robot.now_s)
    refusal = robot.command(velocity, is_planar=is_planar)
    assert refusal.kind is RefusalKind.LOCKED
    assert "locked: smoke" in refusal.reason


@pytest.mark.parametrize("velocity", [ZERO, FORWARD])
def test_twist_with_components_that_no_robot_has_is_refused_and_is_not_a_zero(
    driven: Timeline, velocity: PlanarVelocity
) -> None:
    refusal = driven.command(velocity, is_planar=False)
    assert refusal.kind is RefusalKind.UNSUPPORTED
    assert refusal.reason == "robot_0: a robot moves in the plane: send 0 as linear.z, angular.x and angular.y"
    driven.stop()
    driven.command(velocity, is_planar=False)
    assert driven.command().kind is RefusalKind.DISARMED


def test_velocity_topic_without_a_robot_is_driven_with_all_six_numbers() -> None:
    topic = Timeline(drive=None)
    assert topic.command(Twist(linear_z_m_s=0.1)).is_admitted


def test_command_while_locked_is_refused_and_unlocking_moves_nothing(robot: Timeline) -> None:
    robot.admission.lock("smoke", robot.now_s)
    for _ in range(5):
        robot.wait(0.1)
        refusal = robot.command()
        assert refusal.kind is RefusalKind.LOCKED
        assert "locked: smoke" in refusal.reason
    robot.admission.unlock(robot.now_s)
    robot.wait(0.1)
    assert robot.command().kind is RefusalKind.DISARMED


def test_refusal_names_who_locked_or_what_disarmed_the_source(driven: Timeline) -> None:
    admission = driven.admission
    admission.interrupt(driven.now_s, by=named("a stop", "the page"))
    assert driven.command().by == "a stop by the page"
    assert "was driving (a stop by the page); to drive again" in driven.command().reason
    admission.lock("smoke", driven.now_s, by="bob")
    assert driven.command().by == "bob"
    admission.unlock(driven.now_s)
    assert driven.command().by == named("an unlock", None) == "an unlock"
    admission.disconnect(driven.now_s)
    assert driven.command().by is None
    admission.connect(driven.now_s)
    assert driven.command().by == "a reconnection of its device"
    driven.stop()
    assert driven.command().by is None
    driven.wait(LEASE_S)
    driven.command(source="bob", priority=60)
    refused = driven.command()
    assert (refused.holder, refused.by) == ("bob", "bob")


def test_zero_while_locked_arms_for_the_time_after_unlock(robot: Timeline) -> None:
    robot.admission.lock("smoke", robot.now_s)
    assert robot.command().kind is RefusalKind.LOCKED
    assert robot.command(ZERO).is_admitted
    robot.admission.unlock(robot.now_s)
    assert robot.command().is_admitted


def test_unlock_of_unlocked_robot_interrupts_nothing(driven: Timeline) -> None:
    driven.admission.unlock(driven.now_s)
    assert driven.driver() == "ann"


def test_command_without_device_is_refused_and_does_not_move_the_device_after_reconnect(robot: Timeline) -> None:
    robot.admission.disconnect(robot.now_s)
    for _ in range(5):
        robot.wait(0.1)
        assert robot.command().kind is RefusalKind.NOT_CONNECTED
    assert robot.command(ZERO, source="bob").kind is RefusalKind.NOT_CONNECTED
    robot.admission.connect(robot.now_s)
    robot.wait(0.1)
    assert robot.command().kind is RefusalKind.DISARMED


def test_disconnect_and_connect_end_lease_and_hold(driven: Timeline) -> None:
    driven.admission.disconnect(driven.now_s)
    assert driven.driver() is None
    assert not driven.admission.is_held(driven.now_s)
    driven.admission.connect(driven.now_s)
    assert driven.command(source="eve").is_admitted
    driven.admission.connect(driven.now_s)  # it has other topics
    assert driven.command(source="bob", priority=10).is_admitted


@pytest.mark.parametrize("away_s", [0.0, LEASE_S, 60.0])
def test_source_that_drove_when_the_device_left_is_disarmed_however_long_it_was_away(
    driven: Timeline, away_s: float
) -> None:
    """A publisher continues without an answer, and is not visible while no device subscribes."""
    driven.admission.disconnect(driven.now_s)
    driven.wait(away_s)
    driven.admission.disconnect(driven.now_s)  # by another link of it, which was never ready
    driven.admission.connect(driven.now_s)
    driven.wait(0.1)
    assert driven.command().kind is RefusalKind.DISARMED
    driven.wait(LEASE_S)
    assert driven.command().is_admitted
    driven.wait(LEASE_S)
    driven.admission.disconnect(driven.now_s)
    driven.admission.connect(driven.now_s)
    assert driven.command().is_admitted


def test_source_that_let_go_while_the_device_was_away_is_armed(driven: Timeline) -> None:
    driven.admission.disconnect(driven.now_s)
    assert driven.command(ZERO).kind is RefusalKind.NOT_CONNECTED
    driven.admission.connect(driven.now_s)
    assert driven.command().is_admitted


MISSING = "its device 10.0.0.3 is not connected"


def test_robot_that_lacks_a_device_is_not_driven_and_says_which(driven: Timeline) -> None:
    driven.admission.note_missing(MISSING, driven.now_s)
    assert driven.driver() is None
    assert not driven.admission.is_held(driven.now_s)
    refusal = driven.command(source="eve")
    assert (refusal.kind, refusal.reason) == (RefusalKind.NOT_CONNECTED, f"robot_0: {MISSING}")
    assert driven.command(ZERO).is_admitted  # the device that is commanded is there


@pytest.mark.parametrize("away_s", [0.1, LEASE_S, 60.0])
def test_source_that_drove_when_a_device_of_the_robot_left_must_let_go(driven: Timeline, away_s: float) -> None:
    driven.admission.note_missing(MISSING, driven.now_s)
    driven.wait(away_s)
    driven.admission.note_missing("", driven.now_s)
    refusal = driven.command()
    assert refusal.kind is RefusalKind.DISARMED
    assert "a reconnection of one of its devices" in refusal.reason
    assert driven.command(source="eve").is_admitted
    assert driven.command(ZERO, source="eve").is_admitted
    driven.wait(LEASE_S)
    assert driven.command().is_admitted
    driven.wait(LEASE_S)
    driven.admission.note_missing(MISSING, driven.now_s)  # while the robot has no driver
    driven.admission.note_missing("", driven.now_s)
    assert driven.command().is_admitted


def test_source_that_let_go_while_a_device_of_the_robot_was_away_is_armed(driven: Timeline) -> None:
    driven.admission.note_missing(MISSING, driven.now_s)
    assert driven.command(ZERO).is_admitted
    driven.admission.note_missing("", driven.now_s)
    assert driven.command().is_admitted


def test_robot_that_still_has_all_its_devices_is_not_interrupted(driven: Timeline) -> None:
    epoch = driven.admission.epoch
    driven.admission.note_missing("", driven.now_s)
    assert (driven.driver(), driven.admission.epoch) == ("ann", epoch)


@pytest.mark.parametrize(("away_s", "kind"), [(2.5, None), (3.0, RefusalKind.DISARMED)])
def test_source_continues_after_an_absence_within_resume_after_reconnect(
    away_s: float, kind: RefusalKind | None
) -> None:
    robot = Timeline(resume_after_reconnect_s=3.0)
    assert robot.command().is_admitted
    robot.admission.disconnect(robot.now_s)
    for _ in range(8):
        robot.wait(away_s / 8)
        assert robot.command().kind is RefusalKind.NOT_CONNECTED
    robot.admission.connect(robot.now_s)
    robot.admission.connect(robot.now_s + 0.001)  # its second velocity topic
    robot.wait(0.1)
    assert robot.command().kind is kind


@pytest.mark.parametrize("waited_s", [LEASE_S, 9.0])
def test_command_that_waited_for_a_lease_is_refused(robot: Timeline, waited_s: float) -> None:
    refusal = robot.command(waited_s=waited_s)
    assert refusal.kind is RefusalKind.LATE
    assert refusal.reason == f"robot_0: velocity is {waited_s:.1f} s old, and holds for 0.5 s; send a new one"
    assert robot.command(waited_s=LEASE_S - 0.01).is_admitted


def test_lease_of_a_command_that_waited_is_shorter_by_that_time(robot: Timeline) -> None:
    assert robot.command(waited_s=0.4).is_admitted
    robot.wait(0.09)
    assert robot.driver() == "ann"
    robot.wait(0.02)
    assert robot.driver() is None


def test_lease_is_not_longer_for_a_command_of_the_future(robot: Timeline) -> None:
    assert robot.command(waited_s=-1.0).is_admitted
    robot.wait(LEASE_S)
    assert robot.driver() is None


def test_command_that_was_delayed_on_its_way_is_refused_by_the_clock_of_its_sender(robot: Timeline) -> None:
    assert robot.command(sent_s=7.0).is_admitted
    robot.wait(1.0)
    assert robot.command(sent_s=7.4).kind is RefusalKind.LATE  # 0.6 s later than the first one
    assert robot.command(sent_s=7.6).is_admitted
    assert robot.command(sent_s=7.8, waited_s=0.4).is_admitted
    assert robot.command(sent_s=7.8, waited_s=0.4 + LEASE_S).kind is RefusalKind.LATE


def test_command_whose_stamp_is_older_than_allowed_is_refused() -> None:
    robot = Timeline(max_stamp_age_s=1.0)
    refusal = robot.command(stamp_age_s=1.2)
    assert refusal.kind is RefusalKind.LATE
    assert refusal.reason == "robot_0: its stamp is 1.200 s old, cmd_vel_max_age_s allows 1"
    assert robot.command(stamp_age_s=1.0).is_admitted
    robot.stop()
    assert robot.command(ZERO, stamp_age_s=1.2).is_admitted
    assert robot.command().kind is RefusalKind.DISARMED


def test_stamp_of_any_age_is_admitted_unless_an_age_is_configured(robot: Timeline) -> None:
    assert robot.command(stamp_age_s=1e9).is_admitted


def test_route_that_became_slower_for_good_is_accepted_in_time(robot: Timeline) -> None:
    assert robot.command(sent_s=robot.now_s).is_admitted
    kinds = set()
    for _ in range(1000):
        robot.wait(1.0)
        kinds.add(robot.command(sent_s=robot.now_s - 0.7).kind)
    assert kinds == {RefusalKind.LATE, None}
    assert robot.driver() == "ann"


def test_pause_of_the_daemon_makes_no_later_command_late(robot: Timeline) -> None:
    assert robot.command(sent_s=7.0).is_admitted
    robot.wait(3.0)
    assert robot.command(sent_s=10.0, waited_s=3.0).kind is RefusalKind.LATE  # it may have waited since then
    robot.wait(LEASE_S)
    assert robot.command(sent_s=10.5).is_admitted


def test_lower_priority_is_refused_while_a_higher_one_holds_and_continues_afterwards(robot: Timeline) -> None:
    assert robot.command(source="bob", priority=10).is_admitted
    assert robot.command(source="ann", priority=60).is_admitted
    for _ in range(4):
        robot.wait(0.1)
        refusal = robot.command(source="bob", priority=10)
        assert refusal.kind is RefusalKind.HELD
        assert refusal.holder == "ann"
        assert "ann drives it with a higher priority" in refusal.reason
    robot.wait(0.11)
    assert robot.command(source="bob", priority=10).is_admitted


def test_source_of_the_same_priority_is_held_until_the_other_lets_go(driven: Timeline) -> None:
    for _ in range(9):
        driven.wait(LEASE_S - 0.01)
        refusal = driven.command(source="bob")
        assert (refusal.kind, refusal.holder, refusal.by) == (RefusalKind.HELD, "ann", "ann")
        assert refusal.reason == (
            "robot_0: ann drives it with the same priority; wait until it lets go, stop it, or use take_over"
        )
        assert driven.command().is_admitted


@pytest.mark.parametrize("how", ["zero", "silence", "leave", "stop"])
def test_source_of_the_same_priority_drives_once_the_other_let_go_or_was_stopped(driven: Timeline, how: str) -> None:
    assert driven.command(source="bob").kind is RefusalKind.HELD
    if how == "zero":
        assert driven.command(ZERO).is_admitted
    elif how == "silence":
        driven.wait(LEASE_S)
    elif how == "leave":
        driven.admission.withdraw("ann")
    else:
        driven.wait(LEASE_S - 0.1)
        assert driven.command().is_admitted
        assert driven.command(ZERO, source="bob").kind is RefusalKind.HELD  # which arms it for after the stop
        driven.stop()
    assert driven.command(source="bob").is_admitted
    assert driven.driver() == "bob"


@pytest.fixture
def taken(driven: Timeline) -> Timeline:
    """Driven by bob, who has just taken the robot over from ann."""
    assert driven.command(source="bob").kind is RefusalKind.HELD
    assert driven.command(source="bob", take_over=True).is_admitted
    assert driven.driver() == "bob"
    return driven


@pytest.mark.parametrize("take_over", [False, True])
@pytest.mark.parametrize("has_epoch", [False, True])
def test_source_that_was_taken_over_is_held_by_the_other_until_it_lets_go(
    taken: Timeline, *, take_over: bool, has_epoch: bool
) -> None:
    for _ in range(9):
        taken.wait(LEASE_S - 0.01)
        assert taken.command(source="bob", take_over=take_over).is_admitted
        refusal = taken.command(take_over=take_over, epoch=taken.admission.epoch if has_epoch else None)
        assert (refusal.kind, refusal.holder) == (RefusalKind.HELD, "bob")
        assert refusal.reason == (
            "robot_0: bob has taken it over; to take it over again, send a zero, or pause for 0.5 s first"
        )
    assert taken.driver() == "bob"


@pytest.mark.parametrize("priority", [50, 60])
def test_source_that_was_taken_over_is_disarmed_when_no_other_holds_the_robot(taken: Timeline, priority: int) -> None:
    if priority == 50:
        assert taken.command(ZERO, source="bob").is_admitted
    for _ in range(3):
        taken.wait(0.1)
        refusal = taken.command(priority=priority, epoch=taken.admission.epoch, take_over=True)
        assert (refusal.kind, refusal.by) == (RefusalKind.DISARMED, "a take-over by bob")
        assert refusal.reason == "robot_0: bob took it over; to drive again, send a zero, or pause for 0.5 s"


@pytest.mark.parametrize("how", ["zero", "silence"])
def test_source_that_was_taken_over_may_take_over_after_it_let_go(taken: Timeline, how: str) -> None:
    if how == "zero":
        assert taken.command(ZERO).kind is RefusalKind.HELD  # a zero of another does not stop bob
    else:
        taken.wait(LEASE_S)
        assert taken.command(source="bob").is_admitted
    assert taken.command().kind is RefusalKind.HELD
    assert taken.command(take_over=True).is_admitted
    assert taken.driver() == "ann"
    assert taken.command(source="bob", take_over=True).kind is RefusalKind.HELD


def test_take_over_interrupts_none_but_the_driver(driven: Timeline) -> None:
    epoch = driven.admission.epoch
    for source in ("bob", "eve"):
        assert driven.command(source=source, epoch=epoch).kind is RefusalKind.HELD
    assert driven.command(source="bob", epoch=epoch, take_over=True).is_admitted
    assert driven.command(source="bob", epoch=epoch).is_admitted
    assert driven.command(source="eve", epoch=epoch, priority=60).is_admitted


@pytest.mark.parametrize("how", ["stop", "lock"])
def test_take_over_replaces_no_release_after_an_interruption(driven: Timeline, how: str) -> None:
    assert driven.command(source="bob").kind is RefusalKind.HELD
    if how == "stop":
        driven.stop()
    else:
        driven.admission.lock("smoke", driven.now_s)
        assert driven.command(source="bob", take_over=True).kind is RefusalKind.LOCKED
        driven.admission.unlock(driven.now_s)
    driven.wait(0.1)
    assert driven.command(source="bob", take_over=True).kind is RefusalKind.DISARMED
    assert driven.command(take_over=True).kind is RefusalKind.DISARMED


def test_source_that_was_taken_over_must_let_go_after_a_later_stop_too(taken: Timeline) -> None:
    taken.stop()
    taken.wait(0.1)
    refusal = taken.command(epoch=taken.admission.epoch)
    assert (refusal.kind, refusal.by) == (RefusalKind.DISARMED, "a take-over by bob")
    assert taken.command(ZERO).is_admitted
    assert taken.command().is_admitted


def test_higher_priority_is_not_taken_over(robot: Timeline) -> None:
    assert robot.command(priority=60).is_admitted
    refusal = robot.command(source="bob", take_over=True)
    assert (refusal.kind, refusal.holder) == (RefusalKind.HELD, "ann")
    assert "with a higher priority" in refusal.reason
    assert robot.driver() == "ann"


def test_source_that_a_higher_priority_overruled_drives_afterwards_without_letting_go(driven: Timeline) -> None:
    assert driven.command(source="bob", priority=60, take_over=True).is_admitted
    assert driven.command().kind is RefusalKind.HELD
    assert driven.command(ZERO, source="bob", priority=60).is_admitted
    assert driven.command().is_admitted


def test_take_over_of_a_robot_at_rest_drives(robot: Timeline) -> None:
    assert robot.command(take_over=True).is_admitted
    robot.wait(LEASE_S)
    assert robot.command(source="bob", take_over=True).is_admitted
    assert robot.command().kind is RefusalKind.HELD  # it was not taken over
    assert robot.command(take_over=True).is_admitted


def test_take_over_of_one_topic_ends_all_that_its_driver_drove(driven: Timeline) -> None:
    for topic, source in (("arm", "ann"), ("other", "eve")):
        assert driven.command(topic=topic, source=source).is_admitted
    assert driven.command(topic="arm", source="bob", take_over=True).is_admitted
    assert driven.driver() is None
    assert (driven.driver("arm"), driven.driver("other")) == ("bob", "eve")
    assert driven.command().kind is RefusalKind.DISARMED
    assert driven.command(topic="arm").kind is RefusalKind.HELD
    assert driven.command(ZERO, topic="arm", source="bob").is_admitted
    assert driven.command(source="carl", priority=10).kind is RefusalKind.HELD  # by eve


def test_driver_that_is_more_important_by_another_topic_alone_keeps_each_topic_at_its_priority(robot: Timeline) -> None:
    assert robot.command(topic="arm", priority=60).is_admitted
    assert robot.command(priority=40).is_admitted  # the newest one
    refusal = robot.command(topic="arm", source="bob", take_over=True)
    assert (refusal.kind, refusal.holder) == (RefusalKind.HELD, "ann")
    assert "with a higher priority" in refusal.reason
    assert robot.command(source="bob").is_admitted


@pytest.mark.parametrize("period_s", [0.02, 0.1, 0.4])
@pytest.mark.parametrize("take_over", [False, True])
def test_two_sources_of_one_priority_do_not_shake_the_robot(
    robot: Timeline, period_s: float, *, take_over: bool
) -> None:
    drivers = []
    for _ in range(100):
        for source in ("ann", "bob"):
            robot.command(source=source, take_over=take_over)
            drivers.append(robot.driver())
        robot.wait(period_s)
    changes = sum(before != after for before, after in itertools.pairwise(drivers))
    assert changes == take_over  # at most one: the first take-over


def test_source_may_change_its_priority(robot: Timeline) -> None:
    assert robot.command(priority=10).is_admitted
    assert robot.command(priority=60).is_admitted
    assert robot.command(source="bob").kind is RefusalKind.HELD
    assert robot.command(priority=10).is_admitted
    assert robot.command(source="bob").is_admitted


def test_the_most_important_of_several_holds(robot: Timeline) -> None:
    assert robot.command(source="bob", priority=10).is_admitted
    assert robot.command(source="ann", priority=60).is_admitted
    refusal = robot.command(source="eve", priority=50)
    assert (refusal.kind, refusal.holder) == (RefusalKind.HELD, "ann")
    robot.wait(0.3)
    assert robot.command(source="ann", priority=60).is_admitted
    robot.wait(0.3)  # the lease of bob is over
    assert robot.admission.is_held(robot.now_s)


def test_higher_priority_holds_every_topic_of_the_robot(driven: Timeline) -> None:
    assert driven.command(source="bob", priority=10, topic="other").kind is RefusalKind.HELD


def test_source_that_is_held_is_disarmed_by_a_stop_too(driven: Timeline) -> None:
    assert driven.command(source="bob", priority=10).kind is RefusalKind.HELD
    driven.stop()
    driven.wait(0.4)
    assert driven.command(source="bob", priority=10).kind is RefusalKind.DISARMED


def test_stop_does_not_shorten_the_time_for_which_the_robot_is_held(driven: Timeline) -> None:
    driven.stop()
    driven.wait(LEASE_S - 0.01)
    assert driven.command(source="bob", priority=10).kind is RefusalKind.HELD
    driven.wait(0.01)
    assert driven.command(source="bob", priority=10).is_admitted


def test_zero_of_another_source_is_refused_while_one_drives(driven: Timeline) -> None:
    refusal = driven.command(ZERO, source="bob", priority=60)
    assert refusal.kind is RefusalKind.HELD
    assert "ann drives it, and a zero of another source does not stop it" in refusal.reason
    assert "hostlink stop robot_0, or POST /api/robots/robot_0/stop" in refusal.reason
    assert driven.driver() == "ann"


def test_zero_of_the_driver_ends_its_lease(driven: Timeline) -> None:
    driven.wait(0.3)
    assert driven.command(ZERO).is_admitted
    assert driven.driver() is None
    assert driven.command(ZERO, source="bob").is_admitted


@pytest.mark.parametrize("priority", [50, 60])
@pytest.mark.parametrize("topic", ["", "other"])
def test_source_that_was_overruled_holds_no_robot_after_the_zero_of_the_other(
    driven: Timeline, priority: int, topic: str
) -> None:
    assert driven.command(source="bob", priority=priority, topic=topic, take_over=True).is_admitted
    assert driven.command(ZERO, source="bob", priority=priority, topic=topic).is_admitted
    is_beside = topic == "other" and priority == 50  # then both drive
    assert driven.driver() == ("ann" if is_beside else None)
    assert driven.command(source="eve", priority=10).is_admitted == (not is_beside)


def test_source_that_was_overruled_after_a_stop_holds_no_robot(driven: Timeline) -> None:
    driven.stop()
    assert driven.command(source="bob").is_admitted
    assert driven.command(ZERO, source="bob").is_admitted
    assert driven.command(source="eve", priority=10).is_admitted


def test_end_of_one_topic_keeps_the_robot_held(driven: Timeline) -> None:
    driven.admission.end("")
    assert driven.driver() is None
    assert driven.admission.is_held(driven.now_s)
    assert driven.command().is_admitted
    driven.wait(LEASE_S)
    assert not driven.admission.is_held(driven.now_s)


def crowd(robot: Timeline, *, priority: int = 50, topics: bool = False) -> None:
    for number in range(MAX_SOURCES):
        robot.command(source=f"{number}", priority=priority, topic=f"{number}" if topics else "")


def test_one_more_source_than_the_limit_is_refused_unless_it_is_more_important(robot: Timeline) -> None:
    crowd(robot)
    assert robot.command(source="ann").kind is RefusalKind.CROWDED
    assert robot.command(source="ann", priority=60).is_admitted
    assert robot.command(ZERO, source="bob").kind is RefusalKind.HELD
    robot.wait(LEASE_S)
    assert robot.command(source="bob").is_admitted


def test_of_equals_the_one_gives_way_that_commanded_the_longest_ago(robot: Timeline) -> None:
    crowd(robot)
    assert robot.command(source="1").kind is RefusalKind.HELD
    assert robot.command(source="0").is_admitted  # and drives
    assert robot.command(source="ann", priority=60).is_admitted
    robot.stop()
    assert robot.command(source="0").kind is RefusalKind.DISARMED
    assert robot.command(source="2").kind is RefusalKind.CROWDED


def test_the_least_important_of_several_gives_way(robot: Timeline) -> None:
    assert robot.command(source="bob", priority=10).is_admitted
    for number in range(1, MAX_SOURCES):
        assert robot.command(source=f"{number}").is_admitted == (number == 1)
    assert robot.command(source="ann", priority=50).kind is RefusalKind.HELD  # it has a record


def test_source_that_drives_never_gives_way(robot: Timeline) -> None:
    crowd(robot, topics=True)
    assert robot.command(source="ann", priority=60).kind is RefusalKind.CROWDED


def test_sources_that_only_were_refused_are_as_important_as_they_said(robot: Timeline) -> None:
    robot.admission.lock("smoke", robot.now_s)
    crowd(robot, priority=60)
    assert robot.command(source="ann").kind is RefusalKind.CROWDED


def test_source_that_gave_a_zero_gives_its_record_to_another_in_a_crowd(robot: Timeline) -> None:
    crowd(robot, priority=60)
    assert robot.command(source="ann").kind is RefusalKind.CROWDED
    assert robot.command(ZERO, source="0").is_admitted
    assert robot.command(source="ann").is_admitted  # the others were refused


def test_sources_that_let_go_after_a_stop_give_way(robot: Timeline) -> None:
    crowd(robot)
    robot.stop()
    for number in range(MAX_SOURCES):
        assert robot.command(ZERO, source=f"{number}").is_admitted
    assert robot.command(source="ann", priority=60).is_admitted


def test_sources_that_drove_when_the_device_left_are_not_forgotten(robot: Timeline) -> None:
    crowd(robot)
    robot.admission.disconnect(robot.now_s)
    robot.wait(9.0)
    robot.command(source="ann")
    robot.admission.connect(robot.now_s)
    assert {robot.command(source=f"{number}").kind for number in range(MAX_SOURCES)} == {RefusalKind.DISARMED}


def test_disarmed_source_is_never_forgotten_for_another(robot: Timeline) -> None:
    crowd(robot)
    robot.stop()
    assert robot.command(source="ann", priority=100).kind is RefusalKind.CROWDED
    assert robot.command(source="0").kind is RefusalKind.DISARMED


def test_source_that_was_crowded_out_must_let_go_after_a_stop(robot: Timeline) -> None:
    crowd(robot)
    assert robot.command(source="ann").kind is RefusalKind.CROWDED
    robot.wait(0.1)
    robot.stop()
    robot.wait(0.1)
    assert robot.command(source="ann").kind is RefusalKind.CROWDED
    robot.admission.withdraw("0")
    robot.wait(LEASE_S - 0.01)
    for _ in range(9):
        assert robot.command(source="ann").kind is RefusalKind.DISARMED
        robot.wait(0.1)
    assert robot.command(ZERO, source="ann").is_admitted
    assert robot.command(source="ann").is_admitted


def test_source_whose_record_was_dropped_must_let_go_after_a_stop(robot: Timeline) -> None:
    crowd(robot)
    assert robot.command(source="ann", priority=60).is_admitted  # instead of "0"
    robot.stop()
    robot.admission.withdraw("1")
    assert robot.command(source="0").kind is RefusalKind.DISARMED


def test_source_without_a_record_drives_after_a_lease_without_a_crowd_or_with_the_epoch(robot: Timeline) -> None:
    crowd(robot)
    assert robot.command(source="ann").kind is RefusalKind.CROWDED
    robot.stop()
    robot.admission.withdraw("0")
    robot.admission.withdraw("1")
    assert robot.command(source="eve", epoch=robot.admission.epoch).is_admitted
    robot.wait(LEASE_S)
    assert robot.command(source="bob").is_admitted


def test_source_that_was_crowded_out_drives_when_there_is_room_if_nothing_interrupted_it(robot: Timeline) -> None:
    crowd(robot)
    assert robot.command(source="ann").kind is RefusalKind.CROWDED
    robot.wait(LEASE_S)
    assert robot.command(source="ann").is_admitted


def test_source_that_lost_its_device_gives_way_to_none(robot: Timeline) -> None:
    crowd(robot)
    robot.admission.disconnect(robot.now_s)
    assert robot.command(source="ann", priority=60).kind is RefusalKind.CROWDED


def test_source_whose_drives_are_ended_holds_no_robot_and_is_disarmed_by_a_stop(driven: Timeline) -> None:
    driven.admission.end_drives("ann")
    assert driven.driver() is None
    assert not driven.admission.is_held(driven.now_s)
    driven.stop()
    assert driven.command().kind is RefusalKind.DISARMED
    driven.admission.end_drives("nobody")


def test_refusals_are_counted_by_kind(driven: Timeline) -> None:
    driven.stop()
    for _ in range(3):
        driven.command()
    driven.command(waited_s=1.0)
    assert driven.admission.refused == {RefusalKind.DISARMED: 3, RefusalKind.LATE: 1}


@pytest.mark.parametrize("refusal", [RefusalKind.NOT_FINITE, RefusalKind.LOCKED, RefusalKind.LATE])
def test_refused_command_with_earlier_epoch_disarms_its_source(robot: Timeline, refusal: RefusalKind) -> None:
    """A graph marks only the first velocity of a motion that it joins; what follows continues it."""
    if refusal is RefusalKind.LOCKED:
        robot.admission.lock("smoke", robot.now_s)
    velocity = PlanarVelocity(float("nan")) if refusal is RefusalKind.NOT_FINITE else FORWARD
    waited_s = LEASE_S if refusal is RefusalKind.LATE else 0.0
    assert robot.command(velocity, waited_s=waited_s, epoch=EARLIER_EPOCH).kind is refusal
    robot.admission.unlock(robot.now_s)
    for _ in range(5):
        robot.wait(LEASE_S - 0.1)
        assert robot.command().kind is RefusalKind.DISARMED
    robot.wait(LEASE_S)
    assert robot.command().is_admitted


def test_numbers_that_are_not_finite_are_commands_that_a_source_still_gives(driven: Timeline) -> None:
    driven.stop()
    for _ in range(5):
        driven.wait(LEASE_S - 0.1)
        assert driven.command(PlanarVelocity(float("inf"))).kind is RefusalKind.NOT_FINITE
    driven.wait(LEASE_S - 0.1)
    assert driven.command().kind is RefusalKind.DISARMED


def test_first_command_of_a_publisher_that_was_there_before_has_an_earlier_epoch() -> None:
    joined = EarlierMotion.within_a_lease(10.0)
    assert joined.pop_epoch(10.0 + LEASE_S - 0.01) == EARLIER_EPOCH
    assert joined.pop_epoch(10.0 + LEASE_S - 0.01) is None


def test_publisher_that_was_silent_for_a_lease_begins_anew() -> None:
    joined = EarlierMotion.within_a_lease(10.0)
    assert joined.pop_epoch(10.0 + LEASE_S) is None
    assert EarlierMotion().pop_epoch(0.0) is None


def test_source_that_published_before_the_robot_drives_after_a_lease_of_silence(robot: Timeline) -> None:
    robot.admission.join(["ann"], robot.now_s)
    for _ in range(5):
        robot.wait(LEASE_S - 0.1)
        assert robot.command().kind is RefusalKind.DISARMED
    robot.wait(LEASE_S)
    assert robot.command().is_admitted


@pytest.mark.parametrize("how", ["zero", "silent", "epoch", "left", "another"])
def test_source_that_published_before_the_robot_drives_where_its_motion_is_a_new_one(how: str) -> None:
    robot = Timeline()
    robot.admission.join(["ann"], robot.now_s)
    if how == "zero":
        assert robot.command(ZERO).is_admitted
    elif how == "silent":
        robot.wait(LEASE_S)
    elif how == "left":
        robot.admission.withdraw("ann")
    epoch = robot.admission.epoch if how == "epoch" else None
    assert robot.command(source="bob" if how == "another" else "ann", epoch=epoch).is_admitted


def test_zero_of_before_the_robot_that_is_late_arms_nothing(robot: Timeline) -> None:
    robot.admission.join(["ann"], robot.now_s)
    assert robot.command(ZERO, waited_s=LEASE_S).is_admitted
    assert robot.command().kind is RefusalKind.DISARMED


def test_sources_that_published_before_the_robot_are_kept_for_a_lease(robot: Timeline) -> None:
    robot.admission.join(["ann"], robot.now_s)
    robot.wait(LEASE_S)
    robot.admission.join(["bob"], robot.now_s)
    assert robot.admission._joined.keys() == {"bob"}


@pytest.mark.parametrize(("away_s", "is_interruption"), [(0.9, False), (1.0, True)])
def test_reconnection_within_the_time_to_resume_does_not_interrupt(away_s: float, *, is_interruption: bool) -> None:
    robot = Timeline(resume_after_reconnect_s=1.0)
    robot.admission.disconnect(robot.now_s)
    robot.wait(away_s)
    assert robot.admission.connect(robot.now_s) is is_interruption


# -- commands to what does not exist ----------------------------------------------------------------------------------


def test_commands_to_an_unknown_name_are_known_for_a_lease() -> None:
    earlier = EarlierCommands()
    assert earlier.is_empty
    earlier.note("rover", "script", 10.0)
    earlier.note("other", "page", 10.1)
    earlier.note("rover", "phone", 10.2)
    assert not earlier.is_empty
    assert earlier.sources("rover", 10.3) == ("script", "phone")
    assert earlier.sources("rover", 10.0 + LEASE_S) == ("phone",)
    assert earlier.sources("rover", 10.2 + LEASE_S) == ()


def test_commands_to_unknown_names_are_forgotten_after_a_lease_and_over_their_bound() -> None:
    earlier = EarlierCommands()
    for number in range(MAX_EARLIER + 1):
        earlier.note("rover", number, 10.0)
    earlier.note("rover", 1, 10.1)
    assert earlier.sources("rover", 10.1) == (*range(2, MAX_EARLIER + 1), 1, ANY_SOURCE)
    earlier.note("rover", "script", 10.1 + LEASE_S)
    assert earlier.sources("rover", 10.1 + LEASE_S) == ("script",)


@pytest.mark.parametrize("has_record", [False, True])
def test_source_that_is_one_of_too_many_earlier_ones_is_disarmed(*, has_record: bool) -> None:
    earlier, admission = EarlierCommands(), Admission("rover")
    script, other = (Command(PlanarVelocity(0.1), source, 50, 10.3) for source in ("script", "other"))
    if has_record:
        admission.connect(8.0)
        assert admission.decide(script._replace(received_s=8.0), 8.0).kind is None
        admission.disconnect(9.0)
    earlier.note("rover", "script", 10.0)
    for number in range(MAX_EARLIER):
        earlier.note(f"rover_{number}", number, 10.1)
    admission.join(earlier.sources("rover", 10.2), 10.2)
    admission.connect(10.2)
    assert admission.decide(script, 10.3).kind is RefusalKind.DISARMED
    assert admission.decide(other, 10.3).kind is RefusalKind.DISARMED
    again_s = 10.3 + LEASE_S
    assert admission.decide(other._replace(received_s=again_s), again_s).kind is None


def test_sources_are_known_again_a_lease_after_the_last_forgotten_command() -> None:
    earlier, admission = EarlierCommands(), Admission("rover")
    for number in range(MAX_EARLIER + 1):
        earlier.note("rover", number, 10.0)
    now_s = 10.0 + LEASE_S
    admission.join(earlier.sources("rover", now_s), now_s)
    admission.connect(now_s)
    assert admission.decide(Command(PlanarVelocity(0.1), "script", 50, now_s), now_s).kind is None


def test_source_that_commanded_a_name_before_its_robot_existed_is_disarmed() -> None:
    earlier, admission = EarlierCommands(), Admission("rover")
    earlier.note("rover", "script", 10.0)
    admission.join(earlier.sources("rover", 10.2), 10.2)
    admission.connect(10.2)
    decision = admission.decide(Command(PlanarVelocity(0.1), "script", 50, 10.3), 10.3)
    assert decision.kind is RefusalKind.DISARMED
    assert admission.decide(Command(PlanarVelocity(0.1), "other", 50, 10.3), 10.3).kind is None


# -- freshness --------------------------------------------------------------------------------------------------------


def test_the_first_command_counts_as_the_quickest() -> None:
    assert Freshness().late_s(1e9, 5.0) == 0.0


def test_a_command_is_as_late_as_its_delay_exceeds_the_shortest() -> None:
    freshness = Freshness()
    freshness.late_s(100.0, 5.0)
    assert freshness.late_s(100.1, 5.7) == pytest.approx(0.6, abs=DRIFT)
    assert freshness.late_s(100.2, 5.2) == pytest.approx(0.0, abs=DRIFT)


def test_a_quicker_command_corrects_the_ones_after_it() -> None:
    freshness = Freshness()
    freshness.late_s(100.0, 5.4)
    assert freshness.late_s(100.1, 5.1) == 0.0
    assert freshness.late_s(100.2, 5.6) == pytest.approx(0.4, abs=DRIFT)


def test_a_route_that_became_slower_is_accepted_at_the_pace_of_a_drifting_clock() -> None:
    freshness = Freshness()
    freshness.late_s(0.0, 0.0)
    assert freshness.late_s(100.0, 101.0) == pytest.approx(1.0 - 101.0 * DRIFT)
    assert freshness.late_s(1000.0, 1001.0) == 0.0


@given(st.lists(st.tuples(st.floats(0, 1e6), st.floats(0, 10)), min_size=1, max_size=20))
def test_message_is_never_early(commands: list[tuple[float, float]]) -> None:
    freshness, now_s = Freshness(), 0.0
    for sent_s, wait_s in commands:
        now_s += wait_s
        assert freshness.late_s(sent_s, now_s) >= 0.0


@pytest.mark.parametrize("waited_s", [0.0, 3.0])
def test_zero_ends_the_hold_of_its_source(robot: Timeline, waited_s: float) -> None:
    robot.command(source="person", priority=100)
    robot.wait(0.1)
    assert robot.command(source="program").kind is RefusalKind.HELD
    robot.command(ZERO, source="person", priority=100, waited_s=waited_s)
    assert robot.command(source="program").is_admitted
    assert robot.driver() == "program"


def test_zero_of_one_topic_ends_no_hold_by_another_topic_of_the_robot(robot: Timeline) -> None:
    robot.command(source="person", priority=100, topic="cmd_vel")
    robot.command(source="person", priority=100, topic="arm_vel")
    robot.command(ZERO, source="person", priority=100, topic="arm_vel")
    assert robot.command(source="program", topic="arm_vel").kind is RefusalKind.HELD
    robot.command(ZERO, source="person", priority=100, topic="cmd_vel")
    assert robot.command(source="program", topic="arm_vel").is_admitted


def test_zeros_to_one_topic_arm_no_source_that_still_commands_another(robot: Timeline) -> None:
    """A gamepad may publish both: its arm at rest must not end what a stop of the base asks for."""
    assert robot.command(topic="base").is_admitted
    assert robot.command(ZERO, topic="arm").is_admitted
    robot.stop()
    for _ in range(9):
        robot.wait(LEASE_S - 0.1)
        assert robot.command(ZERO, topic="arm").is_admitted
        assert robot.command(topic="base").kind is RefusalKind.DISARMED
    assert robot.command(ZERO, topic="base").is_admitted
    assert robot.command(topic="base").is_admitted


def test_topic_that_a_source_commanded_long_before_a_stop_keeps_it_from_nothing(robot: Timeline) -> None:
    assert robot.command(topic="arm").is_admitted
    for _ in range(2):
        robot.wait(LEASE_S - 0.1)
        assert robot.command(topic="base").is_admitted
    robot.stop()
    assert robot.command(ZERO, topic="base").is_admitted
    assert robot.command(topic="base").is_admitted


def test_source_that_was_taken_over_and_stopped_is_disarmed_also_when_another_drives(taken: Timeline) -> None:
    taken.stop()
    assert taken.command(source="eve").is_admitted
    refusal = taken.command()
    assert (refusal.kind, refusal.holder) == (RefusalKind.DISARMED, None)


def test_source_that_was_taken_over_gives_its_record_to_no_other_in_a_crowd(taken: Timeline) -> None:
    for number in range(2, MAX_SOURCES):
        taken.command(source=f"{number}", priority=60, topic=f"{number}")
    assert taken.command(source="eve", priority=100).is_admitted  # with the record of bob
    assert taken.command().kind is RefusalKind.HELD
    assert taken.command(source="bob").kind is RefusalKind.CROWDED


def test_source_that_was_taken_over_lets_go_of_every_topic_before_it_takes_over(driven: Timeline) -> None:
    assert driven.command(topic="arm").is_admitted
    assert driven.command(source="bob", take_over=True).is_admitted
    assert driven.command(ZERO, topic="arm").is_admitted
    assert driven.command(take_over=True).kind is RefusalKind.HELD
    assert driven.command(ZERO).kind is RefusalKind.HELD
    assert driven.command(take_over=True).is_admitted


def test_first_velocity_after_a_zero_with_the_time_of_its_sending_may_be_late(robot: Timeline) -> None:
    robot.command(ZERO, sent_s=7.0)
    robot.wait(2.0)
    assert robot.command(sent_s=7.1).kind is RefusalKind.LATE
    assert robot.command(sent_s=9.0).is_admitted


def test_zeros_with_the_time_of_their_sending_leave_room_for_other_sources(robot: Timeline) -> None:
    for number in range(2 * MAX_SOURCES):
        robot.command(ZERO, source=f"client {number}", sent_s=7.0)
    assert robot.command().is_admitted
    assert not robot.command(ZERO, waited_s=1.0).kind


def test_admission_names_the_kind_of_its_drive() -> None:
    assert Timeline(drive=AckermannDrive()).admission.kinematics is Kinematics.ACKERMANN
    assert Timeline(drive=None).admission.kinematics is Kinematics.SPATIAL
