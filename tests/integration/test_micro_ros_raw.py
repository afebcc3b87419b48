"""Topics of micro-ROS boards at a whole daemon whose type changes, or has no definition: what programs get of them."""

import asyncio
import struct

from hostlink.client import connect
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


async def test_program_gets_fields_of_the_new_type_after_a_board_has_changed_it() -> None:
    program = talker(STRING)
    async with daemon(CONFIG) as host, udp_board(address_of(host, "udp"), program), connect(host.url) as me:
        await announced(host, "std_msgs/String")
        async with me.subscribe("/talk") as messages, asyncio.timeout(TIMEOUT_S):
            program.publish(struct.pack("<I4s", 4, b"abc\0"))
            assert await anext(messages) == {"data": "abc"}
            program.change_type(INT32)
            program.publish(struct.pack("<i", 7))
            assert await anext(messages) == {"data": 7}
        assert host.hub.topics.find("/talk").type_name == "std_msgs/Int32"
