"""MotionMonitor: flaws of the last half minute, and an odometry that contradicts the command."""

import pytest

from hostlink.core.diagnosis.motion_monitor import NO_MOTION, OPPOSITE_S, RECENT_S, STILL_S, MotionMonitor, Speed
from hostlink.core.diagnosis.rules import diagnose
from hostlink.core.protocol.link_evidence import Tally
from tests.unit.core.diagnosis.test_rules import HEALTHY, replace

FORWARD = Speed(0.3, 0.0)


def monitored(flaws: tuple[str, ...] = (), count: int = 10, **facts: object) -> MotionMonitor:
    monitor = MotionMonitor()
    monitor.topic = "/odom"
    for number in range(count):
        monitor.observe(flaws, number * 0.1, **facts)  # type: ignore[arg-type]
    return monitor


def found(monitor: MotionMonitor, now_s: float = 1.0, **facts: object) -> dict[str, str]:
    evidence = replace(HEALTHY, motion=monitor.evidence(now_s), **facts)
    return {each.code: each.detail for each in diagnose(evidence)}


@pytest.mark.parametrize(
    ("flaw", "code", "detail"),
    [
        ("not_finite", "bad_pose", "10 poses with NaN or infinity of 10 messages on /odom"),
        ("too_far", "bad_pose", "10 poses farther than 1000 km away of 10 messages on /odom"),
        ("zero_quaternion", "bad_quaternion", "10 orientations that are four zeros of 10 messages on /odom"),
        ("bad_quaternion", "bad_quaternion", "10 orientations of a length far from 1 of 10 messages on /odom"),
        (
            "heading_in_z",
            "heading_in_z",
            "10 orientations of which only z is set, to a heading of 10 messages on /odom",
        ),
        ("sent_back", "pose_sent_back", "10 poses that it was given of 10 messages on /odom"),
        ("zero_stamp", "bad_stamp", "10 stamps of 0 of 10 messages on /odom"),
        ("slash_frame", "slash_frame", '"/odom"; 10 frames with a slash of 10 messages on /odom'),
        ("zero_covariance", "zero_covariance", "10 covariances of zeros of 10 messages on /odom"),
    ],
)
def test_flaw_of_most_messages_is_a_finding_until_they_are_old(flaw: str, code: str, detail: str) -> None:
    monitor = monitored((flaw,), frame_id="/odom")
    assert found(monitor) == {code: detail}
    monitor.sample(1.0)
    assert found(monitor, 1.0 + RECENT_S / 2) == {code: detail}
    monitor.sample(1.0 + RECENT_S)
    assert found(monitor, 2.0 + RECENT_S) == {}


def test_bad_poses_of_two_kinds_are_one_finding() -> None:
    monitor = monitored(("not_finite",), 2)
    for number in range(2):
        monitor.observe(("too_far",), 0.2 + number * 0.1)
    detail = "2 poses with NaN or infinity, 2 poses farther than 1000 km away of 4 messages on /odom"
    assert found(monitor) == {"bad_pose": detail}


@pytest.mark.parametrize(
    "flaw", ["not_finite", "too_far", "zero_quaternion", "heading_in_z", "sent_back", "zero_stamp", "zero_covariance"]
)
def test_flaw_of_two_messages_is_not_a_finding(flaw: str) -> None:
    monitor = monitored((flaw,), 2)
    for number in range(20):
        monitor.observe((), 0.2 + number * 0.1)
    assert found(monitor, 3.0) == {}


def test_stamps_of_zero_before_the_first_time_answer_are_not_a_finding() -> None:
    monitor = monitored(("zero_stamp",), 20)
    for number in range(30):
        monitor.observe((), 2.0 + number * 0.1)
    assert found(monitor, 5.0) == {}


def test_poses_that_are_missing_are_named_with_their_counts_for_half_a_minute() -> None:
    monitor = monitored(("not_finite", "zero_stamp"), 3)
    monitor.observe(("zero_quaternion",), 0.5)
    monitor.sample(1.0)
    text = "3 poses with NaN or infinity, 1 orientations that are four zeros"
    assert monitor.evidence(1.0).without_pose == text
    monitor.sample(0.9 + RECENT_S)
    assert monitor.evidence(0.9 + RECENT_S).without_pose == text
    monitor.sample(1.0 + RECENT_S)
    assert monitor.evidence(1.0 + RECENT_S).without_pose == ""
    assert monitored(("zero_stamp",)).evidence(1.0).without_pose == ""


def test_heading_in_z_that_passes_zero_is_one_finding() -> None:
    monitor = monitored(("zero_quaternion",), 10)
    for _ in range(5):
        monitor.observe(("heading_in_z",), 1.0)
    assert list(found(monitor)) == ["heading_in_z"]


