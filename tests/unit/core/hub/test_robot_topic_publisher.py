"""RobotTopicPublisher: a robot's own topics replace those that another device has announced by these names."""

import asyncio
import struct
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

import pytest
from structlog.testing import capture_logs

from hostlink.core.hub.hub import Hub
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.frame import Id
from hostlink.core.robot.velocity import TWIST_TYPE, PlanarVelocity
from hostlink.errors import WrongType
from tests.support.fake_device import robot_topics, topic
from tests.support.participants import NEIGHBOUR, ODOMETRY_ID, POSE, VELOCITY_ID, Scene, play, publish, subscribe
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import inside

NAME = "robot_2"
VELOCITY, ODOMETRY, RESET = (f"/{NAME}/{leaf}" for leaf in ("velocity_commands", "odometry", "reset_odometry"))
TYPES = {VELOCITY: TWIST_TYPE, ODOMETRY: "geometry_msgs/Pose2D", RESET: "std_msgs/Empty"}
OTHER_ID, TEXT_ID = 126, 127
TEXT = topic(EndpointKind.PUBLISHER, TEXT_ID, "/text", "std_msgs/String")


@dataclass
class Crowd:
    """More devices in a scene; all of them leave at its end."""

    hub: Hub
    devices: list[ScriptedDevice] = field(default_factory=list)

    async def connect(self, infos: list[DeviceEndpoint], address: str) -> ScriptedDevice:
        device = ScriptedDevice(self.hub, infos, address=address)
        self.devices.append(device)
        await asyncio.sleep(0.5)
        return device

    async def disconnect(self, *devices: ScriptedDevice) -> None:
        for device in devices:
            self.devices.remove(device)
            await device.aclose()
        await asyncio.sleep(0.5)


def play_crowd(test: Callable[[Crowd], Awaitable[None]]) -> None:
    async def run(made: Scene) -> None:
        crowd = Crowd(made.hub)
        await test(crowd)
        await crowd.disconnect(*crowd.devices)

    play(run)


async def robot_works(made: Crowd, device: ScriptedDevice, *, name: str = NAME) -> None:
    """Check that each velocity topic drives the robot, and that its poses reach the subscribers."""
    robot = made.hub.robots.find(name)
    assert robot.link is device.link
    assert {each: made.hub.topics.find(each).type_name for each in TYPES} == TYPES
    driver = made.hub.join("driver")
    driver.drive(robot, PlanarVelocity(0.1))
    await asyncio.sleep(0.1)
    driver.leave()
    publish(made.hub, VELOCITY, {"linear": {"x": 0.2}}, source="by topic")
    publish(made.hub, RESET, {}, source="by topic")
    await asyncio.sleep(0.1)
    publish(made.hub, VELOCITY, {}, source="by topic")  # it lets go
    speeds = [struct.unpack("<6d", payload)[0] for payload in device.payloads(VELOCITY_ID)]
    assert {0.1, 0.2} <= set(speeds)
    assert device.payloads(101)
    heard: list[bytes] = []
    subscription = subscribe(made.hub, ODOMETRY, lambda message: heard.append(message.payload))
    await device.send(ODOMETRY_ID, POSE.pack(4.0, 0.0, 0.0))
    await asyncio.sleep(0.1)
    subscription.close()
    assert heard == [POSE.pack(4.0, 0.0, 0.0)]
    observed = robot.odometry.snapshot(asyncio.get_running_loop().time())
    assert observed.pose.x_m == 4.0


@pytest.mark.parametrize("kind", [EndpointKind.PUBLISHER, EndpointKind.SUBSCRIBER])
@pytest.mark.parametrize("name", list(TYPES))
@pytest.mark.parametrize("is_known", [True, False])
@inside(play_crowd)
async def test_another_devices_type_of_a_robots_own_topic_ends_when_the_robot_connects(
    made: Crowd, name: str, kind: Id, is_known: bool
) -> None:
    if is_known:
        device = await made.connect(robot_topics(NAME), "10.0.0.3")
        await made.disconnect(device)
    other = await made.connect([topic(kind, OTHER_ID, name, "std_msgs/String"), TEXT], "10.0.0.4")
    assert made.hub.topics.find(name).type_name == "std_msgs/String"
    with capture_logs() as lines:
        device = await made.connect(robot_topics(NAME), "10.0.0.3")
    refused = [line for line in lines if line["event"] == "topic.refused"]
    assert [line["topic"] for line in refused] == [name]
    assert TYPES[name] in refused[0]["reason"]
    await robot_works(made, device)

    heard: list[bytes] = []
    subscribe(made.hub, name, lambda message: heard.append(message.payload))
    subscribe(made.hub, "/text", lambda message: heard.append(message.payload))
    await other.send(OTHER_ID, struct.pack("<I4s", 4, b"text"))
    await other.send(TEXT_ID, struct.pack("<I5s", 5, b"other"))
    await asyncio.sleep(0.1)
    velocities = [payload for payload in heard if len(payload) == 48]  # the gate's own
    assert [payload for payload in heard if payload not in velocities] == [struct.pack("<I5s", 5, b"other")]
    before = other.payloads(OTHER_ID)
    publish(made.hub, VELOCITY, {"linear": {"x": 0.1}})
    assert other.payloads(OTHER_ID) == before
    await made.disconnect(device, other)
    assert not {key for each in made.hub.topics.all() for key in each.publishers | each.devices.keys()} & {
        device.link, other.link,
    }  # fmt: skip


