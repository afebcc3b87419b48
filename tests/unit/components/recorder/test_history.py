"""RobotHistory: a robot's last minutes from the black box."""

import math
import struct
from typing import Any

import msgspec
import pytest

from hostlink.components.recorder.channel import (
    DEVICE,
    EVENT,
    EVENTS,
    EVENTS_TOPIC,
    JSON,
    VELOCITY,
    Channel,
    as_text,
    ros_channel,
)
from hostlink.components.recorder.history import MAX_SAMPLES, RobotHistory
from hostlink.components.recorder.ring import Entry
from hostlink.core.messages.catalog import Catalog
from hostlink.core.robot.kinematics import Pose
from hostlink.core.robot.odometry import OdometryEstimator
from hostlink.core.robot.velocity import TWIST_TYPE

POSE_TYPE, TOPIC = "geometry_msgs/Pose2D", "/robot_0/odometry"
STEP_S = 0.1
POSE = Catalog().message(POSE_TYPE)


def channel(topic: str = TOPIC, type_name: str = POSE_TYPE) -> Channel:
    return ros_channel(topic, type_name, POSE, is_latched=False, origin=DEVICE)


def entries(*poses: tuple[float, float, float], of: Channel | None = None) -> list[Entry]:
    """Return one entry for each tenth of a second."""
    at = channel() if of is None else of
    return [Entry(at, 0, struct.pack("<3d", *pose), number * STEP_S) for number, pose in enumerate(poses, 1)]


def history(kept: list[Entry], odometry: tuple[str, str] | None = (TOPIC, POSE_TYPE)) -> RobotHistory:
    found = RobotHistory("robot_0", odometry=odometry)
    for entry in kept:
        found.add(entry)
    return found


def no_rest() -> None:
    """Do nothing."""


def shown(kept: list[Entry], present: Pose | None = None) -> list[Pose]:
    return [each.pose for each in history(kept).poses(OdometryEstimator(), present, no_rest)]


def test_poses_are_those_of_the_topic_in_their_order() -> None:
    others = entries((9.0, 9.0, 0.0), of=channel("/robot_1/odometry"))
    kept = entries((0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.02, 0.0, 0.0)) + others
    assert shown(kept) == [Pose(0.0), Pose(0.01), Pose(0.02)]
    assert shown(others) == []


def test_poses_end_where_the_robot_is_shown_now() -> None:
    """A restarted or reset device is shown in another frame than that of its poses."""
    found = shown(entries((0.0, 0.0, 0.0), (0.05, 0.0, 0.0)), Pose(2.0, 1.0, math.pi / 2))
    assert found[-1] == pytest.approx(Pose(2.0, 1.0, math.pi / 2))
    assert found[0] == pytest.approx(Pose(2.0, 0.95, math.pi / 2))


def test_restart_of_the_device_does_not_jump() -> None:
    moving = [(0.05 * number, 0.0, 0.0) for number in range(11)]
    found = shown(entries(*moving, (0.0, 0.0, 0.0), (0.05, 0.0, 0.0)))
    assert found[-1].x_m == pytest.approx(0.55)


def test_damaged_entries_are_omitted() -> None:
    kept = [*entries((0.0, 0.0, 0.0)), Entry(channel(), 0, b"short", 2 * STEP_S)]
    assert shown(kept) == [Pose()]


def event(kind: str, at_s: float, of: Channel = EVENTS) -> Entry:
    text = f'{{"kind": "{kind}"}}'.encode()
    return Entry(of, 0, text if of.encoding == JSON else as_text(text), at_s)


@pytest.mark.parametrize("of", [EVENTS, Channel(EVENTS_TOPIC, JSON, EVENT, "{}")])
def test_events_are_those_of_hostlink_without_single_commands_also_of_old_files(of: Channel) -> None:
    programs = ros_channel(EVENTS_TOPIC, "std_msgs/String", None, is_latched=False)
    kept = [event("locked", 1.0, of), event("commanded", 2.0, of), Entry(programs, 0, as_text(b'{"kind": "x"}'), 3.0)]
    kept += [Entry(of, 0, b"[]", 4.0), event("gone", 5.0, of)]
    assert history(kept).events(no_rest) == [(1.0, {"kind": "locked"}), (5.0, {"kind": "gone"})]


