"""Services of devices and of programs: turns, deadlines, precedence, and what their ends take back."""

import asyncio
from collections.abc import Mapping

import pytest

from hostlink.errors import BadRequest, DeviceBusy, DeviceGone, ServiceFailed, UnknownTopic, WrongType
from hostlink.hub.node import Node
from hostlink.hub.services import MAX_WAITING, DeviceService, Provider, Services
from tests.support.fake_device import CATALOG
from tests.support.virtual_loop import run_virtual, virtual

TRIGGER = "std_srvs/Trigger"


async def answer(_: Mapping[str, object]) -> Mapping[str, object]:
    return {"success": True, "message": "done"}


def device_service(key: object = "link 1", name: str = "/s") -> tuple[DeviceService, list[bytes]]:
    sent: list[bytes] = []
    return DeviceService(name, TRIGGER, CATALOG.service(TRIGGER), key, sent.append), sent


def provider(
    name: str = "/s", key: str = "ann", *, is_daemon: bool = False, notes: list[str] | None = None
) -> Provider:
    return Provider(name, TRIGGER, Node(key, is_daemon=is_daemon), answer, None if notes is None else notes.append)


@virtual
async def test_device_service_sends_one_call_at_a_time_in_order() -> None:
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


@virtual
async def test_call_without_answer_fails_at_its_deadline_and_its_late_answer_is_not_the_next_one_s() -> None:
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


@virtual
async def test_late_answer_that_never_arrives_delays_the_next_call_by_half_its_time() -> None:
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


@virtual
async def test_device_that_leaves_fails_its_calls_and_later_ones() -> None:
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


@virtual
async def test_waiting_calls_of_a_device_service_are_bounded() -> None:
    service, _ = device_service()
    async with asyncio.TaskGroup() as tasks:
        calls = [tasks.create_task(service.call(b"", timeout_s=5.0)) for _ in range(MAX_WAITING + 1)]
        await asyncio.sleep(0.1)
        with pytest.raises(DeviceBusy):
            await service.call(b"", timeout_s=5.0)
        for call in calls:
            call.cancel()


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
    assert found.name == TRIGGER
    assert services.type_of("/b") is device.type
    assert not services.is_reading("/a")
    assert not services.is_reading("/c")


@virtual
async def test_call_encodes_the_request_and_decodes_the_answer_of_a_device() -> None:
    services = Services(CATALOG)
    device, sent = device_service()
    services.add_device_service(device)
    async with asyncio.TaskGroup() as tasks:
        call = tasks.create_task(services.call("/s", {}))
        await asyncio.sleep(0.1)
        assert sent == [b""]
        device.answered(device.type.response.encode({"success": True, "message": "hello"}))
    assert call.result() == {"success": True, "message": "hello"}
    services.add_device_service(DeviceService("/x", "my/Unknown", None, "link 2", sent.append))
    with pytest.raises(WrongType):
        await services.call("/x", {})


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