@inside(play_crowd)
async def test_another_robots_odometry_of_that_name_is_read_on(made: Crowd) -> None:
    uncommon = [
        topic(EndpointKind.PUBLISHER, ODOMETRY_ID, VELOCITY, "geometry_msgs/Pose2D"),
        topic(EndpointKind.SUBSCRIBER, VELOCITY_ID, "/other/cmd_vel", TWIST_TYPE),
    ]
    other = await made.connect(uncommon, "10.0.0.4")
    device = await made.connect(robot_topics(NAME), "10.0.0.3")
    await robot_works(made, device)
    await other.send(ODOMETRY_ID, POSE.pack(7.0, 0.0, 0.0))
    made.hub.join("driver").drive(made.hub.robots.find("other"), PlanarVelocity(0.3))
    await asyncio.sleep(0.1)
    observed = made.hub.robots.find("other").odometry.snapshot(asyncio.get_running_loop().time())
    assert observed.pose.x_m == 7.0
    assert struct.unpack("<6d", other.payloads(VELOCITY_ID)[-1])[0] == 0.3
    assert len(made.hub.robots.devices[other.link.number].drivables) == 1
    await robot_works(made, device)


@inside(play_crowd)
async def test_a_robot_does_not_take_another_robots_velocity_for_its_odometry(made: Crowd) -> None:
    device = await made.connect(robot_topics(NAME), "10.0.0.3")
    for velocity in ("/other/cmd_vel", f"/{NAME}/cmd_vel"):
        uncommon = [
            topic(EndpointKind.SUBSCRIBER, VELOCITY_ID, velocity, TWIST_TYPE),
            topic(EndpointKind.PUBLISHER, ODOMETRY_ID, VELOCITY, "geometry_msgs/Pose2D"),
        ]
        await made.connect(uncommon, "10.0.0.4")
        await robot_works(made, device)


@inside(play_crowd)
async def test_its_own_other_topics_do_not_keep_its_velocity(made: Crowd) -> None:
    both = [topic(EndpointKind.PUBLISHER, OTHER_ID, VELOCITY, "std_msgs/String"), *robot_topics(NAME)]
    await robot_works(made, await made.connect(both, "10.0.0.3"))


@inside(play_crowd)
async def test_a_participants_type_of_that_name_is_refused_as_before(made: Crowd) -> None:
    program = made.hub.join("program")
    program.advertise(VELOCITY, "std_msgs/String")
    device = await made.connect(robot_topics(NAME), "10.0.0.3")
    await robot_works(made, device)
    with pytest.raises(WrongType):
        program.advertise(VELOCITY, "std_msgs/String")


@inside(play_crowd)
async def test_robots_that_come_and_go_beside_one_that_claims_all_their_names_can_be_driven(made: Crowd) -> None:
    claims = [
        topic(EndpointKind.PUBLISHER, 130 + number, f"/robot_{number}/velocity_commands", "std_msgs/Bool")
        for number in range(2, 12)
    ]
    await made.connect(claims, "10.0.0.4")
    for number in range(2, 12):
        device = await made.connect(robot_topics(f"robot_{number}"), f"10.0.1.{number}")
        publish(made.hub, f"/robot_{number}/velocity_commands", {"linear": {"x": 0.2}})
        await asyncio.sleep(0.1)
        assert struct.unpack("<6d", device.payloads(VELOCITY_ID)[-1])[0] == 0.2
        await made.disconnect(device)
    assert made.hub.robots.find(NEIGHBOUR).link is not None


@inside(play_crowd)
async def test_the_gate_of_another_devices_velocity_publishes_nothing_on_a_robots_odometry(made: Crowd) -> None:
    name = f"/{NAME}/vel_odom"
    velocities = [
        topic(EndpointKind.SUBSCRIBER, VELOCITY_ID, "/other/cmd_vel", TWIST_TYPE),
        topic(EndpointKind.SUBSCRIBER, OTHER_ID, name, TWIST_TYPE),
    ]
    other = await made.connect(velocities, "10.0.0.4")
    own = [
        topic(EndpointKind.PUBLISHER, ODOMETRY_ID, name, "geometry_msgs/Pose2D"),
        topic(EndpointKind.SUBSCRIBER, VELOCITY_ID, VELOCITY, TWIST_TYPE),
    ]
    heard: list[bytes] = []
    subscribe(made.hub, name, lambda message: heard.append(message.payload))
    device = await made.connect(own, "10.0.0.3")
    heard.clear()
    before = len(other.payloads(OTHER_ID))
    made.hub.robots.stop_all()
    await device.send(ODOMETRY_ID, POSE.pack(4.0, 0.0, 0.0))
    await asyncio.sleep(0.5)
    assert heard == [POSE.pack(4.0, 0.0, 0.0)]
    assert set(other.payloads(OTHER_ID)[before:]) == {bytes(48)}  # it hears its stop


@inside(play_crowd)
async def test_another_robot_that_is_driven_while_it_loses_a_name_drives_on(made: Crowd) -> None:
    infos = [*robot_topics("other"), topic(EndpointKind.PUBLISHER, OTHER_ID, VELOCITY, "std_msgs/String")]
    other = await made.connect(infos, "10.0.0.4")
    driver, robot = made.hub.join("driver"), made.hub.robots.find("other")
    driver.drive(robot, PlanarVelocity(0.3))
    made.devices.append(ScriptedDevice(made.hub, robot_topics(NAME), address="10.0.0.3"))
    await asyncio.sleep(0.2)
    assert made.hub.topics.find(VELOCITY).type_name == TWIST_TYPE
    assert robot.gate.owner is driver
    assert struct.unpack("<6d", other.payloads(VELOCITY_ID)[-1])[0] == 0.3