def link_event(kind: str, link: object, at_s: float, robot: str = "") -> Entry:
    text = msgspec.json.encode({"kind": kind, "robot": robot, "facts": {"link": link}})
    return Entry(EVENTS, 0, as_text(text), at_s)


def test_events_of_a_link_are_the_robots_only_by_the_number_of_its_link() -> None:
    """Every device of one computer has the same address."""
    opened = [link_event("link_opened", 1, 1.0), link_event("link_opened", 2, 2.0), link_event("link_opened", [], 3.0)]
    ended = [link_event("link_closed", 2, 5.0), link_event("link_closed", 1, 6.0)]
    found = history([*opened, link_event("appeared", 1, 4.0, "robot_0"), *ended]).events(no_rest)
    assert [(at_s, event["kind"]) for at_s, event in found] == [
        (1.0, "link_opened"),
        (4.0, "appeared"),
        (6.0, "link_closed"),
    ]


def test_end_of_a_link_is_the_robots_after_its_beginning_is_forgotten() -> None:
    ended = [link_event("gone", 1, 1.0, "robot_0"), link_event("link_closed", 1, 2.0)]
    assert [event["kind"] for _, event in history(ended).events(no_rest)] == ["gone", "link_closed"]


def test_more_entries_than_are_shown_are_not_decoded() -> None:
    twist = ros_channel("/cmd_vel", TWIST_TYPE, None, is_latched=False, origin=VELOCITY)
    decoded = []

    def decode(payload: bytes) -> dict[str, Any]:
        decoded.append(payload)
        return {"number": int(payload)}

    found = history([Entry(twist, 0, b"%d" % number, float(number)) for number in range(100_003)])
    commands = found.commands(decode, no_rest)
    assert len(decoded) <= MAX_SAMPLES
    assert len(commands) <= MAX_SAMPLES
    assert (commands[0][0], commands[-1]) == (pytest.approx(0, abs=50), (100_002.0, {"number": 100_002}))


def test_estimator_restarts_with_its_settings() -> None:
    used = OdometryEstimator(continues=False)
    used.update(Pose(1.0, 2.0, 0.0), now_s=0.0, wall_ns=0)
    moving = [(0.05 * number, 0.0, 0.0) for number in range(11)]
    again = history(entries(*moving, (0.0, 0.0, 0.0))).poses(used.anew(), None, no_rest)
    assert again[0].pose == Pose()
    assert again[-1].pose == Pose()  # starts again with the device


def test_odometry_of_a_file_is_the_devices_topic_of_that_name() -> None:
    aim, odometry, programs = (
        entries((x, 0.0, 0.0), of=ros_channel(topic, POSE_TYPE, POSE, is_latched=False, origin=origin))
        for x, topic, origin in ((1.0, "/robot_0/aim", DEVICE), (2.0, TOPIC, DEVICE), (3.0, "/a/odometry", "a program"))
    )
    found = history([*aim, *odometry, *programs], odometry=None)
    assert [each.pose.x_m for each in found.poses(OdometryEstimator(), None, no_rest)] == [2.0]
    assert history(programs, odometry=None).poses(OdometryEstimator(), None, no_rest) == []


def test_events_of_all_topics_together_are_bounded_and_the_last_one_is_shown() -> None:
    event = b'{"kind":"locked","robot":"robot_0"}'
    sources = (EVENTS, as_text(event)), (Channel("/of_a_file", JSON, EVENT, ""), event)
    kept = [
        Entry(of, 0, payload, number + 0.5 * half)
        for number in range(MAX_SAMPLES)
        for half, (of, payload) in enumerate(sources)
    ]
    times = [at_s for at_s, _ in history(kept).events(no_rest)]
    assert MAX_SAMPLES // 4 < len(times) <= MAX_SAMPLES
    assert times == sorted(times)
    assert times[-1] == MAX_SAMPLES - 0.5
