"""The daemon as a node of ROS 1, against a master and nodes that do wrong."""

import contextlib
import dataclasses
import gzip
import struct
from collections.abc import AsyncIterator

import aiohttp
import pytest

from hostlink.components.ros1 import node
from hostlink.components.ros1.local_node import Rpc
from hostlink.components.ros1.settings import Ros1Config
from hostlink.components.ros1.xml_rpc import CallRefused, Unreachable, decode_answer, encode_answer, encode_call
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import encode
from tests.support.fake_device import CATALOG, fake_device, pose, topic
from tests.support.ros1.fake import connection, fake_master, xml_rpc_server
from tests.support.ros1.scene import ODOMETRY, STRING, SUBSCRIBER, Scene, plain_scene, scene
from tests.support.waiting import expect

SENT = 768  # messages of 19 kB, of which 8 MiB wait for a slow subscriber


@pytest.fixture
async def made() -> AsyncIterator[Scene]:
    async with plain_scene() as made:
        yield made


# -- who connects -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "data",
    [b"\xff\xff\xff\xff" * 100, b"\x04\x00\x00\x00\xff\xff\xff\xff", b"\x01"],
    ids=["four gigabytes", "no fields", "cut off"],
)
async def test_bytes_that_are_not_a_header_are_refused(
    made: Scene, data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(node, "HEADER_TIMEOUT_S", 0.2)
    async with connection(await made.tcpros()) as client:
        await client.send(data)
        await client.send(data)
        await expect(lambda: made.counts["refused_headers"] == 1)
        assert await client.is_closed()
    assert made.daemon.hub.isolation.crashes == {}


async def test_a_header_for_what_is_not_here_is_answered_with_the_reason(made: Scene) -> None:
    async with connection(await made.tcpros(), **{**SUBSCRIBER, "topic": "/nothing"}) as client:
        assert "no topic /nothing" in (await client.read_header())["error"]
        assert await client.is_closed()
    assert made.counts["refused_headers"] == 1


async def test_connections_without_a_header_keep_no_subscriber_out() -> None:
    """The oldest of these connections is closed as soon as a node connects, not after the deadline for its header."""
    async with fake_master() as master, scene(master, max_connections=4) as made, contextlib.AsyncExitStack() as stack:
        address = await made.tcpros()
        silent = [await stack.enter_async_context(connection(address)) for _ in range(4)]
        await expect(lambda: len(made.daemon.hub.links.all()) == 1)
        for _ in range(3):
            subscriber = await stack.enter_async_context(connection(address, **SUBSCRIBER))
            assert "error" not in await subscriber.read_header()
        assert all([await each.is_closed() for each in silent[:3]])
        assert made.counts["refused_connections"] == 3


async def test_slave_api_peer_outside_allow_list_is_disconnected() -> None:
    async with fake_master() as master, scene(master, allow=("127.0.0.9/32",)) as made:
        await master.knows("Publisher", ODOMETRY)
        with pytest.raises((aiohttp.ServerDisconnectedError, aiohttp.ClientOSError)):
            await master.call("getPid", "/x")
        assert made.counts["refused_connections"] >= 1


# -- who is slow ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
async def test_a_subscriber_that_never_reads_costs_the_others_nothing(made: Scene) -> None:
    """The subscriber has a bounded queue. The oldest message is dropped and counted, and the newest is sent later."""
    wide = topic(EndpointKind.PUBLISHER, 126, "/blob", STRING, buffer_bytes=20_000)
    async with fake_device(made.daemon.tcp, [wide], local_host="127.0.0.3") as device:
        await made.master.knows("Publisher", "/blob")
        string = CATALOG.message(STRING)
        assert string is not None
        header = {"callerid": "/slow", "topic": "/blob", "type": STRING, "md5sum": string.md5}
        address = await made.tcpros()
        async with (
            connection(address, **header) as slow,
            connection(address, **{**header, "callerid": "/good"}) as good,
        ):
            assert await slow.read_header()
            assert await good.read_header()
            slow.writer.transport.pause_reading()  # type: ignore[attr-defined]
            for number in range(SENT):
                payload = string.encode({"data": f"{number:08}" + "x" * 19_000})
                await device.send(encode(126, payload))
                assert await good.read() == payload
            slow.writer.transport.resume_reading()  # type: ignore[attr-defined]
            numbers = [int((await slow.read())[4:12])]
            while numbers[-1] != SENT - 1:
                numbers.append(int((await slow.read())[4:12]))
            assert numbers == sorted(numbers)
            assert len(numbers) < 0.9 * SENT
        await expect(lambda: made.counts["dropped_to_slow_subscribers"] == SENT - len(numbers))


# -- the slave API ----------------------------------------------------------------------------------------------------


async def test_a_body_over_the_bound_is_refused(made: Scene) -> None:
    await made.master.knows("Publisher", ODOMETRY)
    assert b"methodResponse" not in await made.master.call("", body=bytes(262_100) + b"more than fits" * 10)


async def test_body_that_expands_is_refused(made: Scene) -> None:
    await made.master.knows("Publisher", ODOMETRY)
    body = gzip.compress(encode_call("getPid", ("/x",)))
    with pytest.raises(CallRefused):
        decode_answer(await made.master.call("", body=body, headers={"Content-Encoding": "gzip"}))
    assert made.counts["refused_calls"] == 1


async def test_answer_that_expands_is_refused() -> None:
    rpc = Rpc()
    try:
        async with xml_rpc_server(lambda *_: gzip.compress(encode_answer(1, "", 5)), encoding="gzip") as uri:
            with pytest.raises(Unreachable):
                await rpc.call(uri, "getPid", "/x")
    finally:
        await rpc.aclose()


def test_a_list_of_a_thousand_publishers_fits() -> None:
    uris = [f"http://a-robot-of-some-length.local:{port}/" for port in range(50_000, 51_000)]
    assert len(encode_call("publisherUpdate", ("/master", "/text", uris))) < node.MAX_BODY_BYTES


# -- the master -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("garbled", [b"<html>", b"<a>" * 3_000_000])
async def test_a_master_that_answers_garbage_is_lost_and_found_again(made: Scene, garbled: bytes) -> None:
    await made.master.knows("Publisher", ODOMETRY)
    async with connection(await made.tcpros(), **SUBSCRIBER) as listener:
        await listener.read_header()
        made.master.garbled, count = garbled, len(made.master.calls)
        await expect(lambda: len(made.master.calls) > count)
        await made.robot.send(pose(1.0))
        assert await listener.read() == struct.pack("<3d", 1.0, 0, 0)
        made.master.garbled, made.master.node_uri = None, None
        made.master.registered.clear()
        await made.master.knows("Publisher", ODOMETRY)
    assert made.daemon.hub.isolation.crashes == {}
    assert made.counts["re_registrations"] == 1


async def test_another_node_that_the_master_has_under_this_name_ends_this_one(made: Scene) -> None:
    await made.master.knows("Publisher", ODOMETRY)
    made.master.node_uri = made.master.other_uri = "http://127.0.0.1:1/"
    await expect(lambda: made.daemon.hub.links.parameter_source is None)
    assert made.daemon.hub.robots.find("robot_0").link is not None


# -- its own address --------------------------------------------------------------------------------------------------


async def test_a_node_with_an_address_of_ipv6_answers_there() -> None:
    async with fake_master() as master, scene(master, host="::1") as made:
        address = await made.tcpros()
        assert address[0] == "::1"
        async with connection(address, **SUBSCRIBER) as listener:
            assert "error" not in await listener.read_header()


# -- its own settings -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings",
    [
        {"master": "localhost:11311"},
        {"master": "https://localhost"},
        {"master": "http://localhost:99999"},
        {"master": "http://localhost:abc"},
        {"master": "http://localhost:0"},
        {"name": "a b"},
        {"name": "/a"},
        {"name": ""},
        {"namespace": "a b"},
        {"namespace": "1a"},
        {"allow": ("lan",)},
        {"max_connections": 0},
    ],
)
def test_a_setting_that_cannot_be(settings: dict[str, object]) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - each has a text of its own
        dataclasses.replace(Ros1Config(), **settings)  # type: ignore[arg-type]
