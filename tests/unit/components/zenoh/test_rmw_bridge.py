"""Topics and services between the hub and ROS 2 by rmw_zenoh's protocol, without a network and in virtual time."""

import asyncio
import itertools
import struct
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from typing import cast

import pytest
from structlog.testing import capture_logs

from hostlink.components.graphs.ros2_qos import Qos
from hostlink.components.graphs.ros2_types import Ros2Types
from hostlink.components.zenoh import rmw_bridge
from hostlink.components.zenoh.rmw_bridge import RmwBridge
from hostlink.components.zenoh.rmw_protocol import (
    LATCHED,
    OWN_ENCLAVE,
    SPACE,
    Attachment,
    EndpointToken,
    NodeToken,
    TokenKind,
    data_key,
    gid_of,
    parse_token,
)
from hostlink.components.zenoh.session import Declaration, Query, ZenohSample, ZenohSession
from hostlink.core.components import supervise
from hostlink.core.host import Component, Host
from hostlink.core.hub.message import Message
from hostlink.core.mirror.inbox import MAX_SOURCES
from tests.support.background import meanwhile
from tests.support.fake_device import CATALOG
from tests.support.hosts import host_of
from tests.support.memory_zenoh import MemoryNetwork, MemorySession
from tests.support.participants import ROBOT, TEXT, TEXT_TYPE, Scene, play
from tests.support.virtual_loop import inside, run_virtual
from tests.support.waiting import expect

TYPES = Ros2Types(CATALOG, "kilted")
USUAL = Qos()
STRING, TWIST, TRIGGER = "std_msgs/msg/String", "geometry_msgs/msg/Twist", "std_srvs/srv/Trigger"
CMD_VEL = f"/{ROBOT}/velocity_commands"


def hash_of(name: str) -> str:
    found = TYPES.message(name)
    assert found is not None
    return found.type_hash


def text(value: str) -> bytes:
    known = CATALOG.message(TEXT_TYPE)
    assert known is not None
    return known.encode({"data": value})


def cdr(value: str) -> bytes:
    found = TYPES.message(TEXT_TYPE)
    assert found is not None
    return found.to_cdr(text(value))


class World:
    """Bridge of a daemon, and a process of ROS 2."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.network = scene, MemoryNetwork()
        self.ros2 = MemorySession(self.network, "aa")
        self._numbers = 0
        session = cast("ZenohSession", MemorySession(self.network, "ff"))
        token = NodeToken(0, "ff", 0, "/", "hostlink_lab", OWN_ENCLAVE)
        self.bridge = RmwBridge(host_of(scene.hub, "zenoh"), session, TYPES, token)
        self.counts = self.bridge.counts

    def own(self, kind: TokenKind) -> dict[str, EndpointToken]:
        """The bridge's endpoints of a kind, by topic or service."""
        tokens = [parse_token(key) for key in self.network.tokens]
        return {
            each.name: each
            for each in tokens
            if isinstance(each, EndpointToken) and each.kind is kind and each.node.session == "ff"
        }

    def declare(
        self, kind: TokenKind, name: str, type_name: str, type_hash: str, qos: Qos = USUAL
    ) -> tuple[Declaration, str]:
        self._numbers += 1
        node = NodeToken(0, "aa", 0, "/", "driver")
        token = EndpointToken(kind, node, self._numbers, name, type_name, type_hash, qos).encode()
        return self.ros2.declare_token(token), token

    async def hear(self, topic: str) -> list[bytes]:
        """Return the list of messages that a program receives on a topic from now on."""
        heard: list[bytes] = []
        self.scene.hub.join("program").subscribe(topic, lambda message: heard.append(message.payload))
        await expect(lambda: topic in self.own(TokenKind.SUBSCRIPTION))
        await asyncio.sleep(0.3)
        return heard

    def read(self, topic: str) -> list[ZenohSample]:
        received: list[ZenohSample] = []
        self.ros2.subscribe(data_key(0, topic, STRING, hash_of(TEXT_TYPE)), received.append, has_history=True)
        return received

    def send(self, topic: str, token: str, data: bytes, number: int, type_name: str = STRING) -> None:
        ros1 = {STRING: TEXT_TYPE, TWIST: "geometry_msgs/Twist"}[type_name]
        source_ns = int((1000.0 + asyncio.get_running_loop().time()) * 1e9)
        attachment = Attachment(number, source_ns, gid_of(token)).encode()
        self.ros2.put(data_key(0, topic, type_name, hash_of(ros1)), data, attachment=attachment)


