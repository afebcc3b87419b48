"""Links: identification, replacement, parameters and ends of connections, with devices in memory."""

import asyncio
import itertools
from typing import Any

import pytest

from hostlink.core.config import Config, LinkConfig, RobotConfig
from hostlink.core.hub.reloader import places_of
from hostlink.core.hub.robot import LocalRobot
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.events import Parameter
from hostlink.core.protocol.rosserial.control import Log, decode_parameter
from hostlink.core.protocol.rosserial.frame import Id
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import HostlinkError, ReloadRefused
from tests.support.background import meanwhile
from tests.support.device_codec import encode_log, encode_parameter_request
from tests.support.fake_device import robot_topics, topic
from tests.support.gates import drive_gate
from tests.support.memory_hub import MemoryHub, in_hub, velocities
from tests.support.scripted_device import ScriptedDevice

SLOW = PlanarVelocity(0.1)
MARK = topic(EndpointKind.PUBLISHER, 130, "/robot_0/played", "hostlink_msgs/PlayedRecording")
SENSOR = [topic(EndpointKind.PUBLISHER, 125, "/imu", "std_msgs/Bool")]


def test_link_is_logged_from_its_opening_to_its_end() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        assert made.hub.links.all() == [device.link]
        await device.aclose()
        await asyncio.sleep(0.05)
        assert made.hub.links.all() == []
        assert [each["reason"] for each in made.logged("link.closed")] == ["peer_closed"]
        assert made.logged("link.closed")[0]["frames_from_device"] > 0
        assert made.robot().link is None
        assert made.hub.diagnoses.ended[-1].link is device.link

    in_hub(test)


def test_second_device_of_a_name_gets_a_number_and_a_warning() -> None:
    async def test(made: MemoryHub) -> None:
        first, second = await made.connect(address="10.0.0.2"), await made.connect(address="10.0.0.3")
        await asyncio.sleep(4.0)
        assert made.robot("robot_0").link is first.link
        assert made.robot("robot_0_2").link is second.link
        (warning,) = made.logged("robot.numbered")
        assert (warning["robot"], warning["own_name"]) == ("robot_0_2", "robot_0")
        assert 'address = "10.0.0.3"' in warning["advice"]
        assert made.hub.robots.devices[second.link.number].diagnosis.own_name == "robot_0"
        assert made.hub.robots.devices[first.link.number].diagnosis.own_name == ""

    in_hub(test)


def names(made: MemoryHub) -> list[str]:
    return [robot.name for robot in made.hub.robots.here()]


def test_recording_that_is_played_beside_its_robot_has_no_findings_and_leaves_with_its_link() -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect()
        played = await made.connect([*robot_topics(), MARK], address="10.0.0.3")
        await asyncio.sleep(4.0)
        assert made.robot("robot_0_2").is_played
        assert made.hub.diagnoses.of(played.link) == []
        assert made.logged("robot.numbered") == []
        played.write(bytes(range(256)) * 40)  # damage, which a device would be told
        await asyncio.sleep(4.0)
        assert made.hub.diagnoses.of(played.link) == []
        await played.aclose()
        await asyncio.sleep(1.5)
        assert names(made) == ["robot_0"]
        assert made.hub.diagnoses.ended[-1].findings == []

    in_hub(test)


def test_robot_that_was_connected_before_its_recording_stays_known_after_the_playing() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        await device.aclose()
        await asyncio.sleep(0.05)
        played = await made.connect([*robot_topics(), MARK], address="10.0.0.3")
        assert made.robot().is_played
        await played.aclose()
        await asyncio.sleep(0.05)
        assert names(made) == ["robot_0"]
        assert not made.robot().is_played

    in_hub(test)


def test_locked_robot_of_a_recording_stays_known_after_the_playing() -> None:
    async def test(made: MemoryHub) -> None:
        played = await made.connect([*robot_topics(), MARK])
        made.robot().lock("a test")
        await played.aclose()
        await asyncio.sleep(0.05)
        assert names(made) == ["robot_0"]

    in_hub(test)


def test_robot_that_replaces_its_recording_keeps_the_epoch_against_earlier_commands() -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect([*robot_topics(), MARK])
        before = made.robot()
        device = await made.connect(address="10.0.0.3")
        await asyncio.sleep(0.05)
        assert made.robot() is before
        assert before.link is device.link
        assert not before.is_played

    in_hub(test)


