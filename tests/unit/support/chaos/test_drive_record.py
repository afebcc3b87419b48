"""Given a record of events, does DriveRecord flag what it must, and nothing else?"""

from typing import Any

import pytest

from tests.support.chaos.drive_record import HONEST_RAD_S, STEP_M_S, DriveRecord, percentile
from tests.support.chaos.limits import Limits
from tests.support.chaos.noise import Noise

LIMITS = Limits()
ZERO = (0.0, 0.0)
UNOWNED = (0.3, -0.75)
INTERVAL_S = 0.03
OLD = "no velocity is obeyed after its lease"
HANGS = "a daemon that hangs leaves no robot moving"


def honest(number: int) -> tuple[float, float]:
    return number * STEP_M_S, HONEST_RAD_S


class Story:
    """Events in the order of their times."""

    def __init__(self, noise: Noise | None = None) -> None:
        self.record = DriveRecord(LIMITS, noise or Noise(stretch_most=3.0))
        self.now_s = 100.0
        self._number = 0
        self.event("opened")
        self.velocity(ZERO)

    def event(self, kind: str, *facts: Any) -> None:
        self.record.add([kind, self.now_s, *facts])

    def velocity(self, velocity: tuple[float, float]) -> None:
        self.event("velocity", *velocity)

    def drive(self, count: int = 100, latency_s: float = 0.001) -> None:
        """So many commands, each of which arrives."""
        self.event("began", "topic")
        for _ in range(count):
            self._number += 1
            self.event("sent", self._number)
            self.now_s += latency_s
            self.velocity(honest(self._number))
            self.now_s += INTERVAL_S - min(latency_s, INTERVAL_S)

    def after(self, seconds: float) -> "Story":
        self.now_s += seconds
        return self

    def found(self) -> list[str]:
        return [violation.promise for violation in self.record.check(self.now_s)]


def test_a_drive_that_ends_well_has_no_violation() -> None:
    story = Story()
    story.drive()
    story.event("ended", "lease")
    story.after(0.55).velocity(ZERO)
    assert story.after(1.0).found() == []
    assert story.record.zeros_s == [pytest.approx(0.55)]
    assert story.record.latest_p99_s == pytest.approx(0.001)


@pytest.mark.parametrize("how", ["lease", "drop", "reset", "stop"])
def test_late_zero_is_found(how: str) -> None:
    story = Story()
    story.drive()
    story.event("ended", how)
    story.after(0.7).velocity(ZERO)
    (violation,) = story.record.check(story.after(1.0).now_s)
    assert violation.promise == "zero after the driver's end"
    assert violation.figure == pytest.approx(0.7)
    assert how in violation.detail


def test_missing_zero_is_found_before_the_next_drive_and_by_it() -> None:
    story = Story()
    story.drive()
    story.event("ended", "drop")
    assert story.after(0.5).found() == []
    assert story.after(0.2).found() == ["zero after the driver's end"]
    other = Story()
    other.drive()
    other.event("ended", "drop")
    other.after(0.9).event("began", "topic")
    assert other.found() == ["zero after the driver's end"]


def test_a_velocity_after_the_zero_moves_the_robot_again() -> None:
    story = Story()
    story.drive()
    story.event("ended", "drop")
    story.after(0.01).velocity(ZERO)
    story.after(0.7).velocity(honest(7))
    assert story.found() == [OLD, "zero after the driver's end"]


def test_a_velocity_after_the_end_was_judged_is_found() -> None:
    story = Story()
    story.drive()
    story.event("ended", "drop")
    story.after(0.01).velocity(ZERO)
    assert story.after(0.7).found() == []
    story.after(0.1).velocity(honest(7))
    assert story.found() == [OLD, "no velocity after the driver's end"]


def test_a_robot_that_stood_at_the_end_needs_no_other_zero() -> None:
    story = Story()
    story.drive()
    story.velocity(ZERO)
    story.event("ended", "lease")
    assert story.after(2.0).found() == []