def with_bridge(test: Callable[[World], Awaitable[None]]) -> None:
    async def run(scene: Scene) -> None:
        world = World(scene)
        await asyncio.sleep(0.3)
        await test(world)
        world.bridge.close()
        assert [key for key in world.network.tokens if "/ff/" in key] == []

    play(run)


def test_topics_of_the_hub_are_declared_and_velocities_are_only_received() -> None:
    async def test(world: World) -> None:
        assert world.own(TokenKind.PUBLISHER)[TEXT].type_name == STRING
        assert world.own(TokenKind.PUBLISHER)[TEXT].qos == Qos()
        assert CMD_VEL not in world.own(TokenKind.PUBLISHER)
        assert CMD_VEL in world.own(TokenKind.SUBSCRIPTION)
        assert TEXT not in world.own(TokenKind.SUBSCRIPTION)
        assert world.own(TokenKind.SERVER)["/neighbour"].type_name == TRIGGER
        world.scene.neighbour.unadvertise(TEXT)
        await asyncio.sleep(0.3)
        assert TEXT not in world.own(TokenKind.PUBLISHER)

    with_bridge(test)


def test_message_of_the_hub_reaches_ros_2_only_while_it_has_a_subscriber() -> None:
    async def test(world: World) -> None:
        world.scene.neighbour.publish(TEXT, text("unread"))
        received = world.read(TEXT)
        await asyncio.sleep(0.1)
        world.scene.neighbour.publish(TEXT, text("read"))
        await asyncio.sleep(0.1)
        assert [sample.payload for sample in received] == [cdr("read")]
        signed = Attachment.decode(received[0].attachment)
        assert signed is not None
        assert signed.sequence_number == 1
        assert signed.gid == gid_of(world.own(TokenKind.PUBLISHER)[TEXT].encode())
        assert world.counts["to_ros2"] == 1

    with_bridge(test)


def test_latched_message_of_the_hub_reaches_later_subscribers() -> None:
    async def test(world: World) -> None:
        program = world.scene.hub.join("program")
        program.advertise("/plan", TEXT_TYPE, is_latched=True)
        await asyncio.sleep(0.3)
        program.publish("/plan", text("kept"))
        await asyncio.sleep(0.1)
        received = world.read("/plan")
        await asyncio.sleep(0.1)
        assert [sample.payload for sample in received] == [cdr("kept")]
        assert world.own(TokenKind.PUBLISHER)["/plan"].qos == LATCHED

    with_bridge(test)


def test_topic_of_ros_2_reaches_a_program_and_ends_with_its_token() -> None:
    async def test(world: World) -> None:
        declaration, token = world.declare(TokenKind.PUBLISHER, "/chatter", STRING, hash_of(TEXT_TYPE))
        heard = await world.hear("/chatter")
        assert world.scene.hub.topics.find("/chatter").type_name == TEXT_TYPE
        world.send("/chatter", token, cdr("hello"), 1)
        await expect(lambda: heard)
        assert heard == [text("hello")]
        assert world.counts["from_ros2"] == 1
        declaration.close()
        await asyncio.sleep(0.3)
        assert not world.scene.hub.topics.find("/chatter").publishers

    with_bridge(test)


def test_latched_topic_of_ros_2_reaches_a_later_program() -> None:
    async def test(world: World) -> None:
        _, token = world.declare(TokenKind.PUBLISHER, "/map", STRING, hash_of(TEXT_TYPE), LATCHED)
        kept = world.ros2.declare_publisher(data_key(0, "/map", STRING, hash_of(TEXT_TYPE)), kept=1)
        kept.put(cdr("map"), attachment=Attachment(1, 5, gid_of(token)).encode())
        await asyncio.sleep(0.3)
        heard = await world.hear("/map")
        assert heard == [text("map")]

    with_bridge(test)


