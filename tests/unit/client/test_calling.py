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
