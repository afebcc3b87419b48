"""Topics of micro-ROS boards at a whole daemon whose type changes, or has no definition: what programs get of them."""

import asyncio
import struct
from pathlib import Path

from mcap.reader import make_reader

from hostlink.client import connect
from hostlink.components.recorder.settings import RecordingConfig
from tests.integration.test_micro_ros import CONFIG, address_of
from tests.support.daemon import Daemon, daemon
from tests.support.waiting import TIMEOUT_S, expect
from tests.support.xrce_board import Client, Talker
from tests.support.xrce_device import udp_board

OWN = "my_msgs::msg::dds_::Own_"
STRING, INT32 = "std_msgs::msg::dds_::String_", "std_msgs::msg::dds_::Int32_"


def talker(type_: str = OWN) -> Talker:
    return Talker(Client(key=b"\1\2\3\4"), ("rt/talk", type_), ("rt/listen", type_))


async def announced(host: Daemon, type_name: str) -> None:
    """Wait until the hub knows the topic with this type."""
    topics = host.hub.topics
    await expect(lambda: (found := topics.find_or_none("/talk")) is not None and found.type_name == type_name)


async def subscribed(host: Daemon) -> None:
    """Wait until a program or a recorder subscribes to the topic."""
    await expect(lambda: len(host.hub.topics.find("/talk").subscribers) > 0)


async def test_program_gets_fields_of_the_new_type_after_a_board_has_changed_it() -> None:
    program = talker(STRING)
    async with daemon(CONFIG) as host, udp_board(address_of(host, "udp"), program), connect(host.url) as me:
        await announced(host, "std_msgs/String")
        async with me.subscribe("/talk") as messages, asyncio.timeout(TIMEOUT_S):
            await subscribed(host)
            program.publish(struct.pack("<I4s", 4, b"abc\0"))
            assert await anext(messages) == {"data": "abc"}
            program.change_type(INT32)
            program.publish(struct.pack("<i", 7))
            assert await anext(messages) == {"data": 7}
        assert host.hub.topics.find("/talk").type_name == "std_msgs/Int32"


async def test_message_of_an_unknown_type_is_cdr_in_the_graph_to_programs_and_to_another_board() -> None:
    sender, taker = talker(), Talker(Client(key=b"\5\6\7\x08"), ("rt/answer", OWN), ("rt/talk", OWN))
    async with (
        daemon(CONFIG) as host,
        udp_board(address_of(host, "udp"), sender),
        udp_board(address_of(host, "udp"), taker),
        connect(host.url) as me,
        asyncio.timeout(TIMEOUT_S),
    ):
        await announced(host, "my_msgs/Own")
        await expect(lambda: host.hub.topics.find("/talk").devices)
        async for graph in await me.watch_graph():
            found = {each["name"]: each["encoding"] for each in graph["topics"]}
            if found.keys() >= {"/talk", "/listen", "/answer"}:
                break
        assert [found[each] for each in ("/talk", "/listen", "/answer")] == ["cdr"] * 3
        async with me.subscribe_raw("/talk") as messages:
            await subscribed(host)
            sender.publish(b"seven\0\0\0")
            message = await anext(messages)
        assert (message.payload, message.encoding) == (b"\0\1\0\0seven\0\0\0", "cdr")
        await expect(lambda: taker.taken)
        assert taker.taken == [b"seven\0\0\0"]


def recorded(folder: Path) -> tuple[str, str, str, bytes, bytes]:
    """The only message of the topic in the only file, and what the file says about it."""
    (file,) = folder.glob("*.mcap")
    with file.open("rb") as opened:
        ((schema, channel, message),) = make_reader(opened).iter_messages(topics=["/talk"])
    assert schema is not None
    return channel.message_encoding, schema.name, schema.encoding, schema.data, message.data


async def test_recording_of_an_unknown_type_says_that_its_bytes_are_cdr(tmp_path: Path) -> None:
    program = talker()
    config = CONFIG.with_tables(recording=RecordingConfig(folder=tmp_path, min_free_disk_mb=0.0))
    async with daemon(config) as host, udp_board(address_of(host, "udp"), program):
        await announced(host, "my_msgs/Own")
        _, view = await host.rest("POST", "/api/recordings", b"{}")
        await subscribed(host)
        program.publish(b"seven")
        await expect(lambda: host.hub.topics.find("/talk").messages)
        status, _ = await host.rest("POST", f"/api/recordings/{view['name']}/stop")
        assert status == 200
    assert recorded(tmp_path) == ("cdr", "my_msgs/msg/Own", "", b"", b"\0\1\0\0seven")
