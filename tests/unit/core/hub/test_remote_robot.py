"""Robot of another daemon: its velocity topics here, its connections and epochs there, and what is not known of it."""

import asyncio

import msgspec
import pytest

from hostlink.core.hub import remote_robots as remote_robots_module
from hostlink.core.hub.topic import DeviceSubscription
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.robot.feedback import FeedbackKind
from hostlink.core.robot.kinematics import Pose
from hostlink.core.robot.odometry import OdometrySnapshot
from hostlink.core.robot.state import RobotState
from hostlink.core.robot.velocity import TWIST_TYPE, ZERO, PlanarVelocity
from hostlink.errors import BadRequest, DeviceGone
from tests.support.gates import drive_gate
from tests.support.hosts import host_in
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.participants import publish
from tests.support.remote_robots import RecordingHosts, connected_robot, remote_robot
from tests.support.virtual_loop import inside

TOPIC = "/robot_7/cmd_vel"
SLOW = PlanarVelocity(0.1)
SNAPSHOT = OdometrySnapshot(
    pose=Pose(1.0), twist=ZERO, age_s=0.2, rate_hz=10.0, count=3, restarts=0, ignored=0, stamp_ns=5
)


def speeds(hosts: RecordingHosts) -> list[float]:
    return [sent[1].x_m_s for sent in hosts.sent if sent[0] == "drive"]


def move(made: MemoryHub, speed_m_s: float = 0.1) -> None:
    publish(made.hub, TOPIC, {"linear": {"x": speed_m_s}}, source="by topic")


@inside(in_hub)
async def test_velocity_published_here_is_sent_to_the_robots_daemon_while_it_offers_the_topic(made: MemoryHub) -> None:
    hosts = RecordingHosts()
    robot = connected_robot(made.hub, "robot_7", hosts)
    move(made)
    assert speeds(hosts) == [0.1]
    topic = made.hub.topics.find(TOPIC)
    assert (topic.type_name, topic.is_gated) == (TWIST_TYPE, True)
    robot.offer([(TOPIC, TWIST_TYPE)])
    assert len(topic.devices) == 1
    robot.offer([("/robot_7/other", TWIST_TYPE)])
    assert made.hub.topics.find_or_none(TOPIC) is None or not made.hub.topics.find(TOPIC).devices
    robot.leave()
    assert made.hub.topics.find_or_none("/robot_7/other") is None


@inside(in_hub)
async def test_robot_that_is_driven_from_here_may_move_for_a_lease(made: MemoryHub) -> None:
    connected_robot(made.hub, "robot_7", RecordingHosts())
    now_s = asyncio.get_running_loop().time
    assert not made.hub.robots.may_move(now_s())
    move(made)
    assert made.hub.robots.may_move(now_s() + LEASE_S - 0.01)
    assert not made.hub.robots.may_move(now_s() + LEASE_S)


@inside(in_hub)
async def test_topic_of_a_device_here_and_of_a_robot_there_drives_neither_robot_there(made: MemoryHub) -> None:
    hosts = RecordingHosts()
    connected_robot(made.hub, "robot_7", hosts)
    made.hub.topics.subscribe_device(
        TOPIC, "device here", DeviceSubscription(lambda _: None, is_gate=True), type_name=TWIST_TYPE
    )
    with pytest.raises(DeviceGone, match="is a topic here and at other"):
        move(made)
    assert hosts.sent == []
    made.hub.topics.unsubscribe_device(TOPIC, "device here")
    move(made)
    assert speeds(hosts) == [0.1]


@inside(in_hub)
async def test_topic_of_another_type_is_refused_and_logged_and_the_others_are_offered(made: MemoryHub) -> None:
    robot = remote_robot(made.hub, "robot_7", RecordingHosts())
    made.hub.join("program").advertise("/robot_7/taken", "std_msgs/Bool")
    robot.offer([("/robot_7/taken", TWIST_TYPE), (TOPIC, TWIST_TYPE)])
    assert [each["topic"] for each in made.logged("topic.refused")] == ["/robot_7/taken"]
    assert made.hub.topics.find(TOPIC).devices
    robot.leave()


@inside(in_hub)
async def test_reconnection_with_the_same_epoch_resumes_and_with_another_one_interrupts(made: MemoryHub) -> None:
    robot = remote_robot(made.hub, "robot_7", RecordingHosts())
    robot.connect(12, 100)
    first = robot.link.number
    assert (robot.link.own_number, robot.resumed_link) == (12, first)
    epoch = robot.admission.epoch
    robot.connect(12, 100)
    assert robot.link.number == first
    robot.connect(None, None)
    assert robot.link is None
    robot.connect(13, 100)
    assert robot.admission.epoch == epoch
    robot.connect(14, 99)  # the other daemon may have restarted
    assert robot.admission.epoch > epoch
    assert robot.link.number > first


@inside(in_hub)
async def test_state_older_than_an_answer_interrupts_nothing(made: MemoryHub) -> None:
    robot = remote_robot(made.hub, "robot_7", RecordingHosts())
    robot.connect(12, 100)
    robot.note_epoch(105, lock_reason=None)
    epoch = robot.admission.epoch
    for older in (103, 105, None):
        robot.note_epoch(older, lock_reason=None)
        assert robot.admission.epoch == epoch
    robot.note_epoch(106, lock_reason=None)
    assert robot.admission.epoch == epoch + 1
    robot.note_epoch(106, lock_reason="smoke")
    assert robot.admission.lock_reason == "smoke"
    epoch = robot.admission.epoch
    robot.note_epoch(106, lock_reason="smoke")
    assert robot.admission.epoch == epoch