def test_messages_arrive_in_order_while_their_publisher_becomes_known_by_the_gid_that_it_drew() -> None:
    """The first message binds the gid. The last one arrives after that delivery, while two others still wait."""

    async def test(world: World) -> None:
        world.declare(TokenKind.PUBLISHER, "/chatter", STRING, hash_of(TEXT_TYPE))
        heard: list[bytes] = []

        def receive(message: Message) -> None:
            heard.append(message.payload)
            if len(heard) == 1:
                world.send("/chatter", "drawn", cdr("4"), 4)

        world.scene.hub.join("program").subscribe("/chatter", receive)
        await asyncio.sleep(0.3)
        for number in (1, 2, 3):
            world.send("/chatter", "drawn", cdr(str(number)), number)
        await asyncio.sleep(0.1)
        assert heard == [text(each) for each in "1234"]

    with_bridge(test)


def test_publishers_that_are_not_known_share_one_queue_and_cannot_displace_a_known_one() -> None:
    async def test(world: World) -> None:
        _, token = world.declare(TokenKind.PUBLISHER, "/chatter", STRING, hash_of(TEXT_TYPE))
        heard = await world.hear("/chatter")
        world.send("/chatter", token, cdr("1"), 1)
        await asyncio.sleep(0.1)
        for number in range(2 * MAX_SOURCES):
            world.send("/chatter", f"drawn {number}", cdr("flood"), 1)
        world.send("/chatter", token, cdr("2"), 2)
        await asyncio.sleep(0.1)
        assert heard == [text("1"), text("2")]
        assert world.counts["unidentified"] == rmw_bridge.MAX_WAITING

    with_bridge(test)


def test_message_that_is_unsigned_malformed_or_of_an_unknown_publisher_is_counted() -> None:
    async def test(world: World) -> None:
        _, token = world.declare(TokenKind.PUBLISHER, "/chatter", STRING, hash_of(TEXT_TYPE))
        heard = await world.hear("/chatter")
        world.ros2.put(data_key(0, "/chatter", STRING, hash_of(TEXT_TYPE)), cdr("x"), attachment=b"short")
        world.send("/chatter", token, b"\x00\x01\x00\x00\xff", 1)
        world.send("/chatter", token, cdr("x"), 2)
        await asyncio.sleep(0.1)
        world.send("/chatter", "another token", cdr("x"), 1)
        await asyncio.sleep(0.1)
        causes = ("unsigned", "malformed_from_ros2", "unidentified")
        assert [world.counts[cause] for cause in causes] == [1, 1, 1], world.counts
        assert heard == [text("x")], world.counts

    with_bridge(test)


@pytest.mark.parametrize("type_name", [TWIST, "geometry_msgs/msg/TwistStamped"])
def test_velocity_of_ros_2_drives_and_ends_with_its_token(type_name: str) -> None:
    async def test(world: World) -> None:
        ros1 = type_name.replace("/msg/", "/")
        known, ros2 = CATALOG.message(ros1), TYPES.message(ros1)
        assert known is not None
        assert ros2 is not None
        await asyncio.sleep(rmw_bridge.MATCH_S)
        declaration, token = world.declare(TokenKind.PUBLISHER, CMD_VEL, type_name, ros2.type_hash)
        await asyncio.sleep(0.1)
        twist = {"linear": {"x": 0.25}}
        payload = known.encode(twist if type_name == TWIST else {"twist": twist})
        attachment = Attachment(1, int(1e12), gid_of(token)).encode()
        world.ros2.put(data_key(0, CMD_VEL, type_name, ros2.type_hash), ros2.to_cdr(payload), attachment=attachment)
        await asyncio.sleep(0.05)
        assert world.scene.speeds()[-1] == 0.25
        declaration.close()
        await asyncio.sleep(0.05)
        assert world.scene.speeds()[-1] == 0.0

    with_bridge(test)


