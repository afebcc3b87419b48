"""Calling a service by the client: how long it waits. In virtual time."""

import asyncio

import pytest

from hostlink.errors import HostlinkError
from tests.support.fake_device import service_server
from tests.support.memory_client import memory_host
from tests.support.participants import scene
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import virtual


@virtual
async def test_a_call_waits_as_long_as_it_was_told() -> None:
    async with scene() as made, memory_host(made.hub, made.tasks) as me:
        device = ScriptedDevice(made.hub, service_server("/trigger", "std_srvs/Trigger", 125, 101), address="10.0.0.3")
        await asyncio.sleep(0.5)
        began_s = asyncio.get_running_loop().time()
        with pytest.raises(HostlinkError, match=r"^/trigger: no answer within 2 s$"):
            await me.call("/trigger", {}, timeout_s=2.0)
        assert asyncio.get_running_loop().time() - began_s == pytest.approx(2.0)
        await device.aclose()


@virtual
async def test_service_of_two_blocks_is_answered_by_the_newest_that_lasts() -> None:
    async with scene() as made, memory_host(made.hub, made.tasks) as me, memory_host(made.hub, made.tasks) as other:

        async def said() -> str:
            return str((await other.call("/trigger", {}, timeout_s=2.0))["message"])

        outer = me.serve("/trigger", "std_srvs/Trigger", lambda _: {"message": "outer"})
        inner = me.serve("/trigger", "std_srvs/Trigger", lambda _: {"message": "inner"})
        async with outer:
            async with inner:
                assert await said() == "inner"
            assert await said() == "outer"
        with pytest.raises(HostlinkError, match="no service named /trigger"):
            await said()


@virtual
async def test_topic_of_two_blocks_is_advertised_until_both_have_ended() -> None:
    async with scene() as made, memory_host(made.hub, made.tasks) as me:
        for first_to_end in (0, 1):
            blocks = [me.advertise("/lamp", "std_msgs/Bool", is_latched=True) for _ in range(2)]
            for block in blocks:
                await block.__aenter__()
            await blocks.pop(first_to_end).__aexit__(None, None, None)
            assert made.hub.topics.find("/lamp").publishers
            await blocks.pop().__aexit__(None, None, None)
            assert made.hub.topics.find_or_none("/lamp") is None
