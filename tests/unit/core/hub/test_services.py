"""Services of devices and of programs: turns, deadlines, precedence, and what their ends take back."""

import asyncio
import struct
from collections.abc import Mapping

import pytest

from hostlink.core.hub.node import Node
from hostlink.core.hub.services import MAX_WAITING, DeviceService, Provider, Services
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.errors import BadPayload, BadRequest, DeviceBusy, DeviceGone, ServiceFailed, UnknownTopic, WrongType
from tests.support.fake_device import CATALOG, service_server, topic
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.virtual_loop import run_virtual

TRIGGER = "std_srvs/Trigger"
SET_LED = service_server("/set_led", "std_srvs/SetBool")


async def answer(_: Mapping[str, object]) -> Mapping[str, object]:
    return {"success": True, "message": "done"}


def device_service(key: object = "link 1", name: str = "/s") -> tuple[DeviceService, list[bytes]]:
    sent: list[bytes] = []
    return DeviceService(name, TRIGGER, CATALOG.service(TRIGGER), key, sent.append), sent


def provider(
    name: str = "/s", key: str = "ann", *, is_daemon: bool = False, notes: list[str] | None = None
) -> Provider:
    return Provider(name, TRIGGER, Node(key, is_daemon=is_daemon), answer, None if notes is None else notes.append)


def test_device_service_sends_one_call_at_a_time_in_order() -> None:
    async def test() -> None:
        service, sent = device_service()
        async with asyncio.TaskGroup() as tasks:
            first = tasks.create_task(service.call(b"1", timeout_s=5.0))
            second = tasks.create_task(service.call(b"2", timeout_s=5.0))
            await asyncio.sleep(0.1)
            assert sent == [b"1"]
            assert service.is_awaited
            assert service.answered(b"one")
            await asyncio.sleep(0.1)
            assert sent == [b"1", b"2"]
            assert service.answered(b"two")
        assert (first.result(), second.result()) == (b"one", b"two")
        assert not service.is_awaited
        assert not service.answered(b"three")

    run_virtual(test())


def test_call_without_answer_fails_at_its_deadline_and_its_late_answer_is_not_the_next_one_s() -> None:
    async def test() -> None:
        service, _ = device_service()
        loop = asyncio.get_running_loop()
        with pytest.raises(ServiceFailed, match="2"):
            await service.call(b"1", timeout_s=2.0)
        assert loop.time() == pytest.approx(2.0)
        assert service.is_awaited
        async with asyncio.TaskGroup() as tasks:
            second = tasks.create_task(service.call(b"2", timeout_s=4.0))
            await asyncio.sleep(0.5)
            assert not service.answered(b"late")
            await asyncio.sleep(0.1)
            assert service.answered(b"two")
        assert second.result() == b"two"

    run_virtual(test())


def test_call_with_an_identity_waits_for_no_late_answer_and_takes_none() -> None:
    async def test() -> None:
        numbers = iter((b"1", b"2"))
        service = DeviceService("/s", TRIGGER, CATALOG.service(TRIGGER), "link 1", lambda _: next(numbers))
        loop = asyncio.get_running_loop()
        with pytest.raises(ServiceFailed, match="2"):
            await service.call(b"", timeout_s=2.0)
        assert not service.is_awaited
        began_s = loop.time()
        async with asyncio.TaskGroup() as tasks:
            second = tasks.create_task(service.call(b"", timeout_s=4.0))
            await asyncio.sleep(0.1)
            assert not service.is_awaited
            assert not service.answered(b"late", b"1")
            assert service.answered(b"two", b"2")
        assert second.result() == b"two"
        assert loop.time() - began_s < 0.2
        assert not service.answered(b"two", b"2")

    run_virtual(test())