class Bridging(Component[None]):
    """The bridge over a network in memory, which fails when a test says so."""

    name = "zenoh"

    def __init__(self, network: MemoryNetwork, failure: "asyncio.Queue[Exception]") -> None:
        super().__init__(None)
        self.network, self.failure = network, failure

    async def run(self, host: Host) -> None:
        session = cast("ZenohSession", MemorySession(self.network, "ff"))
        bridge = RmwBridge(host, session, TYPES, NodeToken(0, "ff", 0, "/", "hostlink_lab", OWN_ENCLAVE))
        try:
            raise await self.failure.get()
        finally:
            bridge.close()


@inside(play)
async def test_failure_of_the_bridge_stops_what_ros_2_drives_and_its_next_start_does_not_move_it(scene: Scene) -> None:
    known, ros2 = CATALOG.message("geometry_msgs/Twist"), TYPES.message("geometry_msgs/Twist")
    assert known is not None
    assert ros2 is not None
    network, failure, numbers = MemoryNetwork(), asyncio.Queue[Exception](), itertools.count(1)
    peer = MemorySession(network, "aa")
    key, token = data_key(0, CMD_VEL, TWIST, ros2.type_hash), NodeToken(0, "aa", 0, "/", "driver")
    publisher = EndpointToken(TokenKind.PUBLISHER, token, 1, CMD_VEL, TWIST, ros2.type_hash, USUAL).encode()

    async def stream() -> None:
        while True:
            source_ns = int((1000.0 + asyncio.get_running_loop().time()) * 1e9)
            signed = Attachment(next(numbers), source_ns, gid_of(publisher)).encode()
            peer.put(key, ros2.to_cdr(known.encode({"linear": {"x": 0.25}})), attachment=signed)
            await asyncio.sleep(0.1)

    component = scene.tasks.create_task(supervise(scene.hub, "zenoh", lambda: Bridging(network, failure)))
    await asyncio.sleep(rmw_bridge.MATCH_S + 0.5)
    peer.declare_token(publisher)
    await asyncio.sleep(0.1)
    async with meanwhile(stream()):
        await asyncio.sleep(0.5)
        assert scene.speeds()[-1] == 0.25
        failure.put_nowait(ValueError("a bug"))
        await asyncio.sleep(0.05)
        assert scene.speeds()[-1] == 0.0
        count = len(scene.speeds())
        await asyncio.sleep(5.0)
        assert not any(scene.speeds()[count:])
    await asyncio.sleep(1.0)
    async with meanwhile(stream()):
        await asyncio.sleep(0.5)
        assert scene.speeds()[-1] == 0.25
    component.cancel()
    await asyncio.sleep(0.1)
    assert scene.speeds()[-1] == 0.0
    assert scene.hub.isolation.crashes.pop("component") == 1


def test_zero_among_velocities_that_arrive_together_is_not_skipped() -> None:
    """After a stop, only a zero lets its publisher drive again."""

    async def test(world: World) -> None:
        known, ros2 = CATALOG.message("geometry_msgs/Twist"), TYPES.message("geometry_msgs/Twist")
        assert known is not None
        assert ros2 is not None
        await asyncio.sleep(rmw_bridge.MATCH_S)
        _, token = world.declare(TokenKind.PUBLISHER, CMD_VEL, TWIST, ros2.type_hash)
        await asyncio.sleep(0.1)

        def send(*speeds: float) -> None:
            for speed in speeds:
                numbers.append(speed)
                attachment = Attachment(len(numbers), int(1e12), gid_of(token)).encode()
                payload = ros2.to_cdr(known.encode({"linear": {"x": speed}}))
                world.ros2.put(data_key(0, CMD_VEL, TWIST, ros2.type_hash), payload, attachment=attachment)

        numbers: list[float] = []
        send(0.25)
        await asyncio.sleep(0.05)
        world.scene.hub.robots.find_here(ROBOT).stop(by="a test")
        send(0.25)
        await asyncio.sleep(0.05)
        assert world.scene.speeds()[-1] == 0.0
        send(0.1, 0.0, 0.25)
        await asyncio.sleep(0.05)
        assert world.scene.speeds()[-1] == 0.25

    with_bridge(test)