def test_device_that_reconnects_replaces_its_silent_link_after_a_zero() -> None:
    async def test(made: MemoryHub) -> None:
        first = await made.connect(peer="10.0.0.2:1")
        drive_gate(made.robot(), SLOW, owner="ann")
        await asyncio.sleep(0.1)
        first.infos = []  # it is dead: it announces nothing, and asks for no time
        second = await made.connect(peer="10.0.0.2:2")
        await asyncio.sleep(4.0)
        assert made.robot().link is second.link
        assert made.hub.links.all() == [second.link]
        assert [each["reason"] for each in made.logged("link.closed")] == ["replaced"]
        assert velocities(first)[-1] == (0.0, 0.0)
        assert velocities(second)[0] == (0.0, 0.0)

    in_hub(test)


@pytest.mark.parametrize("after_s", [0.0, 0.5, 2.0])
def test_driven_board_that_publishes_nothing_stays_beside_a_second_one_that_was_flashed_alike(after_s: float) -> None:
    """The answer to a request for the topics is the only sign of life, and the board answers at once."""

    async def test(made: MemoryHub) -> None:
        topics = [topic(EndpointKind.SUBSCRIBER, 100, "cmd_vel", "geometry_msgs/Twist")]
        first = await made.connect(topics, peer="10.0.0.2:1")
        await asyncio.sleep(after_s)
        async with meanwhile(drive_often(made.robot())):
            await asyncio.sleep(0.2)
            second = await made.connect(topics, peer="10.0.0.2:2")
            await asyncio.sleep(4.0)
            assert made.logged("link.closed") == []
            assert made.robot().link is first.link
            assert velocities(first)[-1] == (0.1, 0.0)
            assert set(velocities(second)) == {(0.0, 0.0)}

    in_hub(test)


async def drive_often(robot: LocalRobot) -> None:
    while True:
        drive_gate(robot, SLOW, owner="ann")
        await asyncio.sleep(0.05)


def test_the_last_frame_of_a_replaced_link_is_a_zero_also_on_a_busy_serial_line() -> None:
    async def test(made: MemoryHub) -> None:
        first = await made.connect(peer="10.0.0.2:1")
        robot = made.robot()
        drive_gate(robot, SLOW, owner="ann")
        first.infos = []
        second = await made.connect(peer="10.0.0.2:2")
        for number in itertools.count(1):
            if robot.link is second.link:
                break
            drive_gate(robot, PlanarVelocity(0.1 + 0.001 * (number % 100)), owner="ann")
            await asyncio.sleep(0.01)
        await asyncio.sleep(1.0)
        assert velocities(first)[-1] == (0.0, 0.0)
        assert [each["reason"] for each in made.logged("link.closed")] == ["replaced"]

    in_hub(test, Config(link=LinkConfig(uart_bytes_s=960)))


def test_messages_before_identification_are_delivered_afterwards() -> None:
    async def test(made: MemoryHub) -> None:
        heard: list[bytes] = []
        made.hub.join("reader").subscribe(
            "/robot_0/odometry", lambda message: heard.append(message.payload), type_name="geometry_msgs/Pose2D"
        )
        first = await made.connect(peer="10.0.0.2:1")
        first.infos = []
        second = ScriptedDevice(made.hub, robot_topics(), address="10.0.0.2", peer="10.0.0.2:2")
        await asyncio.sleep(0.05)
        assert made.hub.robots.devices[second.link.number].is_undecided
        await second.send(125, bytes(24))
        await asyncio.sleep(0.05)
        assert heard == []
        await asyncio.sleep(4.0)
        assert heard == [bytes(24)]
        assert made.hub.links.undelivered == 0

    in_hub(test)


def test_messages_of_a_device_that_leaves_unidentified_are_counted() -> None:
    async def test(made: MemoryHub) -> None:
        first = await made.connect(peer="10.0.0.2:1")
        first.infos = []
        second = ScriptedDevice(made.hub, robot_topics(), address="10.0.0.2", peer="10.0.0.2:2")
        await asyncio.sleep(0.05)
        for _ in range(3):
            await second.send(125, bytes(24))
        await asyncio.sleep(0.01)
        await second.aclose()
        await asyncio.sleep(0.05)
        assert made.hub.links.undelivered == 3

    in_hub(test)