@pytest.mark.parametrize("identity", [b"1", None])
def test_call_whose_answer_is_refused_fails_at_once_with_the_reason(identity: bytes | None) -> None:
    async def test() -> None:
        service = DeviceService("/s", TRIGGER, CATALOG.service(TRIGGER), "link 1", lambda _: identity)
        loop = asyncio.get_running_loop()
        reason = BadPayload("std_srvs/TriggerResponse", "3 bytes follow")
        assert not service.refused(reason, identity)
        loop.call_later(0.1, lambda: service.refused(reason, b"0"))
        loop.call_later(0.2, service.refused, reason, identity)
        with pytest.raises(BadPayload, match="3 bytes follow"):
            await service.call(b"", timeout_s=2.0)
        assert loop.time() == pytest.approx(0.2)
        assert not service.refused(reason, identity)

    run_virtual(test())


def test_late_answer_that_never_arrives_delays_the_next_call_by_half_its_time() -> None:
    async def test() -> None:
        service, sent = device_service()
        with pytest.raises(ServiceFailed):
            await service.call(b"1", timeout_s=1.0)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(service.call(b"2", timeout_s=4.0))
            await asyncio.sleep(1.9)
            assert sent == [b"1"]
            await asyncio.sleep(0.2)
            assert sent == [b"1", b"2"]
            service.answered(b"two")

    run_virtual(test())


def test_device_that_leaves_fails_its_calls_and_later_ones() -> None:
    async def test() -> None:
        service, _ = device_service()
        async with asyncio.TaskGroup() as tasks:

            async def call() -> None:
                with pytest.raises(DeviceGone):
                    await service.call(b"1", timeout_s=5.0)

            tasks.create_task(call())
            await asyncio.sleep(0.1)
            service.close()
        with pytest.raises(DeviceGone):
            await service.call(b"2", timeout_s=5.0)

    run_virtual(test())


def test_waiting_calls_of_a_device_service_are_bounded() -> None:
    async def test() -> None:
        service, _ = device_service()
        async with asyncio.TaskGroup() as tasks:
            calls = [tasks.create_task(service.call(b"", timeout_s=5.0)) for _ in range(MAX_WAITING + 1)]
            await asyncio.sleep(0.1)
            with pytest.raises(DeviceBusy):
                await service.call(b"", timeout_s=5.0)
            for call in calls:
                call.cancel()

    run_virtual(test())


def test_daemon_s_service_precedes_a_device_s_and_that_a_program_s() -> None:
    services = Services(CATALOG)
    device, _ = device_service()
    notes: list[str] = []
    services.provide(provider(notes=notes))
    assert services.find("s").key.name == "ann"  # type: ignore[attr-defined]
    services.add_device_service(device)
    assert services.find("/s") is device
    assert notes == ["/s: link 1 offers it too and gets the calls, as long as it is there"]
    services.provide(provider(key="bob", notes=notes))
    assert notes[1:] == ["/s is a service of a device's, which gets the calls"]
    services.leave("link 1")
    assert services.find("/s").key.name == "bob"  # type: ignore[attr-defined]
    services.add_device_service(device)
    services.provide(provider(key="hostlink", is_daemon=True))
    assert services.of_device("/s") is None
    with pytest.raises(BadRequest, match="hostlink's own"):
        services.provide(provider(key="carol"))
    with pytest.raises(BadRequest, match="hostlink's own"):
        services.add_device_service(device_service()[0])


def test_newest_offer_of_a_name_gets_the_calls_until_it_is_withdrawn() -> None:
    services, notes = Services(CATALOG), list[str]()
    ann, bob = provider(notes=notes), provider(key="bob")
    services.provide(ann)
    services.provide(ann)
    assert notes == []
    services.provide(bob)
    assert notes == ["/s: bob offers it too and gets the calls, as long as it is there"]
    assert services.provider("/s") is bob
    services.withdraw("s", bob.key)
    services.withdraw("/s", bob.key)
    assert services.provider("/s") is ann
    services.leave(ann.key)
    assert not services.is_offered("/s")
    assert list(services.names()) == []
    with pytest.raises(UnknownTopic):
        services.find("/s")