def test_type_with_another_hash_in_ros_2_is_logged_once() -> None:
    async def test(world: World) -> None:
        with capture_logs() as logs:
            world.declare(TokenKind.PUBLISHER, "/chatter", STRING, "RIHS01_0")
            world.declare(TokenKind.PUBLISHER, "/other", STRING, "RIHS01_0")
            await asyncio.sleep(0.1)
        differing = [line for line in logs if line["event"] == "ros2.type_differs"]
        assert [(line["name"], line["there"]) for line in differing] == [(STRING, "RIHS01_0")]

    with_bridge(test)


def test_publisher_whose_topic_has_another_type_here_is_logged_and_shown_once_it_fits() -> None:
    async def test(world: World) -> None:
        program = world.scene.hub.join("program")
        program.advertise("/chatter", "std_msgs/Bool")
        with capture_logs() as logs:
            world.declare(TokenKind.PUBLISHER, "/chatter", STRING, hash_of(TEXT_TYPE))
            world.declare(TokenKind.PUBLISHER, "/scan", "lab_msgs/msg/Unknown", "RIHS01_0")
            await asyncio.sleep(0.3)
        assert [(line["event"], line["log_level"]) for line in logs if line["event"].startswith("ros2.")] == [
            ("ros2.topic_refused", "warning"),
            ("ros2.type_unknown", "info"),
        ]
        program.leave()
        await asyncio.sleep(0.5)
        assert world.scene.hub.topics.find("/chatter").type_name == TEXT_TYPE

    with_bridge(test)


# -- services ---------------------------------------------------------------------------------------------------------


def trigger_response(*, success: bool, message: str) -> bytes:
    service, ros2 = CATALOG.service("std_srvs/Trigger"), TYPES.service("std_srvs/Trigger")
    assert service is not None
    assert ros2 is not None
    return ros2.response.to_cdr(service.response.encode({"success": success, "message": message}))


async def call(world: World, service: str, data: bytes = b"\x00\x01\x00\x00\x00", number: int = 7) -> list[ZenohSample]:
    token = world.own(TokenKind.SERVER)[service]
    attachment = Attachment(number, 5, b"0123456789abcdef").encode()
    key = data_key(0, service, token.type_name, token.type_hash)
    return await world.ros2.get(key, data, attachment=attachment, timeout_s=5.0)


def test_call_of_ros_2_is_answered_by_the_hub_with_its_number() -> None:
    async def test(world: World) -> None:
        answers = await call(world, "/neighbour")
        assert [each.payload for each in answers] == [trigger_response(success=True, message="here")]
        signed = Attachment.decode(answers[0].attachment)
        assert signed is not None
        assert (signed.sequence_number, signed.gid) == (7, b"0123456789abcdef")
        assert world.counts["calls_from_ros2"] == 1

    with_bridge(test)


def test_failed_call_of_ros_2_is_answered_with_the_reason_and_a_malformed_one_is_not() -> None:
    async def test(world: World) -> None:
        async def refuse(_: Mapping[str, object]) -> Mapping[str, object]:
            raise rmw_bridge.ServiceFailed("/broken", "no power")

        world.scene.neighbour.provide("/broken", "std_srvs/Trigger", refuse)
        await asyncio.sleep(0.3)
        answers = await call(world, "/broken")
        assert [each.payload for each in answers] == [trigger_response(success=False, message="/broken: no power")]
        assert await call(world, "/neighbour", b"\x00") == []
        assert (world.counts["failed_calls"], world.counts["malformed_from_ros2"]) == (1, 1)

    with_bridge(test)


def test_calls_of_one_client_are_bounded_and_freed_by_their_answers() -> None:
    async def test(world: World) -> None:
        async def answer_later(_: Mapping[str, object]) -> Mapping[str, object]:
            await asyncio.sleep(1.0)
            return {"success": True}

        world.scene.neighbour.provide("/slow", "std_srvs/Trigger", answer_later)
        await asyncio.sleep(0.3)
        async with asyncio.TaskGroup() as tasks:
            calls = [tasks.create_task(call(world, "/slow")) for _ in range(rmw_bridge.MAX_CALLS_OF_CLIENT + 2)]
        assert sum(bool(each.result()) for each in calls) == rmw_bridge.MAX_CALLS_OF_CLIENT
        assert world.counts["crowded_calls"] == 2
        assert len(await call(world, "/slow")) == 1

    with_bridge(test)


