"""One micro-ROS board with each component: its odometry arrives there, and a velocity from there reaches the board."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap_ros1.decoder import DecoderFactory
from rosbags.typesys import Stores, get_typestore

from hostlink.components.mqtt.settings import MqttSettings
from hostlink.components.recorder.settings import RecordingConfig
from hostlink.components.ros1.settings import Ros1Config
from hostlink.components.ros1.xml_rpc import decode_answer
from hostlink.core.robot.admission import LEASE_S
from tests.integration.test_foxglove_protocol import keys, player
from tests.integration.test_micro_ros import CONFIG, address_of, robot_of
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import CATALOG
from tests.support.mosquitto import broker, program
from tests.support.process import free_port
from tests.support.rmw import TWIST_KEY, Talker, bridged, ros2_peer, zenoh_session
from tests.support.ros1.fake import connection, fake_master, fake_publisher
from tests.support.ros1.scene import twist
from tests.support.rosbridge import client
from tests.support.waiting import TIMEOUT_S, expect
from tests.support.xrce_device import Device, udp_board
from tests.support.zenoh_fleet import drive, fleet, robot, shown

ODOMETRY, VELOCITY = "/odom/unfiltered", "/cmd_vel"
X_M, SPEED = 0.5, 0.2
ROS1 = get_typestore(Stores.ROS1_NOETIC)
TYPE = CATALOG.message("nav_msgs/Odometry")
assert TYPE is not None


@contextlib.asynccontextmanager
async def board_at(host: Daemon) -> AsyncIterator[Device]:
    """A board that is at work, and known."""
    async with udp_board(address_of(host, "udp")) as device:
        await device.is_at_work()
        await robot_of(host)
        yield device


async def is_driven(device: Device, command: Callable[[], Awaitable[object]], speed: float = SPEED) -> None:
    """Command until the board takes the velocity, then until it takes the zero of the end of the lease.

    A source with a late command is refused until it lets go.
    """
    taken, begun = device.stock.taken, len(device.stock.taken)

    def is_so(wanted: float) -> bool:
        return any(abs(each - wanted) < 1e-6 for _, each in taken[begun:])

    async with asyncio.timeout(TIMEOUT_S):
        while not is_so(speed):
            for _ in range(8):
                await command()
                await asyncio.sleep(0.05)
            if not is_so(speed):
                await asyncio.sleep(2 * LEASE_S)
    await expect(lambda: taken[-1][1] == 0.0)


def position_of(payload: bytes) -> float:
    """The position in an Odometry of ROS 1, by a reader of others. Its other fields are checked."""
    found: Any = ROS1.deserialize_ros1(payload, "nav_msgs/msg/Odometry")
    assert (found.header.frame_id, found.pose.pose.orientation.w) == ("odom", 1.0)
    assert len(found.twist.covariance) == 36
    return float(found.pose.pose.position.x)


def recorded(folder: Path) -> dict[str, list[Any]]:
    """Messages of the recordings in a folder by topic, as the mcap libraries decode them."""
    found: dict[str, list[Any]] = {}
    for path in folder.glob("*.mcap"):
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, channel, _, message in reader.iter_decoded_messages():
                found.setdefault(channel.topic, []).append(message)
    return found


async def test_recording_of_a_board_is_read_by_the_readers_of_others(tmp_path: Path) -> None:
    settings = RecordingConfig(folder=tmp_path, min_free_disk_mb=0.0)
    async with daemon(CONFIG.with_tables(recording=settings)) as host, board_at(host) as device:
        status, view = await host.rest("POST", "/api/recordings", b"{}")
        assert status == 200, view
        name, count = await robot_of(host), len(device.stock.published)
        await is_driven(device, lambda: host.drive(name, json.dumps({"linear": SPEED, "angular": 0}).encode()))
        await expect(lambda: len(device.stock.published) > count + 20)
        status, view = await host.rest("POST", f"/api/recordings/{view['name']}/stop")
        assert status == 200, view
    found = recorded(tmp_path)
    assert {each.pose.pose.position.x for each in found[ODOMETRY]} == {X_M}
    assert {each.header.frame_id for each in found[ODOMETRY]} == {"odom"}
    assert {each.orientation.w for each in found["/imu/data"]} == {1.0}
    assert len(found[ODOMETRY]) >= 8
    assert SPEED in {round(each.linear.x, 6) for each in found[VELOCITY]}


async def test_foxglove_reads_and_drives_a_board() -> None:
    async with daemon(CONFIG) as host, board_at(host) as device, player(host) as one:
        await one.subscribe(ODOMETRY)
        await expect(lambda: "client 1" in map(str, keys(host, ODOMETRY)))
        assert position_of((await one.message())[1]) == X_M
        await one.begin_to_drive(VELOCITY)
        await is_driven(device, one.drive)


async def test_rosbridge_reads_and_drives_a_board() -> None:
    async with daemon(CONFIG) as host, board_at(host) as device, client(host, level="none") as one:
        await one.send(op="subscribe", topic=ODOMETRY)
        found = (await one.receive())["msg"]
        assert found["pose"]["pose"]["position"]["x"] == X_M
        assert found["header"]["frame_id"] == "odom"
        await one.send(op="unsubscribe", topic=ODOMETRY)
        await one.send(op="advertise", topic=VELOCITY, type="geometry_msgs/Twist")
        await is_driven(device, lambda: one.send(op="publish", topic=VELOCITY, msg={"linear": {"x": SPEED}}))


async def test_node_of_ros_1_reads_and_drives_a_board() -> None:
    assert TYPE is not None
    reader = {"callerid": "/listener", "topic": ODOMETRY, "type": TYPE.name, "md5sum": TYPE.md5}
    async with (
        fake_master() as master,
        daemon(CONFIG.with_tables(ros1=Ros1Config(master=master.url))) as host,
        board_at(host) as device,
    ):
        await master.knows("Publisher", ODOMETRY)
        answer = await master.call("requestTopic", "/listener", ODOMETRY, [["TCPROS"]])
        _, address, port = decode_answer(answer)
        async with connection((address, port), **reader) as listener:
            assert (await listener.read_header())["md5sum"] == TYPE.md5
            assert position_of(await listener.read()) == X_M
        async with fake_publisher("geometry_msgs/Twist") as publisher:
            await master.knows("Subscriber", VELOCITY)
            assert decode_answer(await master.call("publisherUpdate", "/master", VELOCITY, [publisher.uri])) == 0
            peer = await publisher.connected()
            await is_driven(device, lambda: peer.send_message(twist(SPEED)))


async def test_node_of_ros_2_reads_and_drives_a_board() -> None:
    async with (
        bridged(config=CONFIG) as world,
        board_at(world.daemon) as device,
        ros2_peer(world.address) as peer,
        zenoh_session(world.address) as session,
    ):
        await peer.request("echo", "subscribed", topic=ODOMETRY, type="nav_msgs/msg/Odometry")
        found = await peer.read("message")
        assert found["pose"]["pose"]["position"]["x"] == X_M
        assert found["header"]["frame_id"] == "odom"
        talker = Talker(session, VELOCITY, TWIST_KEY)
        await expect(lambda: talker.has_subscribers)

        async def command() -> None:
            talker.drive(SPEED)

        await is_driven(device, command)


async def test_board_of_another_host_of_the_fleet_is_shown_and_driven() -> None:
    async with fleet("a", "b", config=CONFIG) as (a, b), board_at(b) as device:
        name = await robot_of(b)
        remote = await shown(a, name)
        assert (await robot(a, name))["host"] == "b"
        await expect(lambda: remote.odometry.count)
        assert (await a.get(f"/api/robots/{name}/odometry"))["pose"]["x_m"] == X_M
        await is_driven(device, lambda: drive(a, name, SPEED))


async def test_broker_of_mqtt_has_the_pose_of_a_board_and_drives_it(tmp_path: Path) -> None:
    port = free_port()
    settings = MqttSettings(port=port, interval_s=0.2, drive=True)
    async with (
        broker(tmp_path, port),
        daemon(CONFIG.with_tables(mqtt=settings)) as host,
        board_at(host) as device,
        program(port) as mqtt,
    ):
        name = await robot_of(host)
        await expect(lambda: mqtt.state(name)["pose"] is not None)
        assert mqtt.state(name)["pose"]["x_m"] == X_M
        await is_driven(device, lambda: mqtt.drive(SPEED, name))