def test_robot_over_the_bound_is_refused_and_one_that_is_away_makes_room() -> None:
    async def test(made: MemoryHub) -> None:
        made.hub.robots.max_robots = 1
        first = await made.connect(robot_topics("a"))
        await made.connect(robot_topics("b"), address="10.0.0.3")
        await asyncio.sleep(0.05)
        assert [each["reason"] for each in made.logged("link.closed")] == ["refused"]
        assert len(made.logged("link.refused")) == 1
        assert not made.hub.robots.has("b")
        await first.aclose()
        await made.connect(robot_topics("c"), address="10.0.0.4")
        assert [robot.name for robot in made.hub.robots.here()] == ["c"]

    in_hub(test)


def test_parameter_request_is_answered_by_the_name_and_remembered() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        await device.send(Id.PARAMETER, encode_parameter_request("~gain"))
        await device.send(Id.PARAMETER, encode_parameter_request("~missing"))
        await asyncio.sleep(0.05)
        answers = [decode_parameter(payload) for payload in device.payloads(Id.PARAMETER)]
        assert answers == [Parameter(ints=(3,)), Parameter()]
        assert made.hub.robots.devices[device.link.number].parameters == {
            "/gain": Parameter(ints=(3,)),
            "/missing": Parameter(),
        }
        assert [each["name"] for each in made.logged("parameter.unknown")] == ["~missing"]

    in_hub(test, Config(parameters={"gain": 3}))


def test_line_of_a_device_s_log_is_logged_and_published() -> None:
    async def test(made: MemoryHub) -> None:
        lines: list[Any] = []
        made.hub.join("reader").subscribe("/rosout", lambda message: lines.append(message.decoded))
        device = await made.connect(peer="10.0.0.2:7")
        sensor = await made.connect(SENSOR, peer="10.0.0.3:7")
        await device.send(Id.LOG, encode_log(Log(2, "low \x1b[1mbattery")))
        await asyncio.sleep(0.05)
        await sensor.send(Id.LOG, encode_log(Log(1, "calibrated")))
        await asyncio.sleep(0.05)
        line, _ = made.logged("device.logged")
        assert (line["log_level"], line["level_name"], line["text"]) == ("warning", "warn", "low ?[1mbattery")
        published, other = lines
        assert (published["level"], published["name"], published["msg"]) == (4, "robot_0", "low \x1b[1mbattery")
        assert (other["name"], other["msg"]) == ("10.0.0.3:7", "calibrated")  # it is not a robot
        assert published["header"]["stamp"]["secs"] > 1_000_000_000

    in_hub(test)


def test_device_with_the_first_protocol_version_is_named() -> None:
    async def test(made: MemoryHub) -> None:
        device, body = await made.connect([]), b"\x0a\x00\x08\x00" + bytes(8)
        device.write(b"\xff\xff" + body + bytes([255 - sum(body) % 256]))
        await asyncio.sleep(0.05)
        assert len(made.logged("protocol.version_1")) == 1

    in_hub(test)


def test_reconfigured_address_renames_a_connected_robot_unless_it_is_driven_or_locked() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(address="10.0.0.2")
        config = Config(robots={"mower": RobotConfig(address="10.0.0.2")})
        drive_gate(made.robot(), SLOW, owner="ann")
        with pytest.raises(ReloadRefused, match="robot_0 is driven"):
            made.hub.reconfigure(config, places_of(config))
        await asyncio.sleep(1.0)
        made.robot().lock("smoke")
        await asyncio.sleep(1.0)
        for is_away in (False, True):
            if is_away:
                await device.aclose()
                await asyncio.sleep(1.0)
            with pytest.raises(ReloadRefused, match="robot_0 is locked"):
                made.hub.reconfigure(config, places_of(config))
        device = await made.connect(address="10.0.0.2")
        made.robot().unlock()
        await asyncio.sleep(1.0)
        assert made.hub.reconfigure(config, places_of(config)) == {"robot_0": "mower"}
        assert made.robot("mower").link is device.link
        assert not made.hub.robots.has("robot_0")
        assert made.hub.links.shown_name(device.link, "/robot_0/imu") == "/mower/imu"
        assert made.hub.config is config

    in_hub(test)


def test_silence_requests_an_end_of_transmission_of_every_device() -> None:
    async def test(made: MemoryHub) -> None:
        device, other = await made.connect(), await made.connect(SENSOR, address="10.0.0.3")
        await made.hub.links.silence()
        await asyncio.sleep(0.05)
        assert len(device.payloads(Id.STOP)) == 1
        assert len(other.payloads(Id.STOP)) == 1
        made.hub.links.end_all()
        await asyncio.sleep(0.05)
        assert {each["reason"] for each in made.logged("link.closed")} == {"stopped"}

    in_hub(test)


