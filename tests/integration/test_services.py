"""Services both ways: one call in flight, a deadline, and an error for each thing that can go wrong."""

import asyncio
import struct

import pytest

from hostlink.errors import DeviceGone, ServiceFailed
from hostlink.hub.services import DeviceService, Services
from hostlink.protocol.frame import Id, encode
from tests.support.daemon import daemon
from tests.support.fake_device import announcement, fake_device, robot_topics, service_client, service_server, topic
from tests.support.virtual_loop import run_virtual
from tests.support.waiting import expect

SET_LED = service_server("/set_led", "std_srvs/SetBool")
TOGGLE = service_client("/toggle", "std_srvs/SetBool")


def answer(message: str, *, success: bool = True) -> bytes:
    """The payload of a SetBool response."""
    return bytes([success]) + struct.pack("<I", len(message)) + message.encode()


async def refused(services: Services, error: type[Exception]) -> None:
    with pytest.raises(error):
        await services.call("/set_led", {"data": True})


async def test_a_program_calls_a_service_of_a_device() -> None:
    async with daemon() as host, fake_device(host.tcp, SET_LED) as device, asyncio.TaskGroup() as tasks:
        call = tasks.create_task(host.hub.services.call("set_led", {"data": True}))
        assert await device.frame(100) == b"\x01"
        await device.send(encode(125, answer("on")))
        assert await call == {"success": True, "message": "on"}


async def test_an_answer_to_a_call_of_before_other_topics_is_not_taken_for_the_next_one_s() -> None:
    """A program on the board advertises one more topic, and negotiates without a restart."""
    more = topic(Id.PUBLISHER, 126, "/battery", "std_msgs/Float32")
    async with daemon() as host, fake_device(host.tcp, SET_LED) as device:
        async with asyncio.TaskGroup() as tasks:
            call = tasks.create_task(refused(host.hub.services, DeviceGone))
            assert await device.frame(100) == b"\x01"
            await device.send(announcement([*SET_LED, more]))
            await call
        async with asyncio.TaskGroup() as tasks:
            again = tasks.create_task(host.hub.services.call("/set_led", {"data": False}))
            await asyncio.sleep(0.05)
            await device.send(encode(125, answer("of before")))
            assert await device.frame(100) == b"\x00"
            await device.send(encode(125, answer("mine")))
            assert (await again)["message"] == "mine"


async def test_a_device_cannot_replace_hostlinks_own_services() -> None:
    lock = [info._replace(name="/robot_0/lock", type="std_srvs/SetBool") for info in SET_LED]
    async with daemon() as host, fake_device(host.tcp, robot_topics()), fake_device(host.tcp, lock) as thief:
        await expect(lambda: len([link for link in host.hub.links.all() if link.session.counts.negotiations]) == 2)
        assert host.hub.services.of_device("/robot_0/lock") is None
        await host.hub.services.call("/robot_0/lock", {})
        assert host.hub.robots.find("robot_0").gate.lock_reason is not None
        await thief.send(encode(125, answer("unasked")))


def test_a_call_occupies_a_device_for_a_minute_at_most() -> None:
    """The request may be lost on the way, and other calls wait."""
    sent: list[float] = []

    async def run() -> list[str]:
        async def outcome(timeout_s: float) -> str:
            try:
                await service.call(b"", timeout_s=timeout_s)
            except ServiceFailed as error:
                return str(error)
            return "answered"

        service = DeviceService("/led", "std_srvs/Empty", None, "it", lambda _: sent.append(now_s()))
        now_s = asyncio.get_running_loop().time
        async with asyncio.TaskGroup() as tasks:
            calls = [tasks.create_task(outcome(timeout_s)) for timeout_s in (1e9, 100.0)]
            return [await call for call in calls]

    assert run_virtual(run()) == ["/led: no answer within 60 s", "/led: no answer within 100 s"]
    assert sent == [0.0, pytest.approx(90.0)]  # half of the turn of the second waits for a late answer to the first


async def test_a_device_calls_a_service_of_another_device() -> None:
    server = [info._replace(name="/toggle") for info in SET_LED]
    async with (
        daemon() as host,
        fake_device(host.tcp, TOGGLE) as caller,
        fake_device(host.tcp, server) as callee,
    ):
        await caller.send(encode(125, b"\x01"))
        assert await callee.frame(100) == b"\x01"
        await callee.send(encode(125, answer("from afar")))
        assert await caller.frame(100) == answer("from afar")