def test_services_are_listed_by_name_with_type_and_link() -> None:
    services = Services(CATALOG)
    device, _ = device_service(name="/b")
    services.add_device_service(device)
    services.provide(provider("/a"))
    assert services.all() == [("/a", TRIGGER), ("/b", TRIGGER)]
    found = services.type_of("/a")
    assert found is not None
    assert found.name == TRIGGER
    assert services.type_of("/b") is device.type
    assert not services.is_reading("/a")
    assert not services.is_reading("/c")


def test_call_encodes_the_request_and_decodes_the_answer_of_a_device() -> None:
    async def test() -> None:
        services = Services(CATALOG)
        device, sent = device_service()
        services.add_device_service(device)
        async with asyncio.TaskGroup() as tasks:
            call = tasks.create_task(services.call("/s", {}))
            await asyncio.sleep(0.1)
            assert sent == [b""]
            assert device.type is not None
            device.answered(device.type.response.encode({"success": True, "message": "hello"}))
        assert call.result() == {"success": True, "message": "hello"}
        services.add_device_service(DeviceService("/x", "my/Unknown", None, "link 2", sent.append))
        with pytest.raises(WrongType):
            await services.call("/x", {})

    run_virtual(test())


def test_provider_that_does_not_answer_fails_at_the_deadline_or_when_it_is_withdrawn() -> None:
    async def never(_: Mapping[str, object]) -> Mapping[str, object]:
        await asyncio.sleep(1000.0)
        return {}

    async def test() -> None:
        services = Services(CATALOG)
        slow = Provider("/s", TRIGGER, Node("ann"), never)
        services.provide(slow)
        loop = asyncio.get_running_loop()
        with pytest.raises(ServiceFailed):
            await services.call("/s", {})
        assert loop.time() == pytest.approx(60.0)
        with pytest.raises(ServiceFailed):
            await services.call("/s", {}, timeout_s=2.0)
        assert loop.time() == pytest.approx(62.0)
        loop.call_later(1.0, lambda: services.withdraw("/s", slow.key))
        with pytest.raises(UnknownTopic):
            await services.call("/s", {})
        assert loop.time() == pytest.approx(63.0)

    run_virtual(test())


def test_bug_of_a_provider_ends_it_and_is_the_caller_s_failure() -> None:
    async def crash(_: Mapping[str, object]) -> Mapping[str, object]:
        raise ZeroDivisionError("division by zero")

    async def refuse(_: Mapping[str, object]) -> Mapping[str, object]:
        raise BadRequest("not now")

    async def test() -> None:
        failed: list[Exception] = []
        services = Services(CATALOG)
        services.provide(Provider("/s", TRIGGER, Node("ann"), crash, fail=failed.append))
        with pytest.raises(ServiceFailed, match="ZeroDivisionError: division by zero"):
            await services.call("/s", {})
        assert len(failed) == 1
        services.provide(Provider("/s", TRIGGER, Node("ann"), refuse, fail=failed.append))
        with pytest.raises(BadRequest, match="not now"):
            await services.call("/s", {})
        assert len(failed) == 1

    run_virtual(test())


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


def test_answer_to_a_call_from_before_other_topics_is_not_that_of_the_next_call() -> None:
    """A program on the board advertises one more topic, and negotiates without a restart."""

    async def test(made: MemoryHub) -> None:
        device = await made.connect(SET_LED)
        loop = asyncio.get_running_loop()
        before = loop.create_task(made.hub.services.call("/set_led", {"data": True}))
        await asyncio.sleep(0.05)
        device.infos.append(topic(EndpointKind.PUBLISHER, 126, "/battery", "std_msgs/Float32"))
        await device.announce()
        with pytest.raises(DeviceGone):
            await before
        call = loop.create_task(made.hub.services.call("/set_led", {"data": False}))
        await asyncio.sleep(0.05)
        await device.send(125, led_answer("of before"))
        await asyncio.sleep(0.05)
        assert device.payloads(100) == [b"\x01", b"\x00"]
        await device.send(125, led_answer("mine"))
        assert (await call)["message"] == "mine"

    in_hub(test)


def led_answer(message: str) -> bytes:
    """Return the payload of a SetBool response."""
    return b"\x01" + struct.pack("<I", len(message)) + message.encode()