def test_shutdown_sends_zero_refuses_commands_and_ends_the_links() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        drive_gate(made.robot(), SLOW, owner="ann")
        await asyncio.sleep(0.05)
        began_s = made.now_s
        await made.hub.shutdown()
        assert made.now_s - began_s <= 0.51
        await asyncio.sleep(0.05)
        assert velocities(device)[-3:] == [(0.0, 0.0)] * 3
        with pytest.raises(HostlinkError):
            drive_gate(made.robot(), SLOW, owner="ann")
        assert made.hub.links.all() == []

    in_hub(test)


def test_line_speed_of_a_robot_is_that_of_its_address_else_that_of_the_links() -> None:
    async def test(made: MemoryHub) -> None:
        slow, usual = await made.connect(address="10.0.0.2"), await made.connect(robot_topics("b"), address="10.0.0.3")
        assert made.hub.links._uart_bytes_s(_at("10.0.0.2"), made.hub.config.link) == 1000
        assert made.hub.links._uart_bytes_s(_at("10.0.0.3"), made.hub.config.link) == 3840
        assert slow.link is not usual.link

    config = Config(
        link=LinkConfig(uart_bytes_s=3840),
        robots={"a": RobotConfig(address="10.0.0.2", uart_bytes_s=1000), "b": RobotConfig(address="10.0.0.3")},
    )
    in_hub(test, config)


class _At:
    def __init__(self, address: str) -> None:
        self.peer = self.address = address


def _at(address: str) -> "_At":
    return _At(address)


def test_topic_with_another_type_than_a_robot_s_own_is_ended() -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect([topic(EndpointKind.PUBLISHER, 125, "/robot_0/velocity_commands", "std_msgs/Bool")])
        robot = await made.connect(address="10.0.0.3")
        assert made.hub.topics.find("/robot_0/velocity_commands").type_name == "geometry_msgs/Twist"
        drive_gate(made.robot(), SLOW, owner="ann")
        await asyncio.sleep(0.05)
        assert velocities(robot)[-1] == (0.1, 0.0)
        assert [each["topic"] for each in made.logged("topic.refused")] == ["/robot_0/velocity_commands"]

    in_hub(test)


def test_link_that_is_not_known_has_no_names() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        await device.aclose()
        await asyncio.sleep(0.05)
        assert made.hub.links.shown_name(device.link, "imu") == "imu"

    in_hub(test)


def test_robot_that_may_be_the_locked_one_is_locked_with_its_reason() -> None:
    async def test(made: MemoryHub) -> None:
        first, second = await made.connect(address="10.0.0.2"), await made.connect(address="10.0.0.3")
        await asyncio.sleep(4.0)
        assert {robot.name for robot in made.hub.robots.here()} == {"robot_0", "robot_0_2"}
        made.robot("robot_0_2").lock("a person is near")
        for device in (first, second):
            await device.aclose()
        await asyncio.sleep(0.1)
        await made.connect(address="10.0.0.9")
        await asyncio.sleep(4.0)
        (connected,) = (robot for robot in made.hub.robots.here() if robot.link is not None)
        assert (connected.name, connected.gate.lock_reason) == ("robot_0_3", "it may be robot_0_2: a person is near")

    in_hub(test)


def test_robot_with_other_topics_is_not_locked_for_one_that_is_away() -> None:
    async def test(made: MemoryHub) -> None:
        first = await made.connect(address="10.0.0.2")
        made.robot().lock("a person is near")
        await first.aclose()
        await made.connect(robot_topics("mule"), address="10.0.0.9")
        await asyncio.sleep(4.0)
        assert made.robot("mule").gate.lock_reason is None

    in_hub(test)


def test_topics_announced_again_send_latched_messages_again() -> None:
    async def test(made: MemoryHub) -> None:
        infos: list[DeviceEndpoint] = [topic(EndpointKind.SUBSCRIBER, 100, "/text", "std_msgs/String")]
        device = await made.connect(infos)
        participant = made.hub.join("ann")
        found = participant.advertise("/text", "std_msgs/String", is_latched=True)
        assert found.type is not None
        participant.publish("/text", found.type.encode({"data": "hello"}))
        await asyncio.sleep(0.05)
        assert len(device.payloads(100)) == 1
        await asyncio.sleep(2.0)
        await device.announce()
        await asyncio.sleep(0.05)
        assert len(device.payloads(100)) == 2
        assert [each["is_changed"] for each in made.logged("topics.negotiated")] == [True, False]

    in_hub(test)