def test_leaps_are_a_finding_from_the_second_on() -> None:
    monitor = monitored((), 8)
    monitor.observe((), 0.8, is_jump=True)
    assert found(monitor) == {}
    monitor.observe((), 0.9, is_jump=True)
    assert found(monitor) == {"odometry_jumps": "2 leaps of 10 messages on /odom"}


def test_odometry_that_is_announced_and_never_sent_is_a_finding() -> None:
    monitor = monitored((), 0)
    assert found(monitor, negotiated_s=14.9) == {}
    assert found(monitor, negotiated_s=16.0) == {"odometry_unsent": "nothing on /odom for 16 s"}
    assert "odometry_unsent" not in found(monitor, negotiated_s=16.0, silent_s=9.0)
    monitor.observe((), 1.0)
    assert found(monitor, negotiated_s=16.0) == {}
    assert diagnose(replace(HEALTHY, motion=NO_MOTION)) == []


def test_stamps_of_another_clock_are_told_from_a_clock_that_is_wrong() -> None:
    assert found(monitored(), stamps_behind_s=1.7e9) == {"bad_stamp": "its stamps are 19676 days behind"}
    assert list(found(monitored(), stamps_behind_s=-7200.0)) == ["clock_trouble"]


def driven(commanded: Speed, measured: Speed, seconds: float) -> MotionMonitor:
    monitor = monitored()
    for number in range(round(seconds * 10) + 1):
        monitor.compare(commanded, measured, number * 0.1)
    return monitor


@pytest.mark.parametrize(
    ("commanded", "measured", "wait_s", "kind"),
    [
        (FORWARD, Speed(-0.3, 0.0), OPPOSITE_S, "the odometry runs backwards"),
        (Speed(0.0, 1.0), Speed(0.0, -0.9), OPPOSITE_S, "the odometry runs the other way round"),
        (FORWARD, Speed(30.0, 0.0), OPPOSITE_S, "the odometry is too fast"),
        (FORWARD, Speed(0.0, 0.0), STILL_S, "the odometry does not change"),
    ],
)
def test_odometry_that_contradicts_the_command_for_seconds_is_a_finding(
    commanded: Speed, measured: Speed, wait_s: float, kind: str
) -> None:
    assert found(driven(commanded, measured, wait_s - 0.3)) == {}
    detail = found(driven(commanded, measured, wait_s + 0.3), wait_s)["odometry_disagrees"]
    assert detail.startswith(f"{kind}: commanded ")


@pytest.mark.parametrize(
    ("commanded", "measured"),
    [
        (FORWARD, Speed(0.3, 0.0)),
        (FORWARD, Speed(0.12, 0.1)),
        (FORWARD, Speed(-0.05, 0.0)),
        (Speed(0.05, 0.1), Speed()),
        (Speed(), Speed(0.3, 0.0)),
        (Speed(0.3, 0.5), Speed(0.3, -0.1)),
    ],
)
def test_robot_that_follows_its_command_roughly_has_no_finding(commanded: Speed, measured: Speed) -> None:
    assert found(driven(commanded, measured, 20.0), 20.0) == {}


def test_commands_that_change_are_not_judged() -> None:
    monitor = monitored()
    for number in range(200):
        sign = 1 if number // 10 % 2 else -1
        monitor.compare(Speed(0.3 * sign, 0.0), Speed(-0.3 * sign, 0.0), number * 0.1)
    assert found(monitor, 20.0) == {}


def with_line(bytes_s: float, *, baud: int | None = 38400, age_s: float = 60.0) -> dict[str, str]:
    recent = Tally(bytes_from_device=round(30 * bytes_s), frames=100)
    return found(monitored((), 150), recent=recent, baud=baud, age_s=age_s)


def test_line_without_room_is_a_finding_with_the_rate_of_the_odometry() -> None:
    detail = "3744 of 3840 bytes/s at 38400 baud; /odom has 5.0 messages/s"
    assert with_line(3744.0) == {"line_full": detail}


@pytest.mark.parametrize(
    ("bytes_s", "baud", "age_s"), [(3500.0, 38400, 60.0), (3744.0, None, 60.0), (3744.0, 38400, 20.0)]
)
def test_line_with_room_or_of_unknown_rate_has_no_finding(bytes_s: float, baud: int | None, age_s: float) -> None:
    assert with_line(bytes_s, baud=baud, age_s=age_s) == {}


def test_usb_port_that_is_faster_than_its_baud_rate_has_no_finding() -> None:
    assert with_line(9000.0) == {}


def test_command_is_compared_four_times_a_second_and_when_it_changes() -> None:
    monitor = MotionMonitor()
    assert monitor.is_due(FORWARD, 0.0)
    monitor.compare(FORWARD, FORWARD, 0.0)
    assert not monitor.is_due(FORWARD, 0.1)
    assert monitor.is_due(Speed(-0.3, 0.0), 0.1)
    assert monitor.is_due(FORWARD, 0.25)
