"""ROS 2 by rmw_zenoh's protocol: checked against zenoh-ros2-sdk, and a node that is written after the documents."""

import asyncio
import contextlib
import struct
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hostlink.cli.garbage import SWITCH_INTERVAL_S
from hostlink.components.graphs.ros2_types import Ros2Types
from hostlink.components.zenoh import rmw_bridge
from hostlink.components.zenoh.rmw_protocol import parse_token
from hostlink.components.zenoh.session import Token
from hostlink.components.zenoh.settings import ZenohSettings
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.message import Message
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import ServiceFailed
from tests.support.daemon import daemon
from tests.support.fake_device import CATALOG, FakeDevice, fake_device, pose, robot_topics
from tests.support.participants import text
from tests.support.process import free_port
from tests.support.proxy import Line, proxy
from tests.support.rmw import (
    STRING,
    STRING_KEY,
    TWIST,
    TWIST_KEY,
    Bridged,
    Ros2Peer,
    Talker,
    bridged,
    ros2_peer,
    router,
    zenoh_session,
)
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import TIMEOUT_S, expect, expect_never

ODOMETRY = {"nav_msgs/msg/Odometry"}
LEASE_S = 0.5
STOP_S = LEASE_S + 0.15  # the gate's clock ticks every 50 ms
HASHED = (
    "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage",
    "geometry_msgs/msg/Pose2D", "sensor_msgs/msg/JointState", "sensor_msgs/msg/Range", "sensor_msgs/msg/BatteryState",
    "sensor_msgs/msg/Imu", "sensor_msgs/msg/LaserScan", "std_msgs/msg/Bool", "std_msgs/msg/Empty",
    "std_msgs/msg/Float32MultiArray", "std_msgs/msg/String", "diagnostic_msgs/msg/DiagnosticArray",
)  # fmt: skip


def publishers(hub: Hub) -> list[str]:
    """Return the publishers of the robot's velocity in the hub."""
    found = hub.topics.find_or_none("/robot_0/cmd_vel")
    return [] if found is None else [str(each) for each in found.publishers if str(each).startswith("ros2")]


async def known(hub: Hub, talker: Talker) -> None:
    """Wait until the bridge knows the publisher, and the publisher knows the bridge."""
    await expect(lambda: publishers(hub) and talker.has_subscribers)


async def driven(device: FakeDevice, talker: Talker) -> None:
    """Drive until the device receives the velocity: a velocity that was read late is refused."""
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            talker.drive(0.2)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(2 * LEASE_S):  # without a velocity for a lease the talker is armed again
                    assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
                    return


@contextlib.asynccontextmanager
async def driving() -> AsyncIterator[tuple[Bridged, FakeDevice, Talker]]:
    """A robot that a publisher of ROS 2 drives."""
    async with (
        bridged() as world,
        fake_device(world.daemon.tcp, robot_topics()) as device,
        zenoh_session(world.address) as session,
    ):
        talker = Talker(session, "/robot_0/cmd_vel", TWIST_KEY)
        await known(world.daemon.hub, talker)
        await driven(device, talker)
        yield world, device, talker


async def zero(device: FakeDevice) -> float:
    """Wait for a velocity of zero; returns the seconds that it took."""
    watch = Stopwatch()
    while (await device.velocity())[0] != 0:
        pass
    return watch.seconds


async def lists(peer: Ros2Peer, topics: dict[str, set[str]]) -> None:
    """Wait until a node of ROS 2 lists these topics with these types: the tokens come one after another."""
    listed = dict[str, set[str]]()
    try:
        async with asyncio.timeout(TIMEOUT_S):
            while listed != topics:
                answer = await peer.request("topics", "topics")
                listed = {name: set(types) for name, types in answer.items() if name in topics}
    except TimeoutError:
        raise AssertionError(f"listed: {listed}") from None


def heard(world: Bridged, topic: str, type_name: str = "") -> list[bytes]:
    """Return the list of messages that a program receives on a topic from now on."""
    received = list[bytes]()

    def receive(message: Message) -> None:
        received.append(message.payload)

    world.daemon.hub.join("listener").subscribe(topic, receive, type_name=type_name)
    return received