@inside(in_hub)
async def test_new_poses_call_the_followers_and_known_ones_do_not(made: MemoryHub) -> None:
    robot, calls = remote_robot(made.hub, "robot_7", RecordingHosts()), list[object]()
    robot.followers["page"] = calls.append
    state = msgspec.structs.replace(robot.known, odometry=SNAPSHOT, lease_s=0.3)
    robot.update(robot.known, epoch=1)
    assert calls == []
    for _ in range(2):
        robot.update(state, epoch=1)
    assert (calls, robot.admission.lease_s) == ([None], 0.3)
    robot.update(robot.known, epoch=1)
    assert robot.state(made.now_s).odometry is not None
    robot.update(msgspec.structs.replace(state, odometry=None), epoch=1)  # it was none, its daemon says
    assert robot.state(made.now_s).odometry is None
    robot.update(state, epoch=1)
    assert calls == [None, None]


@inside(in_hub)
async def test_reason_for_unknown_motion_names_what_is_missing(made: MemoryHub) -> None:
    robot = remote_robot(made.hub, "robot_7", RecordingHosts())
    assert robot.why_unknown() == "its device is not connected"
    robot.connect(12, 100)
    assert robot.why_unknown() == "it sends no odometry"
    robot.update(msgspec.structs.replace(robot.known, odometry=SNAPSHOT), epoch=100)
    assert robot.why_unknown() == "no odometry of it has come from other since the stop"
    assert robot.limited_by(SLOW) is None


# -- robots of one run of a component ---------------------------------------------------------------------------------


def known(name: str) -> RobotState:
    return RobotState(
        name=name,
        velocity_topic=f"/{name}/cmd_vel",
        odometry_topic=None,
        odometry_type=None,
        feedback=FeedbackKind.NONE,
    )


@inside(in_hub)
async def test_run_announces_robots_by_valid_names_that_no_other_component_has(
    made: MemoryHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = (host_in(made.hub, name).announce_robots(RecordingHosts()) for name in ("fleet", "cloud"))
    robot = first.announce(known("robot_7"), host="lab")
    assert (made.hub.robots.find("robot_7"), first.get("robot_7"), first.all()) == (robot, robot, [robot])
    assert (second.get("robot_7"), second.all()) == (None, [])
    with pytest.raises(BadRequest, match="robot robot_7: fleet announces it already"):
        second.announce(known("robot_7"), host="cloud")
    second.withdraw("robot_7")
    assert made.hub.robots.has("robot_7")
    for name in ("", "a/b", "x" * 65, "ä"):
        with pytest.raises(BadRequest, match="a name has 1 to 64 letters"):
            first.announce(known(name), host="lab")
    monkeypatch.setattr(remote_robots_module, "MAX_REMOTE", 1)
    with pytest.raises(BadRequest, match="more than 1 robots are announced"):
        second.announce(known("robot_8"), host="cloud")
    first.withdraw("robot_7")
    assert not made.hub.robots.has("robot_7")
    assert second.announce(known("robot_8"), host="cloud").host == "cloud"


@inside(in_hub)
async def test_driver_of_a_robot_that_moves_to_another_host_still_drives_it(made: MemoryHub) -> None:
    robots = host_in(made.hub).announce_robots(RecordingHosts())
    first = robots.announce(known("robot_7"), host="lab", place="1a")
    first.connect(12, 100)
    drive_gate(first, SLOW, owner="ann")
    second = robots.announce(known("robot_7"), host="attic", place="3c")
    assert second.admission is first.admission
    assert (made.hub.robots.find("robot_7"), robots.all()) == (second, [second])
    for use in (first.stop, first.lock, first.unlock, lambda: drive_gate(first, SLOW, owner="ann")):
        with pytest.raises(DeviceGone, match="robot_7: lab is gone"):
            use()


@inside(in_hub)
async def test_end_of_the_run_stops_what_is_driven_and_withdraws_every_robot(made: MemoryHub) -> None:
    hosts, host = RecordingHosts(), host_in(made.hub)
    robots = host.announce_robots(hosts)
    driven, still = (robots.announce(known(name), host="lab") for name in ("robot_7", "robot_8"))
    for robot in (driven, still):
        robot.connect(12, 100)
        robot.offer([(f"/{robot.name}/cmd_vel", TWIST_TYPE)])
    drive_gate(driven, SLOW, owner="ann")
    host.close()
    assert hosts.sent[1:] == [("release", "ann")]
    assert (made.hub.robots.all(), robots.all()) == ([], [])
    assert made.hub.topics.find_or_none(TOPIC) is None
    assert made.hub.gates._admissions == {}
    with pytest.raises(BadRequest, match="the run of test has ended"):
        robots.announce(known("robot_7"), host="lab")
    made.hub.robots.stop_all()
    made.hub.gates.release("bob")
    assert hosts.sent[1:] == [("release", "ann")]


@inside(in_hub)
async def test_sent_velocity_is_shown_to_subscribers_of_the_robots_own_velocity_topics(made: MemoryHub) -> None:
    hosts, heard = RecordingHosts(), list[bytes]()
    robot = connected_robot(made.hub, "robot_7", hosts)
    assert not robot.is_read(TOPIC)
    program = made.hub.join("program")
    for topic in (TOPIC, "/robot_7/plan"):
        program.subscribe(topic, lambda message: heard.append(message.payload), type_name=TWIST_TYPE)
    assert robot.is_read(TOPIC)
    robot.show(TOPIC, SLOW.encode())
    robot.show("/robot_7/plan", SLOW.encode())  # which it does not offer
    assert heard == [SLOW.encode()]
    assert hosts.sent == []
    assert not robot.is_followed(0.0)
    robot.followers["page"] = lambda _: None
    assert robot.is_followed(0.0)