def test_foreign_velocity_is_found_where_no_rival_may_drive() -> None:
    story = Story()
    story.velocity(UNOWNED)
    assert story.found() == ["only who may drive drives"]


def test_foreign_velocities_are_one_violation_a_second() -> None:
    story = Story()
    for _ in range(15):
        story.after(0.1).velocity(UNOWNED)
    assert story.found() == ["only who may drive drives"] * 2


def test_foreign_velocity_is_allowed_while_the_honest_program_does_not_drive() -> None:
    story = Story()
    story.record.rival_began(1, story.now_s)
    story.after(0.1).velocity(UNOWNED)
    story.record.rival_ended(1, story.now_s)
    story.after(0.5).velocity(UNOWNED)
    assert story.found() == []
    story.after(1.5).velocity(UNOWNED)
    assert story.found() == ["only who may drive drives"]


def test_a_lower_priority_that_drives_over_the_honest_program_is_found() -> None:
    story = Story()
    story.record.rival_began(1, story.now_s)
    story.drive()
    story.velocity(ZERO)  # the rival's stop
    story.after(0.01).velocity(UNOWNED)
    assert story.found() == ["nobody drives over a higher priority"]


def test_driver_after_the_end_does_not_hide_ineffective_honest_commands() -> None:
    story = Story()
    story.record.rival_began(1, story.now_s)
    story.drive()
    story.event("ended", "drop")
    story.after(0.02).velocity(UNOWNED)
    assert story.after(1.0).found() == []
    assert story.record.zeros_s == [pytest.approx(0.02)]


def test_late_commands_are_found() -> None:
    story = Story()
    story.drive(count=97)
    story.drive(count=3, latency_s=0.15)
    assert story.found() == ["command p99"]
    assert story.record.latest_p99_s == pytest.approx(0.15)


def test_a_command_that_a_newer_one_replaced_is_as_late_as_the_newer_one() -> None:
    """A daemon that pauses and then sends the newest command must not look quick."""
    story = Story()
    story.drive(count=90)
    for number in range(201, 211):
        story.event("sent", number)
        story.after(INTERVAL_S)
    story.velocity(honest(210))
    assert story.found() == ["command p99"]
    assert story.record.latest_p99_s == pytest.approx(10 * INTERVAL_S, abs=INTERVAL_S)


def test_commands_that_nothing_answers_count_while_they_wait() -> None:
    story = Story()
    story.drive(count=60)
    for number in range(201, 221):
        story.event("sent", number)
    assert story.after(0.2).found() == []
    assert story.after(0.3).found() == ["command p99"]


def test_commands_to_a_robot_that_is_away_are_not_late() -> None:
    story = Story()
    story.drive(count=60)
    story.event("closed", True)
    for number in range(201, 221):
        story.event("sent", number)
    assert story.after(0.5).found() == []


def test_the_harness_and_a_busy_machine_are_forgiven_as_far_as_they_were_measured() -> None:
    noise = Noise(stretch_most=3.0)
    story = Story(noise)
    noise.add_turn(story.now_s, 0.0, 0.0)
    story.drive(latency_s=0.15)
    noise.add_turn(story.now_s, 1.0, 1.0)
    assert story.found() == []
    late = Story()
    late.drive()
    late.event("ended", "drop")
    late.after(0.3).event("lag", 0.2)
    late.after(0.4).velocity(ZERO)
    assert late.after(1.0).found() == []


def test_the_latency_of_commands_without_hostile_clients_is_forgiven() -> None:
    story = Story()
    story.record.baseline_s = 0.1
    story.drive(latency_s=0.15)
    assert story.found() == []


def test_a_link_that_the_daemon_ends_is_found_and_one_that_the_robot_ends_is_not() -> None:
    story = Story()
    story.event("closed", True)
    assert story.found() == []
    story.event("opened")
    story.velocity(ZERO)
    story.event("closed", False)
    assert story.found() == ["the honest robot keeps its link"]