async def test_ros_2_lists_a_robots_topics() -> None:
    async with bridged() as world, fake_device(world.daemon.tcp, robot_topics()), ros2_peer(world.address) as peer:
        await lists(
            peer,
            {
                "/robot_0/odom": ODOMETRY,
                "/robot_0/cmd_vel": {"geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"},
                "/tf": {"tf2_msgs/msg/TFMessage"},
                "/rosout": {"rcl_interfaces/msg/Log"},
            },
        )
        tokens = await peer.request("tokens", "tokens")
        assert any("/NN/" in token and token.endswith("/hostlink_test_host") for token in tokens)
        assert any("/SS/" in token and "%robot_0%lock" in token for token in tokens)
        for token in tokens:
            parsed = parse_token(token)
            assert parsed is not None, token
            assert parsed.encode() == token


async def test_robot_that_disconnects_is_no_longer_listed() -> None:
    async with bridged() as world, ros2_peer(world.address) as peer:
        async with fake_device(world.daemon.tcp, robot_topics()):
            await lists(peer, {"/robot_0/odom": ODOMETRY})
        await expect(lambda: world.daemon.hub.links.all() == [])
        async with asyncio.timeout(TIMEOUT_S):
            while "/robot_0/odom" in await peer.request("topics", "topics"):
                pass


async def test_odometry_reaches_ros_2() -> None:
    async with (
        bridged() as world,
        fake_device(world.daemon.tcp, robot_topics()) as device,
        ros2_peer(world.address) as peer,
    ):
        await peer.request("echo", "subscribed", topic="/robot_0/odom", type="nav_msgs/msg/Odometry")
        await expect(lambda: world.daemon.hub.topics.find("/robot_0/odom").has_subscribers)
        await device.send(pose(0.25))
        message = await peer.read("message")
        assert message["pose"]["pose"]["position"]["x"] == 0.25
        assert message["header"]["frame_id"] == "robot_0/odom"
        assert abs(message["header"]["stamp"]["sec"] - time.time()) < 5


async def test_messages_of_ros_2_reach_programs_and_the_topic_is_shown() -> None:
    async with bridged() as world, ros2_peer(world.address) as peer:
        await peer.request("advertise", "advertised", topic="/chatter", type=STRING)
        await expect(lambda: world.daemon.hub.topics.find("/chatter").type_name == "std_msgs/String")
        received = heard(world, "/chatter")
        async with asyncio.timeout(TIMEOUT_S):
            while not received:  # until the peer knows the subscription
                await peer.send("publish", topic="/chatter", type=STRING, fields={"data": "first"})
                await asyncio.sleep(0.05)
        for number in range(20):
            await peer.send("publish", topic="/chatter", type=STRING, fields={"data": f"from ros 2: {number}"})
        numbered = [text(f"from ros 2: {number}") for number in range(20)]
        await expect(lambda: [each for each in received if each != text("first")] == numbered)


async def test_twist_with_a_header_drives_by_the_same_name() -> None:
    fields: dict[str, Any] = {
        "twist": {"linear": {"x": 0.2, "y": 0.1}, "angular": {"z": 0.5}},
        "header": {"frame_id": "base_link"},
    }
    type_name = "geometry_msgs/msg/TwistStamped"
    async with (
        bridged() as world,
        fake_device(world.daemon.tcp, robot_topics()) as device,
        ros2_peer(world.address) as peer,
    ):
        await peer.request("stream", "streaming", topic="/robot_0/cmd_vel", type=type_name, fields=fields, hz=20)
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.5)
        gate = world.daemon.hub.robots.find("robot_0").gate
        assert gate.current == PlanarVelocity(0.2, 0.1, 0.5)
        assert str(gate.owner_name).startswith("ros2 /zenoh_publisher")