def test_service_of_ros_2_is_called_by_a_program_until_its_token_ends() -> None:
    async def test(world: World) -> None:
        ros2 = TYPES.service("std_srvs/Trigger")
        assert ros2 is not None
        declaration, _ = world.declare(TokenKind.SERVER, "/reset", TRIGGER, ros2.type_hash, Qos())

        def answer(query: Query) -> None:
            query.reply(trigger_response(success=True, message="reset"), attachment=query.attachment)
            query.close()

        world.ros2.serve(data_key(0, "/reset", TRIGGER, ros2.type_hash), answer)
        await asyncio.sleep(0.1)
        program = world.scene.hub.join("program")
        assert await program.call("/reset", {}) == {"success": True, "message": "reset"}
        assert world.counts["calls_to_ros2"] == 1
        assert "/reset" in world.own(TokenKind.CLIENT)
        declaration.close()
        await asyncio.sleep(0.1)
        assert "/reset" not in world.own(TokenKind.CLIENT)

    with_bridge(test)


@pytest.mark.parametrize(
    ("name", "type_name", "type_hash", "event"),
    [
        ("/reset", TRIGGER, "RIHS01_0", "ros2.type_differs"),
        ("/reset", "lab_msgs/srv/Unknown", "RIHS01_0", "ros2.type_unknown"),
        ("/node/get_parameters", "rcl_interfaces/srv/GetParameters", "RIHS01_0", None),
        ("/_action/send_goal", TRIGGER, "RIHS01_0", None),
    ],
)
def test_service_of_ros_2_that_cannot_be_called_is_not_provided(
    name: str, type_name: str, type_hash: str, event: str | None
) -> None:
    async def test(world: World) -> None:
        with capture_logs() as logs:
            world.declare(TokenKind.SERVER, name, type_name, type_hash, Qos())
            await asyncio.sleep(0.1)
        assert [line["event"] for line in logs if line["event"].startswith("ros2.")] == [event] * (event is not None)
        assert name not in world.own(TokenKind.CLIENT)

    with_bridge(test)


def test_tokens_of_hostlink_itself_and_of_another_domain_are_not_mirrored() -> None:
    async def test(world: World) -> None:
        other = NodeToken(0, "bb", 0, "/", "hostlink_desk", OWN_ENCLAVE)
        world.ros2.declare_token(
            EndpointToken(TokenKind.PUBLISHER, other, 1, "/theirs", STRING, hash_of(TEXT_TYPE), Qos()).encode()
        )
        far = NodeToken(3, "cc", 0, "/", "far")
        world.ros2.declare_token(
            EndpointToken(TokenKind.PUBLISHER, far, 1, "/far", STRING, hash_of(TEXT_TYPE), Qos()).encode()
        )
        world.ros2.declare_token(f"{SPACE}/0/dd/nonsense")
        await asyncio.sleep(0.3)
        assert {"/theirs", "/far"}.isdisjoint(world.scene.hub.topics.names())
        assert world.counts["malformed_tokens"] == 1

    with_bridge(test)


def test_twist_has_48_bytes_at_the_end_of_a_twist_stamped() -> None:
    known = CATALOG.message("geometry_msgs/TwistStamped")
    assert known is not None
    payload = known.encode({"header": {"frame_id": "base"}, "twist": {"angular": {"z": 2.0}}})
    assert struct.unpack("<6d", payload[-rmw_bridge.TWIST_BYTES :])[5] == 2.0


def test_losses_are_logged_as_one_line_in_each_interval() -> None:
    async def test() -> None:
        counts = Counter[str]()
        with capture_logs() as logs:
            watching = asyncio.get_running_loop().create_task(rmw_bridge.log_trouble(counts))
            for unsigned, late in ((3, 0), (0, 0), (2, 1)):
                counts.update({"unsigned": unsigned, "late": late, "from_ros2": 100})
                await asyncio.sleep(rmw_bridge.TROUBLE_INTERVAL_S + 0.1)
            watching.cancel()
        lines = [{name: line[name] for name in line.keys() - {"event", "log_level"}} for line in logs]
        assert lines == [{"unsigned": 3}, {"unsigned": 2, "late": 1}]

    run_virtual(test())
