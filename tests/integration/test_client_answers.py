"""Results of a script's own calls: refusals, names, and numpy numbers as arguments."""

import contextlib
from collections.abc import AsyncIterator, Mapping
from typing import Any

import numpy as np
import pytest

from hostlink.client import Host, connect, connection
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.errors import HostlinkError
from tests.support.daemon import Daemon, daemon
from tests.support.driving import hold
from tests.support.fake_device import FakeDevice, fake_device, robot_topics, topic
from tests.support.waiting import TIMEOUT_S

LED = topic(EndpointKind.SUBSCRIBER, 110, "/led", "std_msgs/Bool")
ARRAY = topic(EndpointKind.SUBSCRIBER, 111, "/array", "std_msgs/Float32MultiArray")


@pytest.fixture(autouse=True)
def _hears_late_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the connection while another process has the processor: client and daemon share the loop of the test."""
    monkeypatch.setattr(connection, "SILENCE_S", TIMEOUT_S)


@contextlib.asynccontextmanager
async def world() -> AsyncIterator[tuple[Daemon, FakeDevice, Host]]:
    async with (
        daemon() as host,
        fake_device(host.tcp, [*robot_topics(), LED, ARRAY]) as device,
        connect(host.url) as me,
    ):
        yield host, device, me


async def test_a_refused_message_is_raised_by_settle_and_then_forgotten() -> None:
    async with world() as (_, _, me):
        await me.publish("/led", {"dta": True})
        await me.publish("/nobody", {"data": True})
        with pytest.raises(HostlinkError, match=r"dta.*; .*nobody"):
            await me.settle()
        await me.settle()


async def test_a_refused_message_is_raised_at_the_end_of_the_block() -> None:
    async with daemon() as host, fake_device(host.tcp, [LED]):
        with pytest.raises(HostlinkError, match="dta"):
            async with connect(host.url) as me:
                await me.publish("/led", {"dta": True})


async def publish_and_fail(url: str) -> None:
    async with connect(url) as me:
        await me.publish("/led", {"dta": True})
        raise ZeroDivisionError


async def test_exception_of_the_block_takes_precedence_over_a_refusal() -> None:
    async with daemon() as host, fake_device(host.tcp, [LED]):
        with pytest.raises(ZeroDivisionError):
            await publish_and_fail(host.url)


async def test_numbers_and_arrays_of_numpy_are_published_driven_and_called() -> None:
    async with world() as (_, device, me):
        await me.publish("/array", {"data": np.array([0.5, 1.5])})
        assert np.frombuffer((await device.frame(111))[-8:], "<f4").tolist() == [0.5, 1.5]
        await hold(me.robot("robot_0"), np.float32(0.25), np.int64(0))
        assert await device.velocity_other_than((0.0, 0.0)) == (0.25, 0.0)
        assert "/led" in (await me.call("/rosapi/topics"))["topics"]  # no body
        await me.call("/rosapi/set_param", {"name": "gain", "value": str(np.float64(2.0))})
        assert (await me.call("/rosapi/get_param", {"name": "gain"}))["value"] == "2.0"
        with pytest.raises(HostlinkError, match="a message cannot contain a object"):
            await me.publish("/array", {"data": object()})
        await me.settle()


async def test_a_service_is_answered_by_a_plain_function_and_a_wrong_answer_fails_the_call() -> None:
    def switch(request: Mapping[str, Any]) -> dict[str, Any]:
        return {"success": np.bool_(request["data"]), "message": "switched"}

    async with world() as (host, _, me), connect(host.url) as other:
        async with me.serve("/switch", "std_srvs/SetBool", switch):
            await me.settle()
            assert await other.call("/switch", {"data": True}) == {"success": True, "message": "switched"}
        async with (
            me.serve("/nothing", "std_srvs/Empty", lambda _: None),
            me.serve("/wrong", "std_srvs/SetBool", lambda _: {"message": object()}),
        ):
            await me.settle()
            assert await other.call("/nothing") == {}
            with pytest.raises(HostlinkError, match="a message cannot contain a object"):
                await other.call("/wrong")


async def test_a_service_that_is_offered_again_is_not_ended_by_the_first_offer() -> None:
    async with world() as (host, _, me), connect(host.url) as other:
        first = me.serve("/name", "std_srvs/Trigger", lambda _: {"message": "first"})
        await first.__aenter__()
        async with me.serve("/name", "std_srvs/Trigger", lambda _: {"message": "second"}):
            await first.__aexit__(None, None, None)
            await me.settle()
            assert (await other.call("/name"))["message"] == "second"
        await me.settle()
        with pytest.raises(HostlinkError, match="/name"):
            await other.call("/name")


async def test_printed_view_has_field_names() -> None:
    async with world() as (host, _, me):
        assert repr(me) == f"<Host {host.url}: connected>"
        assert repr(me.robot("robot_0")) == f"<Robot robot_0 at {host.url}, priority 50>"
        async with me.subscribe("/chat", type_name="std_msgs/String") as messages:
            await me.publish("/chat", {"data": "hello"})
            await me.settle()
            assert repr(messages) == "<Mailbox of /chat: 1 waiting, 0 dropped>"
    assert repr(me) == f"<Host {host.url}: not connected>"
