"""Recorder: its subscriptions as the graph changes, and their cost."""

import asyncio
from dataclasses import dataclass, field

import msgspec

from hostlink.components.recorder.channel import CDR, EVENTS, ROS1, Channel, json_of
from hostlink.components.recorder.recorder import Recorder, TopicSelection
from hostlink.core.config import Config
from hostlink.core.hub.graph_changes import LATEST_S
from hostlink.core.hub.hub import Hub
from hostlink.core.robot.events import EventKind
from hostlink.core.robot.velocity import PlanarVelocity, Twist
from tests.support.fake_device import CATALOG
from tests.support.hosts import host_of
from tests.support.remote_robots import remote_robot
from tests.support.virtual_loop import run_virtual, virtual

TYPE = "std_msgs/Bool"
VELOCITY, TWIST = PlanarVelocity(0.1, 0.2, 0.3), Twist(0.1, 0.2, 0.3, 0.4, 0.5, 0.6)


class Kept:
    """Sink that keeps its messages."""

    def __init__(self) -> None:
        self.channels: list[str] = []
        self.of_payloads: list[Channel] = []
        self.payloads: list[bytes] = []

    def announce(self, channel: Channel) -> None:
        self.channels.append(channel.topic)

    def put(self, channel: Channel, stamp_ns: int, payload: bytes, robot: str) -> None:  # noqa: ARG002 - of a sink
        self.payloads.append(payload)
        self.of_payloads.append(channel)


@dataclass(frozen=True)
class Counted(TopicSelection):
    """View that counts the requested topics."""

    asked: list[str] = field(default_factory=list)

    def has(self, topic: str, robot: str) -> bool:
        self.asked.append(topic)
        return super().has(topic, robot)


@virtual
async def test_connecting_robot_costs_a_recorder_only_its_own_topics() -> None:
    hub, kept, selection = Hub(Config(), CATALOG, reraises=True), Kept(), Counted()
    for number in range(300):
        robot = hub.join(f"robot_{number}")
        for topic in range(10):
            robot.advertise(f"/robot_{number}/{topic}", TYPE)
    recorder = Recorder(host_of(hub), kept, selection)
    recorder.start()
    await asyncio.sleep(2 * LATEST_S)
    assert len(recorder.topics) >= 3000
    selection.asked.clear()
    new = hub.join("new")
    new.advertise("/new/topic", TYPE)
    await asyncio.sleep(2 * LATEST_S)
    came = [name for name in recorder.topics if name.startswith("/new")]
    new.publish("/new/topic", b"\1")
    assert kept.payloads[-1:] == [b"\1"]
    new.leave()
    await asyncio.sleep(2 * LATEST_S)
    recorder.stop()
    left = [name for name in recorder.topics if name.startswith("/new")]
    assert (came, left) == (["/new/topic"], [])
    assert set(selection.asked) == {"/new/topic"}
    assert len(selection.asked) <= 4


def test_velocities_of_an_event_have_the_names_of_their_fields() -> None:
    async def run() -> bytes:
        hub, kept = Hub(Config(), CATALOG, reraises=True), Kept()
        Recorder(host_of(hub), kept, TopicSelection()).start()
        facts = {"velocity": TWIST, "limited": VELOCITY}
        hub.events.note(EventKind.COMMANDED, "robot_0", owner="client 1", address="10.0.0.1", **facts)
        return kept.payloads[-1]

    limited = {"linear_x_m_s": 0.1, "linear_y_m_s": 0.2, "angular_z_rad_s": 0.3}
    # No address: the file may be given to others.
    facts = {"owner": "client 1", "velocity": TWIST._asdict(), "limited": limited}
    event = msgspec.json.decode(json_of(EVENTS, run_virtual(run())))
    assert event == {"kind": "commanded", "robot": "robot_0", "facts": facts}


@virtual
async def test_topics_of_a_robots_name_are_recorded_once_it_is_that_robots() -> None:
    hub = Hub(Config(), CATALOG, reraises=True)
    hub.join("program").advertise("/robot_7/plan", TYPE)
    recorder = Recorder(host_of(hub), Kept(), TopicSelection(robots=("robot_7",)))
    recorder.start()
    await asyncio.sleep(2 * LATEST_S)
    before = recorder.topics
    hub.robots.put_remote(remote_robot(hub, "robot_7"))
    await asyncio.sleep(2 * LATEST_S)
    assert (before, recorder.topics) == ([], ["/robot_7/plan"])


@virtual
async def test_type_without_a_definition_is_recorded_in_the_encoding_of_its_device() -> None:
    hub, kept = Hub(Config(), CATALOG, reraises=True), Kept()
    hub.join("program").subscribe("/talk", lambda _: None, type_name="my_msgs/Own")  # the topic stays
    recorder = Recorder(host_of(hub), kept, TopicSelection())
    recorder.start()
    for device, encoding in (("micro-ROS", CDR), ("rosserial", ROS1)):
        topic = hub.topics.advertise("/talk", device, type_name="my_msgs/Own", raw_encoding=encoding)
        await asyncio.sleep(2 * LATEST_S)
        topic.publish(encoding.encode(), source=device)
        topic.encoding = CDR if encoding == ROS1 else ROS1  # it changes, and the graph has not reported that yet
        topic.publish(b"not on this channel", source=device)
        topic.encoding, topic.type_name = encoding, "my_msgs/Other"
        topic.publish(b"not on this channel, too", source=device)
        topic.type_name = "my_msgs/Own"
        hub.topics.leave(device)
        await asyncio.sleep(2 * LATEST_S)
    recorder.stop()
    found = [(each.encoding, each.type_name, each.schema_encoding, each.schema) for each in kept.of_payloads]
    assert found == [("cdr", "my_msgs/msg/Own", "", ""), ("ros1", "my_msgs/Own", "ros1msg", "")]
    assert kept.payloads == [b"cdr", b"ros1"]
    assert ["md5sum" in dict(each.metadata) for each in kept.of_payloads] == [False, True]
