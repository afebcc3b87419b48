"""Playback: when each message is due, and the robots of a recording."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.recorder.channel import CDR, DEVICE, EVENTS, HOSTLINK, VELOCITY, Channel, ros_channel
from hostlink.components.recorder.playing import DueVelocity, NewestDue, drives, robots_of, schedule
from hostlink.components.recorder.reader import StoredMessage
from hostlink.core.robot.velocity import TWIST_TYPE, ZERO, PlanarVelocity, Twist
from hostlink.errors import BadPayload

SECOND_NS = 1_000_000_000


def at(*seconds: float) -> list[StoredMessage]:
    return [StoredMessage(EVENTS, 0, b"", int(each * SECOND_NS)) for each in seconds]


def due(*seconds: float, rate: float = 1.0, start_s: float = 0.0) -> list[float]:
    return [each.at_s for each in schedule(at(*seconds), rate=rate, start_s=start_s)]


def channel(robot: str, topic: str, origin: str) -> Channel:
    return ros_channel(topic, "std_msgs/String", None, is_latched=False, robot=robot, origin=origin)


def test_intervals_are_kept_from_the_first_message_on() -> None:
    assert due(100, 101, 103) == [0, 1, 3]
    assert due(100, 101, 103, rate=2) == [0, 0.5, 1.5]
    assert due(100, 101, 103, start_s=1) == [0, 2]
    assert due() == []


def test_clock_set_back_loses_no_interval_and_no_message() -> None:
    assert due(100, 101, 50, 51, 52) == [0, 1, 1, 2, 3]


@given(st.lists(st.integers(0, 10**6), max_size=50), st.floats(0.1, 10))
def test_every_message_is_due_in_order(seconds: list[int], rate: float) -> None:
    found = due(*seconds, rate=rate)
    assert len(found) == len(seconds)
    assert found == sorted(found)


def test_robot_has_what_its_device_published_and_its_velocities() -> None:
    odometry, velocity = channel("a", "/a/odometry", DEVICE), channel("a", "/a/velocity", VELOCITY)
    others = [channel("a", "/a/odom", HOSTLINK), channel("", "/chat", ""), channel("b", "/b/cmd_vel", VELOCITY), EVENTS]
    assert robots_of([odometry, *others, velocity]) == {"a": [odometry, velocity]}


def test_cdr_is_not_played_because_a_played_device_sends_as_ros_1() -> None:
    odometry = channel("a", "/a/odometry", DEVICE)
    raw = ros_channel("/a/own", "my_msgs/Own", None, is_latched=False, robot="a", origin=DEVICE, encoding=CDR)
    assert robots_of([odometry, raw]) == {"a": [odometry]}
    assert robots_of([raw]) == {}


def test_topic_recorded_twice_is_one_channel() -> None:
    latched = ros_channel("/a/odometry", "std_msgs/String", None, is_latched=True, robot="a", origin=DEVICE)
    assert robots_of([channel("a", "/a/odometry", DEVICE), latched]) == {"a": [latched]}


def test_robot_is_driven_as_the_chosen_one_of_two_that_had_the_same_topic() -> None:
    forward, back = PlanarVelocity(0.2, 0.1, 0.3), PlanarVelocity(x_m_s=-0.2)
    mine, others = (
        ros_channel("/cmd_vel", TWIST_TYPE, None, is_latched=False, robot=name, origin=VELOCITY) for name in ("a", "b")
    )
    stored = [
        StoredMessage(of, 0, velocity.encode(), int(at_s * SECOND_NS))
        for at_s, of, velocity in ((0.0, mine, forward), (0.25, mine, ZERO), (4.0, others, back))
    ]
    found = [(each.at_s, each.velocity) for each in drives(schedule(stored), "a", "/cmd_vel")]
    assert found == [(0.0, forward), (0.25, ZERO)]


def test_velocity_with_components_that_no_robot_has_is_refused() -> None:
    velocity = ros_channel("/cmd_vel", TWIST_TYPE, None, is_latched=False, robot="a", origin=VELOCITY)
    stored = [StoredMessage(velocity, 0, Twist(0.2, angular_x_rad_s=0.1).encode(), 0)]
    with pytest.raises(BadPayload, match="a robot moves in the plane"):
        list(drives(schedule(stored), "a", "/cmd_vel"))


@given(
    st.lists(st.tuples(st.sampled_from([0.0, 0.0, 0.05, 0.3, 2.0]), st.sampled_from([0.0, 0.2, -0.2])), max_size=40),
    st.sampled_from([0.0, 0.01, 0.4]),
)
def test_overdue_velocity_is_replaced_by_a_newer_one_and_no_zero_is_left_out(
    recorded: list[tuple[float, float]], answer_s: float
) -> None:
    """`recorded`: pauses and speeds. Each sent velocity is answered after `answer_s`."""
    at_s, wanted = 0.0, list[DueVelocity]()
    for pause_s, speed_m_s in recorded:
        at_s += pause_s
        wanted.append(DueVelocity(at_s, PlanarVelocity(speed_m_s)))
    clock, newest, sent = [0.0], NewestDue(), list[DueVelocity]()
    for due in newest.of(wanted, lambda: clock[0]):
        now_s = max(clock[0], due.at_s)
        position = next(number for number, each in enumerate(wanted) if each is due)
        assert due.velocity.is_zero or all(each.at_s >= now_s for each in wanted[position + 1 :])
        sent.append(due)
        clock[0] = now_s + answer_s
    assert len(sent) + newest.left_out == len(wanted)
    assert [each for each in sent if each.velocity.is_zero] == [each for each in wanted if each.velocity.is_zero]
    assert not wanted or sent[-1] is wanted[-1]
