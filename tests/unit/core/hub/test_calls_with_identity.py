"""Calls of devices whose requests have an identity: a device receives the answer to each one under its identity.

The device speaks the protocol of text lines, and calls a service of the host by the line `ASK 7 1`: identity, data. It
is answered by `ANSWER 7 True text`. `HELLO` has the names of the services that it calls.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping
from typing import ClassVar

import pytest

from hostlink.core.config import Config
from hostlink.core.hub.device_calls import MAX_CALLS, MAX_WAITING
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.services import DEVICE_TIMEOUT_S, Provider
from hostlink.core.hub.shared import draw_call
from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.session import DeviceSession
from hostlink.errors import BadPayload, FrameTooLarge
from tests.support.fake_device import CATALOG, service_type
from tests.support.memory_transport import MemoryTransport, memory_pair
from tests.support.ros_lib_device import running_hub
from tests.support.text_protocol import TextProtocol, TextSession
from tests.support.virtual_loop import run_virtual, virtual

SET_BOOL = "std_srvs/SetBool"
RESPONSE = service_type(SET_BOOL).response


class CallingSession(TextSession):
    """A session whose device calls services. `has_identity`: of its requests."""

    has_identity = True

    def __init__(self) -> None:
        super().__init__(uart_bytes_s=None)
        self._waiting: set[bytes] = set()

    def _read(self, words: list[str], now_s: float, found: list[events.Event]) -> bool:
        match words:
            case ["HELLO", name, *services]:
                super()._read(["HELLO", name], now_s, [])
                self._topics += tuple(
                    DeviceEndpoint(kind, number, f"/{each}", SET_BOOL)
                    for number, each in enumerate(services, start=2)
                    for kind in (EndpointKind.SERVICE_CLIENT_PUBLISHER, EndpointKind.SERVICE_CLIENT_SUBSCRIBER)
                )
                self._waiting.clear()
                found.append(events.TopicsNegotiated(self._topics, is_changed=True, gap_at=None))
            case ["ASK", identity, data, *service]:
                kind = EndpointKind.SERVICE_CLIENT_PUBLISHER
                called = [each for each in self._topics if each.kind is kind and each.name in (service or [each.name])]
                request = identity.encode() if self.has_identity else None
                self._waiting.add(identity.encode())
                found.append(events.ServiceRequested(called[0], bytes((int(data),)), request))
            case _:
                return super()._read(words, now_s, found)
        return True

    def response_endpoint(self, request: DeviceEndpoint) -> DeviceEndpoint:
        return request._replace(kind=EndpointKind.SERVICE_CLIENT_SUBSCRIBER)

    def room_bytes(self, endpoint: DeviceEndpoint) -> int:  # noqa: ARG002 - of every endpoint
        return 256

    def respond(self, response: DeviceEndpoint, payload: bytes | None, *, request: bytes | None = None) -> None:
        assert payload is not None
        assert request in self._waiting
        self._waiting.remove(request)
        self._write(response, request, payload)

    def is_waiting_for(self, service: DeviceEndpoint, request: bytes) -> bool:  # noqa: ARG002 - each is unique
        return request in self._waiting

    def _write(self, response: DeviceEndpoint, request: bytes, payload: bytes) -> None:
        values = RESPONSE.decode(payload)
        line = f"ANSWER {request.decode()} {values['success']} {values['message']}\n"
        self.outbox.put_reply(response.name, line.encode())


class OrderedSession(CallingSession):
    """A session of the interface before requests had an identity."""

    has_identity = False

    def respond(self, response: DeviceEndpoint, payload: bytes | None) -> None:  # type: ignore[override]
        assert payload is not None
        self._write(response, b"-", payload)


class CallingProtocol(TextProtocol):
    def __init__(self, session: type[CallingSession]) -> None:
        self._session = session

    def session(self, *_: object, **__: object) -> DeviceSession:
        return self._session()


class ServingSession(CallingSession):
    """A session whose device has the service /led: it hears `CALL 1`, and answers `RIGHT 1` or `WRONG 1`."""

    calls = 0

    def _read(self, words: list[str], now_s: float, found: list[events.Event]) -> bool:
        led = DeviceEndpoint(EndpointKind.SERVICE_SERVER_PUBLISHER, 9, "/led", SET_BOOL)
        match words:
            case ["RIGHT", identity]:
                payload = RESPONSE.encode({"success": True, "message": identity})
                found.append(events.ServiceResponded(led, payload, identity.encode()))
            case ["WRONG", identity]:
                reason = BadPayload(RESPONSE.name, "37 bytes")
                found.append(events.ResponseRefused(led, reason, identity.encode()))
            case ["HELLO", name]:
                super()._read(["HELLO", name], now_s, [])
                self._topics += (led, led._replace(kind=EndpointKind.SERVICE_SERVER_SUBSCRIBER))
                found.append(events.TopicsNegotiated(self._topics, is_changed=True, gap_at=None))
            case _:
                return super()._read(words, now_s, found)
        return True

    def call(self, service: str, payload: bytes) -> bytes:
        assert (service, payload) == ("/led", b"\1")
        self.calls += 1
        self.outbox.put_call(service, f"CALL {self.calls}\n".encode())
        return str(self.calls).encode()


class Program:
    """Answers each call after so many seconds."""

    def __init__(self, *delays_s: float) -> None:
        self.executed: list[object] = []
        self._delays_s = list(delays_s)

    async def answer(self, request: Mapping[str, object]) -> Mapping[str, object]:
        number = len(self.executed)
        self.executed.append(request["data"])
        await asyncio.sleep(self._delays_s[min(number, len(self._delays_s) - 1)])
        return {"success": request["data"], "message": f"execution {number}"}


@contextlib.asynccontextmanager
async def device(
    program: Program, session: type[CallingSession] = CallingSession, services: str = "ask"
) -> AsyncIterator[tuple[Hub, MemoryTransport]]:
    """A device that is announced, and a program that provides /ask."""
    async with running_hub(Hub(Config(), CATALOG, reraises=True)) as hub:
        hub.services.provide(Provider("/ask", SET_BOOL, "it", program.answer))
        host_end, end = memory_pair(address="10.0.0.2")
        hub.spawn(hub.links.serve(hub.links.open(host_end, CallingProtocol(session))), name="link of a test")
        await end.send(f"HELLO car {services}\n".encode())
        await asyncio.sleep(0.1)
        yield hub, end
        assert len(hub.links.all()) == 1
        await end.aclose()


async def answers(end: MemoryTransport, count: int) -> list[str]:
    """Return so many answers."""
    found: list[str] = []
    async with asyncio.timeout(DEVICE_TIMEOUT_S):
        while len(found) < count:
            data = await end.receive()
            assert data
            found += [each.removeprefix("ANSWER ") for each in data.decode().splitlines() if each.startswith("ANSWER")]
    return found


def test_a_device_that_announces_more_in_a_call_receives_the_answer_to_each_of_its_calls() -> None:
    class Announcing(CallingSession):
        def _read(self, words: list[str], now_s: float, found: list[events.Event]) -> bool:
            if words != ["MORE"]:
                return super()._read(words, now_s, found)
            self.counts.negotiations += 1
            found.append(events.TopicsNegotiated(self._topics, is_changed=True, gap_at=None))
            return True

    async def run() -> list[str]:
        async with device(Program(1.0), Announcing) as (_, end):
            await end.send(b"ASK 1 1\n")
            await asyncio.sleep(0.1)
            await end.send(b"MORE\nASK 2 0\nASK 3 1\n")
            return await answers(end, 3)

    assert run_virtual(run()) == ["1 True execution 0", "2 False execution 1", "3 True execution 2"]


def test_calls_above_the_bound_are_refused_themselves_with_the_number_that_waits() -> None:
    count = MAX_WAITING + 3

    async def run() -> list[str]:
        async with device(Program(0.1)) as (_, end):
            await end.send("".join(f"ASK {number} 1\n" for number in range(count)).encode())
            return await answers(end, count)

    found = run_virtual(run())
    refused = [f"{number} False /ask: {MAX_WAITING + 1} requests wait already; try again later" for number in (5, 6)]
    assert found[:2] == refused
    assert found[2:] == [f"{number} True execution {number}" for number in range(MAX_WAITING + 1)]


def test_calls_of_many_services_above_the_bound_are_refused_with_the_number_that_waits() -> None:
    names = ["ask", *(f"other{number}" for number in range(MAX_CALLS))]

    async def run() -> list[str]:
        async with device(Program(0.1), services=" ".join(names)) as (hub, end):
            for each in names[1:]:
                hub.services.provide(Provider(f"/{each}", SET_BOOL, each, Program(0.1).answer))
            await end.send("".join(f"ASK {each} 1 /{each}\n" for each in names).encode())
            return await answers(end, 1)

    last = names[-1]
    assert run_virtual(run()) == [f"{last} False /{last}: {MAX_CALLS} requests wait already; try again later"]


def test_a_device_that_restarts_in_a_call_is_answered_at_once_and_only_what_it_asks_now() -> None:
    program = Program(4.0, 0.0)

    async def run() -> tuple[list[str], float]:
        async with device(program) as (_, end):
            await end.send(b"ASK 1 1\nASK 2 1\n")
            await asyncio.sleep(0.1)
            await end.send(b"HELLO car ask\nASK 3 0\n")
            began_s = asyncio.get_running_loop().time()
            found = await answers(end, 1)
            after_s = asyncio.get_running_loop().time() - began_s
            with pytest.raises(TimeoutError):
                await answers(end, 1)
            return found, after_s

    found, after_s = run_virtual(run())
    assert found == ["3 False execution 1"]
    assert after_s < 0.1
    assert program.executed == [True, False]


def test_session_whose_requests_have_no_identity_is_called_without_one_and_answered_in_order() -> None:
    async def run() -> list[str]:
        async with device(Program(1.0, 0.1), OrderedSession) as (_, end):
            await end.send(b"ASK 1 1\nASK 2 0\n")
            return await answers(end, 2)

    assert run_virtual(run()) == ["- True execution 0", "- False execution 1"]


@virtual
async def test_first_call_of_each_connection_has_a_number_that_is_drawn() -> None:
    class Numbered(CallingSession):
        def number_calls(self, first: int) -> None:
            given.append(first)

    given: list[int] = []
    drawn = iter((7, 1234))
    hub = Hub(Config(), CATALOG, first_call=lambda: next(drawn))
    for _ in range(2):
        hub.links.open(memory_pair()[0], CallingProtocol(Numbered))
    assert given == [7, 1234]
    assert draw_call() != draw_call()


def test_answer_of_a_device_that_is_not_of_its_type_fails_its_call_alone_and_at_once() -> None:
    async def answering(end: MemoryTransport, lines: bytes) -> None:
        await asyncio.sleep(0.1)
        await end.send(lines)

    async def run() -> None:
        async with device(Program(0.0), ServingSession, services="") as (hub, end), asyncio.TaskGroup() as tasks:
            began_s = asyncio.get_running_loop().time()
            tasks.create_task(answering(end, b"WRONG 1\n"))
            with pytest.raises(BadPayload, match=r"^std_srvs/SetBoolResponse: 37 bytes$"):
                await hub.services.call("/led", {"data": True})
            tasks.create_task(answering(end, b"WRONG 1\nRIGHT 1\nRIGHT 2\n"))
            assert await hub.services.call("/led", {"data": True}) == {"success": True, "message": "2"}
            assert asyncio.get_running_loop().time() - began_s < 0.3
            assert hub.links.late_answers == 2

    run_virtual(run())


class LongerSession(CallingSession):
    """A session whose encoding is four bytes longer than that of the host."""

    ROOM_BYTES = 64

    def room_bytes(self, endpoint: DeviceEndpoint) -> int:  # noqa: ARG002 - of every endpoint
        return self.ROOM_BYTES

    def respond(self, response: DeviceEndpoint, payload: bytes | None, *, request: bytes | None = None) -> None:
        assert payload is not None
        if len(payload) + 4 > self.ROOM_BYTES:
            raise FrameTooLarge(response.name, len(payload) + 4, self.ROOM_BYTES)
        super().respond(response, payload, request=request)


class DeafSession(LongerSession):
    ROOM_BYTES = 6  # less than the shortest response
    left: ClassVar[list[bytes]] = []

    def leave_unanswered(self, service: DeviceEndpoint, request: bytes) -> None:  # noqa: ARG002 - each is unique
        self.left.append(request)


class Talker(Program):
    async def answer(self, request: Mapping[str, object]) -> Mapping[str, object]:
        return {**await super().answer(request), "message": "x" * 100}


def test_answer_is_cut_to_what_the_encoding_of_the_device_leaves() -> None:
    async def run() -> list[str]:
        async with device(Talker(0.1), LongerSession) as (_, end):
            await end.send(b"ASK 1 1\n")
            return await answers(end, 1)

    head_bytes = len(RESPONSE.encode({"success": True, "message": ""}))
    assert run_virtual(run()) == [f"1 True {'x' * (LongerSession.ROOM_BYTES - 4 - head_bytes)}"]


def test_device_without_room_for_an_answer_keeps_its_link_if_its_requests_have_an_identity() -> None:
    async def run() -> int:
        async with device(Talker(0.1), DeafSession) as (hub, end):
            DeafSession.left.clear()
            count = MAX_WAITING + 3  # the last ones are refused
            await end.send("".join(f"ASK {number} 1\n" for number in range(count)).encode())
            await asyncio.sleep(2 * DEVICE_TIMEOUT_S)
            assert sorted(DeafSession.left) == [str(number).encode() for number in range(count)]
            return len(hub.links.all())

    assert run_virtual(run()) == 1


def test_call_of_a_service_of_another_type_is_refused_and_not_executed() -> None:
    program = Program(0.1)

    async def run() -> list[str]:
        async with device(program, services="ask other") as (hub, end):
            hub.services.provide(Provider("/other", "std_srvs/Trigger", "other", program.answer))
            await end.send(b"ASK 1 1 /other\n")
            return await answers(end, 1)

    assert run_virtual(run()) == ["1 False /other: wanted std_srvs/Trigger, got std_srvs/SetBool"]
    assert program.executed == []
