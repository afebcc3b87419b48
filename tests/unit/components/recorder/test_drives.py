"""Drives: their start, their end, and their bounds."""

from itertools import count

import pytest

from hostlink.components.recorder.drives import MAX_OPEN, PAUSE_NS, Drive, DriveFinder
from hostlink.core.robot.events import EventKind, RobotEvent
from hostlink.core.robot.velocity import ZERO, PlanarVelocity

S = 1_000_000_000


class Story:
    """Events in order, by the second."""

    def __init__(self) -> None:
        self.drives = DriveFinder()
        self.clock_ahead_s = 0.0  # of the wall clock, which may be set

    def command(self, at_s: float, owner: str = "ann", *, robot: str = "rover", m_s: float = 0.2) -> None:
        velocity = PlanarVelocity(x_m_s=m_s)
        facts = {"owner": owner, "address": f"10.0.0.{len(owner)}", "priority": 50, "velocity": velocity}
        self._note(EventKind.COMMANDED, at_s, robot, **facts, limited=velocity)

    def stop(self, at_s: float, owner: str = "ann", *, robot: str = "rover", reason: str = "no command came") -> None:
        self._note(EventKind.STOPPED, at_s, robot, reason=reason, owner=owner)

    def other(self, kind: EventKind, at_s: float, **facts: object) -> None:
        self._note(kind, at_s, "rover", **facts)

    def finished(self, at_s: float) -> list[Drive]:
        return self.drives.pop_finished(int(at_s * S))

    def _note(self, kind: EventKind, at_s: float, robot: str, **facts: object) -> None:
        self.drives.observe(RobotEvent(kind, robot, at_s, int((at_s + self.clock_ahead_s) * S), facts))


def test_drive_lasts_from_its_first_command_to_its_stop() -> None:
    story = Story()
    for tenth in range(20):
        story.command(10 + tenth / 10, m_s=0.1 + tenth / 100)
    story.stop(12.4)
    assert story.finished(12.4 + PAUSE_NS / S - 0.1) == []
    (drive,) = story.finished(12.4 + PAUSE_NS / S)
    assert (drive.robot, drive.owner, drive.priority, drive.commands) == ("rover", "ann", 50, 20)
    assert drive.address == "10.0.0.3"
    assert (drive.began_ns, drive.ended_ns) == (10 * S, int(12.4 * S))
    assert drive.fastest_m_s == pytest.approx(0.29)
    assert drive.end == "no command came"
    assert len(story.drives) == 0


@pytest.mark.parametrize("step_s", [8_640_000.0, -8_640_000.0])
def test_drive_in_which_the_clock_is_set_lasts_as_long_as_it_took(step_s: float) -> None:
    story = Story()
    story.command(10.0)
    story.clock_ahead_s = step_s
    story.command(20.0)
    story.stop(22.5)
    (drive,) = story.drives.under_way()
    assert drive.seconds == 12.5


def test_short_pause_does_not_end_a_drive() -> None:
    story = Story()
    for at_s in (0.0, 2.0, 4.0):
        story.command(at_s)
        story.stop(at_s + 0.5)
        assert story.finished(at_s + 1.0) == []
    (drive,) = story.finished(10.0)
    assert (drive.began_ns, drive.ended_ns, drive.commands) == (0, int(4.5 * S), 3)


def test_zero_starts_no_drive() -> None:
    story = Story()
    story.command(1.0, m_s=0.0)
    assert len(story.drives) == 0


@pytest.mark.parametrize(
    ("kind", "facts", "end"),
    [
        (EventKind.LOCKED, {"reason": "smoke"}, "locked: smoke"),
        (EventKind.GONE, {"was_moving": True}, "its device disconnected"),
    ],
)
def test_lock_disconnect_and_takeover_end_a_drive(kind: EventKind, facts: dict[str, object], end: str) -> None:
    story = Story()
    story.command(1.0)
    story.command(1.0, robot="other")
    story.other(kind, 1.2, **facts)
    assert [(each.robot, each.end) for each in story.finished(9.0)] == [("rover", end)]


def test_returning_driver_takes_the_robot_over_again() -> None:
    story = Story()
    for at_s, owner in ((1.0, "ann"), (1.1, "bob"), (1.2, "bob"), (1.3, "ann"), (1.4, "ann")):
        story.command(at_s, owner)
    assert {each.owner: each.end for each in story.drives.under_way()} == {"ann": "", "bob": "taken over by ann"}


def test_robot_that_is_taken_over_has_two_drives() -> None:
    story = Story()
    story.command(1.0, "ann")
    story.command(1.1, "bob")
    story.stop(2.0, "bob")
    assert [(each.owner, each.end) for each in story.finished(9.0)] == [
        ("ann", "taken over by bob"),
        ("bob", "no command came"),
    ]


def test_stop_of_another_owner_ends_no_drive() -> None:
    story = Story()
    story.command(1.0)
    story.stop(1.1, "bob")
    assert story.finished(99.0) == []


def test_drives_that_never_end_are_bounded() -> None:
    story = Story()
    for number in range(MAX_OPEN + 5):
        story.command(number / 100, f"client {number}", robot=f"robot_{number}")
    assert [each.owner for each in story.finished(60.0)] == [f"client {number}" for number in range(5)]
    assert len(story.drives) == MAX_OPEN


def test_clock_set_back_does_not_keep_drives_open() -> None:
    story = Story()
    story.command(1000.0)
    story.stop(1001.0)
    assert len(story.finished(0.0)) == 1


def test_current_drive_is_listed() -> None:
    story = Story()
    numbers = count(1)
    for at_s in range(5):
        story.command(at_s)
        (drive,) = story.drives.under_way()
        assert (drive.commands, drive.end) == (next(numbers), "")


def test_zero_of_the_driver_is_part_of_its_drive() -> None:
    story = Story()
    story.command(1.0)
    story.other(EventKind.COMMANDED, 1.1, owner="ann", address="", priority=50, velocity=ZERO, limited=ZERO)
    story.stop(1.5)
    (drive,) = story.finished(9.0)
    assert (drive.commands, drive.ended_ns) == (1, int(1.5 * S))