async def test_hashes_are_those_of_the_other_implementation() -> None:
    types = Ros2Types(CATALOG, "kilted")
    async with bridged() as world, ros2_peer(world.address) as peer:
        hashes = await peer.request("hashes", "hashes", types=list(HASHED))
    for name in HASHED:
        package, _, base = name.split("/")
        message = types.message(f"{package}/{base}")
        assert message is not None
        assert (message.name, message.type_hash) == (name, hashes[name])
    service = types.service("std_srvs/SetBool")
    assert service is not None
    assert service.type_hash == hashes["std_srvs/srv/SetBool"]


async def test_ros_2_calls_a_service_of_the_hub() -> None:
    async def answer(request: Mapping[str, object]) -> Mapping[str, object]:
        if not request["data"]:
            raise ServiceFailed("/switch", "it is stuck")
        return {"success": True, "message": f"switched to {request['data']}"}

    async with bridged() as world, ros2_peer(world.address) as peer:
        world.daemon.hub.join("program").provide("/switch", "std_srvs/SetBool", answer)
        async with asyncio.timeout(TIMEOUT_S):
            while not any("%switch" in token for token in await peer.request("tokens", "tokens")):
                pass
        arguments = {"service": "/switch", "type": "std_srvs/srv/SetBool"}
        good = await peer.request("call", "answer", **arguments, fields={"data": True})
        assert (good["success"], good["message"]) == (True, "switched to True")
        bad = await peer.request("call", "answer", **arguments, fields={"data": False})
        assert bad["success"] is False
        assert "stuck" in bad["message"]


async def test_the_hub_calls_a_service_of_ros_2() -> None:
    async with bridged() as world, ros2_peer(world.address) as peer:
        await peer.request("serve", "serving", service="/lamp")
        await expect(lambda: world.daemon.hub.services.is_offered("/lamp"))
        program = world.daemon.hub.join("program")
        answer = None
        async with asyncio.timeout(TIMEOUT_S):
            while answer is None:  # the service is known before the way to it
                with contextlib.suppress(ServiceFailed):
                    answer = await program.call("/lamp", {"data": True})
        assert answer == {"success": True, "message": "from ros 2"}
        assert await program.call("/lamp", {"data": False}) == {"success": False, "message": "from ros 2"}
        peer.process.kill()
        await expect(lambda: not world.daemon.hub.services.is_offered("/lamp"))


async def test_latched_message_reaches_a_ros_2_node_that_joins_later() -> None:
    async with bridged() as world:
        program = world.daemon.hub.join("program")
        program.advertise("/map_name", "std_msgs/String", is_latched=True)
        await asyncio.sleep(0.2)
        program.publish("/map_name", text("hall 3"))
        async with ros2_peer(world.address) as peer:
            await peer.send("echo", topic="/map_name", type=STRING, is_latched=True)
            assert (await peer.read("message"))["data"] == "hall 3"


async def test_message_that_ros_2_latched_reaches_a_program_that_joins_later() -> None:
    async with bridged() as world, zenoh_session(world.address) as session:
        talker = Talker(session, "/map_name", STRING_KEY, is_latched=True)
        talker.put(b"\0\1\0\0" + struct.pack("<I", 3) + b"ok\0")
        await expect(lambda: world.daemon.hub.topics.find("/map_name").publishers)
        await asyncio.sleep(0.2)
        received = heard(world, "/map_name")
        await expect(lambda: received == [text("ok")])


async def test_a_publisher_that_is_killed_stops_its_robot_at_once() -> None:
    async with bridged() as world, fake_device(world.daemon.tcp, robot_topics()) as device:
        async with ros2_peer(world.address) as peer:
            fields = {"linear": {"x": 0.2}}
            await peer.request("stream", "streaming", topic="/robot_0/cmd_vel", type=TWIST, fields=fields, hz=20)
            assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
            peer.process.kill()
            assert await zero(device) < STOP_S or world.daemon.was_paused
        assert world.daemon.hub.robots.find("robot_0").gate.owner is None


async def test_a_publisher_that_falls_silent_ends_with_its_lease() -> None:
    async with driving() as (world, device, _):
        began_s = time.monotonic()
        assert await zero(device) < STOP_S or world.daemon.was_paused
        assert time.monotonic() - began_s > LEASE_S - 0.1