def test_a_new_connection_receives_zero_first_and_soon() -> None:
    story = Story()
    story.event("closed", True)
    story.event("opened")
    story.velocity(honest(5))
    assert story.found() == ["the first velocity of a connection is zero"]
    story.event("closed", True)
    story.event("opened")
    assert story.after(LIMITS.reconnect_s + 1).found() == ["the honest robot is served again"]


def test_a_question_of_the_robots_is_answered_in_time() -> None:
    story = Story()
    story.event("requested", "time request")
    story.after(0.5).event("answered", "time request")
    assert story.found() == []
    story.event("requested", "time request")
    assert story.after(1.5).found() == ["the honest robot's time request is answered"]
    assert story.after(1.5).found() == []  # once
    story.event("requested", "parameter request")
    story.after(1.5).event("answered", "parameter request")
    assert story.found() == ["the honest robot's parameter request is answered"]


def test_a_program_that_cannot_connect_is_found() -> None:
    story = Story()
    story.event("refused", "no answer")
    assert story.found() == ["the honest program is served"]


def test_the_last_velocity_outlives_its_connection() -> None:
    story = Story()
    story.drive(count=1)
    story.event("closed", False)
    assert story.record.velocity_before_close == honest(1)


def test_percentile_is_a_value_that_was_there() -> None:
    assert percentile([float(value) for value in range(1, 101)], 0.99) == 99.0
    assert percentile([3.0], 0.99) == 3.0
    assert percentile([2.0, 1.0], 0.5) == 1.0


def test_a_connection_that_received_no_velocity_does_not_hide_the_one_before() -> None:
    story = Story()
    story.event("closed", False)
    story.event("opened")
    story.event("closed", False)
    assert story.record.velocity_before_close == ZERO


def test_drive_record_with_a_velocity_older_than_its_lease_finds_it_once_a_second() -> None:
    story = Story()
    story.drive(count=1)
    story.after(0.55).velocity(honest(1))
    assert story.found() == []
    story.after(0.1).velocity(honest(1))
    story.after(0.1).velocity(honest(1))
    assert story.found() == [OLD]
    assert story.record.oldest_s == pytest.approx(0.78, abs=0.01)


def test_drive_record_with_a_daemon_that_hangs_expects_the_guardians_zero() -> None:
    for seconds, has_zero, found in ((1.0, False, []), (2.0, True, []), (2.0, False, [HANGS])):
        noise = Noise(stretch_most=3.0)
        story = Story(noise)
        story.drive()
        noise.pause(story.now_s)
        story.record.daemon_paused(story.now_s)
        if has_zero:
            story.velocity(ZERO)
        story.record.daemon_resumed(story.after(seconds).now_s)
        assert [each for each in story.found() if each != "command p99"] == found


def test_drive_record_with_a_restart_excuses_its_links_and_expects_a_zero() -> None:
    story = Story()
    story.drive()
    story.record.daemon_left(story.now_s, "SIGKILL")
    story.after(0.1).velocity(ZERO)
    story.event("closed", False)
    story.event("refused", "nobody listens")
    story.record.daemon_came(story.after(1.0).now_s)
    assert story.found() == []
    story.after(3.0).event("opened")
    story.velocity(ZERO)
    story.event("closed", False)
    assert story.found() == ["the honest robot keeps its link"]


def test_drive_record_with_a_restart_that_leaves_the_robot_moving_finds_it() -> None:
    story = Story()
    story.drive()
    story.record.daemon_left(story.now_s, "SIGTERM")
    story.after(0.1).event("closed", False)
    assert story.found() == ["the last velocity of a daemon is zero"]


def test_a_command_is_as_late_as_the_daemon_made_it_also_beside_a_pause() -> None:
    """The time of a pause excuses the commands that waited through it, and no others."""
    noise = Noise(stretch_most=3.0)
    story = Story(noise)
    noise.pause(story.now_s, story.now_s + 0.9)
    story.drive(count=3, latency_s=0.3)
    assert story.after(1.0).found() == []
    story.drive(count=100, latency_s=0.15)
    assert story.found() == ["command p99"]