@pytest.mark.parametrize("line", [pytest.param(Line.SWALLOWS, marks=pytest.mark.long), Line.STALLS])
async def test_a_cut_network_ends_the_lease(line: Line) -> None:
    async with bridged() as world, fake_device(world.daemon.tcp, robot_topics()) as device:
        host, _, port = world.address.rpartition(":")
        async with proxy((host, int(port))) as between, ros2_peer(between.url.removeprefix("http://")) as peer:
            fields = {"linear": {"x": 0.2}}
            await peer.request("stream", "streaming", topic="/robot_0/cmd_vel", type=TWIST, fields=fields, hz=20)
            assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
            between.set_line(line)
            assert await zero(device) < STOP_S or world.daemon.was_paused
            await expect_never(lambda: world.daemon.hub.robots.find("robot_0").gate.owner, for_s=0.7)


async def test_commands_that_a_network_held_back_move_nothing_when_it_works_again(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{transport: {link: {tx: {lease: 10000}}}}")  # with hostlink's the node would connect again
    async with bridged(file=file) as world, fake_device(world.daemon.tcp, robot_topics()) as device:
        host, _, port = world.address.rpartition(":")
        async with proxy((host, int(port))) as between, ros2_peer(between.url.removeprefix("http://")) as peer:
            fields = {"linear": {"x": 0.2}}
            await peer.request("stream", "streaming", topic="/robot_0/cmd_vel", type=TWIST, fields=fields, hz=20)
            assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
            between.set_line(Line.STALLS)
            await zero(device)
            await peer.request("end_stream", "ended", topic="/robot_0/cmd_vel")
            await asyncio.sleep(LEASE_S + 0.3)
            between.set_line(Line.WORKS)
            await expect(lambda: world.bridge.counts["late"])
            await expect_never(lambda: world.daemon.hub.robots.find("robot_0").gate.owner, for_s=0.5)


async def test_a_router_that_is_killed_ends_what_came_through_it_until_it_is_back() -> None:
    async with (
        router() as (address, process),
        bridged(connect=(f"tcp/{address}",), mode="client", listen=()) as world,
        fake_device(world.daemon.tcp, robot_topics()) as device,
        ros2_peer(address, mode="client") as peer,
    ):
        await asyncio.sleep(0.5)
        fields = {"linear": {"x": 0.2}}
        await peer.request("stream", "streaming", topic="/robot_0/cmd_vel", type=TWIST, fields=fields, hz=20)
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
        process.kill()
        assert await zero(device) < STOP_S or world.daemon.was_paused
        await expect(lambda: not publishers(world.daemon.hub))
        await process.wait()
        async with router(address):  # a node that is still there drives again once it has let go
            await expect(lambda: publishers(world.daemon.hub))
            await peer.request("end_stream", "ended", topic="/robot_0/cmd_vel")
            await asyncio.sleep(rmw_bridge.MATCH_S + LEASE_S)  # what streams until then may have begun before
            await peer.request("stream", "streaming", topic="/robot_0/cmd_vel", type=TWIST, fields=fields, hz=20)
            await expect(lambda: world.daemon.hub.robots.find("robot_0").gate.owner is not None)
            await device.velocity_of((0.2, 0.0))


async def test_hostlink_can_be_the_router_of_ros_2() -> None:
    """Nodes that know its address alone hear each other through it."""
    async with (
        bridged(mode="router") as world,
        ros2_peer(world.address, mode="client") as talker,
        ros2_peer(world.address, mode="client") as listener,
    ):
        await listener.request("echo", "subscribed", topic="/chatter", type=STRING)
        await talker.request("stream", "streaming", topic="/chatter", type=STRING, fields={"data": "hello"}, hz=20)
        assert (await listener.read("message"))["data"] == "hello"


async def test_the_end_of_the_bridge_stops_what_ros_2_drives() -> None:
    async with driving() as (world, device, _):
        world.bridge.close()
        assert await zero(device) < LEASE_S / 2 or world.daemon.was_paused


@pytest.fixture
def as_served() -> Iterator[None]:
    """Threads give the interpreter back as often as in `hostlink serve`."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    yield
    sys.setswitchinterval(before_s)


@pytest.mark.quiet
@pytest.mark.parametrize("flooded", [pytest.param("/chatter", marks=pytest.mark.long), "/robot_0/cmd_vel"])
async def test_stop_during_a_flood_of_ros_2_arrives_in_time(flooded: str, as_served: None) -> None:
    type_name, fields = (STRING, {"data": "x" * 100}) if flooded == "/chatter" else (TWIST, {})
    async with (
        bridged() as world,
        fake_device(world.daemon.tcp, robot_topics()) as device,
        ros2_peer(world.address) as flood,
    ):
        received = heard(world, "/chatter", "std_msgs/String")
        await flood.request("stream", "streaming", topic=flooded, type=type_name, fields=fields, hz=0)
        await asyncio.sleep(rmw_bridge.MATCH_S)  # what streams until then may have begun before
        async with ros2_peer(world.address) as peer:
            driven = {"linear": {"x": 0.2}}
            await peer.request("stream", "streaming", topic="/robot_0/cmd_vel", type=TWIST, fields=driven, hz=20)
            assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
            peer.process.kill()
            assert await zero(device) < STOP_S or world.daemon.was_paused
        assert len(received) > 100 or flooded != "/chatter"
        watch = Stopwatch()
        assert (await world.daemon.rest("POST", "/api/stop"))[0] == 200
        assert watch.seconds < LEASE_S


async def test_two_hosts_of_hostlink_do_not_take_each_others_robots_for_those_of_ros_2() -> None:
    async with (
        bridged() as world,
        bridged(connect=(f"tcp/{world.address}",), name="other-host") as other,
        fake_device(world.daemon.tcp, robot_topics()),
    ):
        tokens = list[Token]()
        other.session.subscribe_tokens("@ros2_lv/0/**", tokens.append)
        await expect(lambda: [token for token in tokens if world.session.zid in token.key and "odom/" in token.key])
        await asyncio.sleep(0.1)
        assert other.daemon.hub.topics.find_or_none("/robot_0/odom") is None


async def test_a_robot_of_a_fleet_is_shown_in_ros_2_by_its_own_daemon_alone() -> None:
    address, other = (f"127.0.0.1:{free_port()}" for _ in range(2))
    settings = ZenohSettings(ros2=True, multicast=False, listen=(f"tcp/{address}",), name="a")
    beside = replace(settings, listen=(f"tcp/{other}",), connect=(f"tcp/{address}",), name="b")
    async with (
        daemon(Config(component_settings={"zenoh": settings})) as first,
        daemon(Config(component_settings={"zenoh": beside})) as second,
        fake_device(first.tcp, robot_topics()) as device,
        zenoh_session(address, other) as session,
    ):
        await expect(lambda: second.hub.robots.find("robot_0").link)
        await expect(lambda: second.hub.services.is_offered("/robot_0/lock"))
        tokens: list[str] = []
        async with asyncio.timeout(TIMEOUT_S):
            while len({token.split("/")[2] for token in tokens}) < 2 or not any("%odom/" in each for each in tokens):
                await asyncio.sleep(0.3)
                tokens = await asyncio.to_thread(tokens_of, session)
        assert len([token for token in tokens if "/MP/" in token and "%robot_0%odom/" in token]) == 1
        assert len([token for token in tokens if "/SS/" in token and "%robot_0%lock/" in token]) == 1
        talker = Talker(session, "/robot_0/cmd_vel", TWIST_KEY)
        await known(first.hub, talker)
        await driven(device, talker)


def tokens_of(session: Any) -> list[str]:
    """Return the tokens of all nodes of domain 0."""
    replies = session.liveliness().get("@ros2_lv/0/**", timeout=2.0)
    return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]


def test_a_daemon_without_zenoh_imports_nothing_of_it() -> None:
    text = "import sys, hostlink.cli.serve; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, check=True, text=True)
    loaded = {name for name in done.stdout.split() if name.partition(".")[0] in ("zenoh", "xxhash")}
    assert not loaded
    assert not [name for name in done.stdout.split() if name.startswith("hostlink.components.graphs.")]
