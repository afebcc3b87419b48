"""A device that calls a service always gets an answer that it can take, in time; else its link ends, and it is free."""

import asyncio
import contextlib
import random
import struct
import tracemalloc
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from typing import Any

import pytest
from structlog.testing import capture_logs

from hostlink.core.config import Config
from hostlink.core.hub.device_calls import LAST_S, MAX_CALLS, MAX_WAITING
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.services import DEVICE_TIMEOUT_S, Provider
from hostlink.core.link.serving import LinkEnd
from hostlink.core.messages.message_type import MessageType
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.events import Parameter, ServiceRequested
from hostlink.core.protocol.outbox import MAX_REPLIES
from hostlink.core.protocol.rosserial.frame import OVERHEAD_BYTES, Id
from tests.support.fake_device import CATALOG, robot_topics, service_type, topic
from tests.support.ros_lib_device import (
    REQUESTS,
    RESPONSES,
    Connected,
    GivenUp,
    clients,
    response_type,
    ros_lib_device,
    running_hub,
)
from tests.support.virtual_loop import VirtualLoop, run_virtual

SAME_TURN_S = 5e-7  # within the resolution of the clock: behind what is due, in one turn of the loop
LATEST_S = DEVICE_TIMEOUT_S + LAST_S
UNKNOWN = ("0" * 32, "1" * 32)
TRIGGER_RESPONSE = response_type("bool success\nstring message")
ANY_LAYOUTS = [
    "",
    "string output",
    "int64 sum",
    "bool ok\nstring[] names\nfloat64[] values\nstring note",
    "float32[36] c",
]
Answer = Callable[[Mapping[str, object]], Awaitable[Mapping[str, object]]]


def trigger(*, buffer_bytes: int = 512, count: int = 1) -> list[DeviceEndpoint]:
    type_ = service_type("std_srvs/Trigger")
    md5 = type_.request.md5, type_.response.md5
    return clients("/go", "std_srvs/Trigger", md5=md5, buffer_bytes=buffer_bytes, count=count)


def answering(values: Mapping[str, object]) -> Answer:
    async def answer(_: Mapping[str, object]) -> Mapping[str, object]:
        return values

    return answer


async def never(_: Mapping[str, object]) -> Mapping[str, object]:
    await asyncio.Event().wait()
    return {}


async def with_a_bug(_: Mapping[str, object]) -> Mapping[str, object]:
    raise ZeroDivisionError("a bug in a program of the daemon's")


def outcome(
    topics: list[DeviceEndpoint],
    response: MessageType,
    *providers: Provider,
    request: bytes = b"",
) -> tuple[dict[str, Any] | str, float, LinkEnd | None]:
    """Return the result of a device's call, its duration, and the end of the link."""

    async def run() -> tuple[dict[str, Any] | str, float, LinkEnd | None]:
        async with running_hub(Hub(Config(), CATALOG, reraises=True)) as hub:
            for provider in providers:
                hub.services.provide(provider)
            async with ros_lib_device(hub, topics, response) as connected:
                loop = asyncio.get_running_loop()
                began_s = loop.time()
                try:
                    found: dict[str, Any] | str = await connected.device.call(request)
                except GivenUp as freed:
                    found = str(freed)
                after_s = loop.time() - began_s
                await asyncio.sleep(0.1)
                return found, after_s, connected.end

    return run_virtual(run())


FAILED = {"success": False, "message": "no service named /go"}


# -- the four ways to hang a device, and their kin --------------------------------------------------------------------


@pytest.mark.parametrize("layout", ANY_LAYOUTS)
def test_a_service_type_without_a_definition_is_answered_with_defaults_of_any_layout(layout: str) -> None:
    response = response_type(layout)
    found, after_s, end = outcome(clients("/go", "my_srvs/Mine", md5=UNKNOWN), response)
    assert (found, end) == (response.decode(response.encode({})), None)
    assert after_s < 0.1


def test_a_reason_that_is_longer_than_the_devices_buffer_is_cut() -> None:
    name = "/" + "long_name" * 10
    topics = [info._replace(name=name) for info in trigger(buffer_bytes=100)]
    found, _, end = outcome(topics, TRIGGER_RESPONSE)
    room_bytes = 100 - OVERHEAD_BYTES - TRIGGER_RESPONSE.layout.minimum_bytes
    assert (found, end) == ({"success": False, "message": f"no service named {name}"[:room_bytes]}, None)


def test_a_programs_text_that_is_longer_than_the_devices_buffer_is_cut() -> None:
    long = answering({"success": True, "message": "x" * 1000})
    provider = Provider("/go", "std_srvs/Trigger", "it", long)
    with capture_logs() as logged:
        found, _, end = outcome(trigger(buffer_bytes=60), TRIGGER_RESPONSE, provider)
    assert (found, end) == ({"success": True, "message": "x" * 47}, None)
    cuts = [line["reason"] for line in logged if line["event"] == "service.cut"]
    assert cuts == ["/go: frame of 1013 bytes, the device takes 60"]
    assert any(line["event"] == "link.diagnosed" and line["code"] == "buffer_too_small" for line in logged)


def test_a_list_that_is_longer_than_the_devices_buffer_is_a_failure_and_not_half_a_list() -> None:
    type_ = service_type("rosserial_msgs/RequestParam")
    topics = clients("/p", type_.name, md5=(type_.request.md5, type_.response.md5), buffer_bytes=64)
    long = answering({"ints": list(range(100))})
    response = response_type("int32[] ints\nfloat32[] floats\nstring[] strings")
    found, _, end = outcome(topics, response, Provider("/p", type_.name, "it", long), request=bytes(4))
    assert (found, end) == ({"ints": [], "floats": [], "strings": []}, None)


@pytest.mark.parametrize("values", [{"sucess": True}, {"success": "yes"}, {"message": 5}, {"message": ["x"]}])
def test_an_answer_of_another_layout_is_a_failure(values: dict[str, object]) -> None:
    other = Provider("/go", "my_srvs/Other", "it", answering(values))
    found, _, end = outcome(trigger(), TRIGGER_RESPONSE, other)
    assert isinstance(found, dict)
    assert (found["success"], end) == (False, None)
    assert found["message"]


@pytest.mark.parametrize("which", [EndpointKind.SERVICE_CLIENT_PUBLISHER, EndpointKind.SERVICE_CLIENT_SUBSCRIBER])
def test_a_type_that_has_another_md5_here_is_answered_all_the_same(which: EndpointKind) -> None:
    topics = [info._replace(md5="0" * 32) if info.kind is which else info for info in trigger()]
    provider = Provider("/go", "std_srvs/Trigger", "it", answering({"success": True}))
    found, _, end = outcome(topics, TRIGGER_RESPONSE, provider)
    assert isinstance(found, dict)
    assert (found["success"], end) == (which is EndpointKind.SERVICE_CLIENT_SUBSCRIBER and False, None)


def test_request_of_another_type_is_answered() -> None:
    type_ = service_type("rosserial_arduino/Test")
    topics = clients("/test_srv", type_.name, md5=(type_.request.md5, type_.response.md5))
    found, _, end = outcome(topics, response_type("string output"), request=struct.pack("<I", 1000) + b"short")
    assert (found, end) == ({"output": ""}, None)


def test_a_program_that_never_answers_has_a_deadline() -> None:
    found, after_s, end = outcome(trigger(), TRIGGER_RESPONSE, Provider("/go", "std_srvs/Trigger", "it", never))
    assert (found, end) == ({"success": False, "message": "/go: no answer within 5 s"}, None)
    assert after_s == pytest.approx(DEVICE_TIMEOUT_S, abs=0.1)


def test_bug_of_a_service_is_answered_and_ends_no_link() -> None:
    found, _, end = outcome(trigger(), TRIGGER_RESPONSE, Provider("/go", "std_srvs/Trigger", "it", with_a_bug))
    assert isinstance(found, dict)
    assert (found["success"], end) == (False, None)
    assert "ZeroDivisionError" in found["message"]


def test_a_device_whose_buffer_fits_no_response_loses_its_link_and_waits_no_more() -> None:
    provider = Provider("/go", "std_srvs/Trigger", "it", answering({"success": True}))
    found, after_s, end = outcome(trigger(buffer_bytes=12), TRIGGER_RESPONSE, provider)
    assert (found, end) == ("stopped", LinkEnd.UNANSWERABLE)
    assert after_s < 0.1


def test_a_device_that_never_announced_where_responses_go_loses_its_link_at_the_deadline() -> None:
    found, after_s, end = outcome(trigger()[:1], TRIGGER_RESPONSE)
    assert (found, end) == ("stopped", LinkEnd.UNANSWERABLE)
    assert after_s <= LATEST_S


def test_a_robot_that_loses_its_link_so_receives_zero_first() -> None:
    velocity = topic(EndpointKind.SUBSCRIBER, 101, "/robot_0/velocity_commands", "geometry_msgs/Twist", buffer_bytes=64)
    odometry = topic(EndpointKind.PUBLISHER, 126, "/robot_0/odometry", "geometry_msgs/Pose2D")
    robot = [*trigger(buffer_bytes=12), velocity, odometry]

    async def run() -> list[int]:
        async with (
            running_hub(Hub(Config(), CATALOG, reraises=True)) as hub,
            ros_lib_device(hub, robot, TRIGGER_RESPONSE) as connected,
        ):
            while (await connected.device.next()).topic_id != velocity.id:
                pass  # the zero with which a session begins
            await asyncio.sleep(1.0)
            await connected.device.send(REQUESTS, b"")
            heard = []
            while not heard or heard[-1].topic_id != Id.STOP:
                heard.append(await connected.device.next())
            last = [frame for frame in heard if frame.topic_id == velocity.id][-1]
            assert last.payload == bytes(48)
            return [frame.topic_id for frame in heard[-2:]]

    assert run_virtual(run()) == [velocity.id, Id.STOP]


# -- between devices --------------------------------------------------------------------------------------------------


def test_two_devices_of_one_definition_need_none_here() -> None:
    server = [
        DeviceEndpoint(EndpointKind.SERVICE_SERVER_PUBLISHER, 125, "/go", "my_srvs/Mine", UNKNOWN[1], 512),
        DeviceEndpoint(EndpointKind.SERVICE_SERVER_SUBSCRIBER, 100, "/go", "my_srvs/Mine", UNKNOWN[0], 512),
    ]
    response = response_type("string output\nint32 n")

    async def run(md5: tuple[str, str], type_name: str = "my_srvs/Mine") -> dict[str, Any]:
        async with (
            running_hub(Hub(Config(), CATALOG, reraises=True)) as hub,
            ros_lib_device(hub, server, response) as callee,
            ros_lib_device(hub, clients("/go", type_name, md5=md5), response) as caller,
            asyncio.TaskGroup() as tasks,
        ):
            call = tasks.create_task(caller.device.call(b"anything"))
            if (md5, type_name) == (UNKNOWN, "my_srvs/Mine"):
                while (frame := await callee.device.next()).topic_id != RESPONSES:
                    pass
                assert frame.payload == b"anything"
                await callee.device.send(REQUESTS, response.encode({"output": "from afar", "n": 7}))
            return await call

    assert run_virtual(run(UNKNOWN)) == {"output": "from afar", "n": 7}
    assert run_virtual(run(("0" * 32, "2" * 32))) == {"output": "", "n": 0}
    assert run_virtual(run(UNKNOWN, "my_srvs/Other")) == {"output": "", "n": 0}


def test_two_clients_of_one_service_in_one_device_get_their_own_answers() -> None:
    async def run() -> list[dict[str, Any]]:
        async with (
            running_hub(Hub(Config(), CATALOG, reraises=True)) as hub,
            ros_lib_device(hub, trigger(count=2), TRIGGER_RESPONSE) as connected,
        ):
            hub.services.provide(Provider("/go", "std_srvs/Trigger", "it", answering({"success": True})))
            return [await connected.device.call(b"", client=client) for client in (1, 0, 1)]

    assert run_virtual(run()) == [{"success": True, "message": ""}] * 3


def test_a_device_whose_topics_were_requested_meanwhile_receives_the_answer_to_its_newest_call_alone() -> None:
    began: list[int] = []

    async def first_is_slow(_: Mapping[str, object]) -> Mapping[str, object]:
        began.append(len(began))
        if len(began) == 1:
            await asyncio.sleep(2.0)
        return {"success": True, "message": f"answer {len(began)}"}

    async def run() -> dict[str, Any]:
        async with (
            running_hub(Hub(Config(), CATALOG, reraises=True)) as hub,
            ros_lib_device(hub, trigger(), TRIGGER_RESPONSE) as connected,
        ):
            hub.services.provide(Provider("/go", "std_srvs/Trigger", "it", first_is_slow))
            await connected.device.send(REQUESTS, b"")
            await asyncio.sleep(0.5)
            await connected.device.announce()  # `call` has returned without a response
            return await connected.device.call(b"")

    assert run_virtual(run()) == {"success": True, "message": "answer 2"}


@contextlib.asynccontextmanager
async def in_a_call_without_an_answer() -> AsyncIterator[tuple[Hub, Connected]]:
    """A device that has called half a second ago."""
    async with (
        running_hub(Hub(Config(), CATALOG, reraises=True)) as hub,
        ros_lib_device(hub, trigger(), TRIGGER_RESPONSE) as connected,
    ):
        hub.services.provide(Provider("/go", "std_srvs/Trigger", "it", never))
        await connected.device.send(REQUESTS, b"")
        await asyncio.sleep(0.5)
        yield hub, connected


def test_call_that_is_given_up_at_its_deadline_ends_no_link() -> None:
    async def run() -> LinkEnd | None:
        async with in_a_call_without_an_answer() as (hub, connected):
            await connected.device.announce()
            loop, accepted = asyncio.get_running_loop(), asyncio.Event()
            first = next(iter(hub.links.calls._calls[connected.link.number].values()))[0]

            def accept() -> None:
                hub.links.calls.accept(connected.link, ServiceRequested(first.endpoint, b""))
                accepted.set()

            loop.call_at(first.deadline_s + SAME_TURN_S, accept)
            async with asyncio.timeout(DEVICE_TIMEOUT_S):
                await accepted.wait()
            return connected.end

    assert run_virtual(run()) is None


def test_a_board_that_restarts_with_other_topics_in_a_call_keeps_its_link() -> None:
    """Behind a passthrough that keeps the connection; its program of now waits for no answer."""

    async def run() -> LinkEnd | None:
        async with in_a_call_without_an_answer() as (_, connected):
            connected.device.topics = robot_topics()
            await connected.device.announce()
            for _ in range(5):
                await asyncio.sleep(2.0)
                await connected.device.announce()
            return connected.end

    assert run_virtual(run()) is None


# -- bounds -----------------------------------------------------------------------------------------------------------


def test_a_full_queue_of_replies_only_delays_the_answer() -> None:
    async def run() -> dict[str, Any]:
        async with (
            running_hub(Hub(Config(), CATALOG, reraises=True)) as hub,
            ros_lib_device(hub, trigger(), TRIGGER_RESPONSE) as connected,
        ):
            for number in range(MAX_REPLIES):
                connected.link.session.answer_parameter(f"/p{number}", Parameter())
            await connected.device.send(REQUESTS, b"")
            await asyncio.sleep(0.5)
            connected.link.wake()
            return await connected.device.response()

    assert run_virtual(run()) == FAILED


@pytest.mark.slow
def test_a_flood_of_calls_costs_no_memory_and_the_device_receives_an_answer() -> None:
    calls = 8_000

    async def run() -> tuple[int, int, int]:
        async with running_hub(Hub(Config(), CATALOG, reraises=True)) as hub:
            hub.services.provide(Provider("/go", "std_srvs/Trigger", "it", never))
            async with ros_lib_device(hub, trigger(), TRIGGER_RESPONSE) as connected, asyncio.TaskGroup() as tasks:

                async def read() -> int:
                    answers = 0
                    while (await connected.device.next()).topic_id != Id.PARAMETER:
                        answers += 1
                    return answers

                reading = tasks.create_task(read())
                tracemalloc.start()
                before = tracemalloc.get_traced_memory()[0]
                for _ in range(calls // 100):
                    for _ in range(100):
                        await connected.device.send(REQUESTS, b"")
                    await asyncio.sleep(0.0001)
                tasks_now = sum("service calls" in task.get_name() for task in asyncio.all_tasks())
                grown = tracemalloc.get_traced_memory()[0] - before
                tracemalloc.stop()
                await connected.device.send(Id.PARAMETER, struct.pack("<I", 2) + b"/p")
                assert await reading > 0
                assert hub.links.calls.refused == calls - MAX_WAITING - 1
                return tasks_now, grown, len(hub.links.all())

    tasks_now, grown, links = run_virtual(run())
    assert (tasks_now, links) == (1, 1)
    assert grown < 2**20


@pytest.mark.slow
def test_floods_of_calls_of_many_devices_wait_behind_one_who_drives() -> None:
    devices, call_s = 16, 0.001

    async def run() -> float:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        virtual, answered = loop, 0

        async def answer(_: Mapping[str, object]) -> Mapping[str, object]:
            nonlocal answered
            answered += 1
            virtual.burn(call_s)
            return {"success": True}

        async with running_hub(Hub(Config(), CATALOG, reraises=True)) as hub, contextlib.AsyncExitStack() as stack:
            hub.services.provide(Provider("/go", "std_srvs/Trigger", "it", answer))

            async def flood() -> None:
                connected = await stack.enter_async_context(ros_lib_device(hub, trigger(), TRIGGER_RESPONSE))
                while True:
                    await connected.device.send(REQUESTS, b"")
                    await asyncio.sleep(0.0005)

            async with asyncio.TaskGroup() as tasks:
                floods = [tasks.create_task(flood()) for _ in range(devices)]
                await asyncio.sleep(0.1)
                turns, longest_s = hub.turns(), 0.0
                for _ in range(10):
                    came_s = loop.time()
                    await turns.run(lambda: None, is_flooding=False)
                    longest_s = max(longest_s, loop.time() - came_s)
                    await asyncio.sleep(0.02)
                for task in floods:
                    task.cancel()
            assert answered > 50
        return longest_s

    with capture_logs():
        longest_s = run_virtual(run())
    assert longest_s <= 4 * call_s  # behind all of them it was 16


def test_the_calls_of_one_device_are_bounded_and_each_is_answered() -> None:
    count = MAX_CALLS + 5

    async def run() -> int:
        async with running_hub(Hub(Config(), CATALOG, reraises=True)) as hub:
            hub.services.provide(Provider("/go", "std_srvs/Trigger", "it", never))
            async with ros_lib_device(hub, trigger(count=count), TRIGGER_RESPONSE) as connected:
                for client in range(count):
                    await connected.device.send(REQUESTS + client, b"")
                answered = set()
                while len(answered) < count:
                    frame = await connected.device.next()
                    if frame.topic_id >= RESPONSES:
                        answered.add(frame.topic_id)
                assert asyncio.get_running_loop().time() < LATEST_S + 2
                return hub.links.calls.refused

    assert run_virtual(run()) == count - MAX_CALLS


def test_a_device_that_leaves_ends_its_calls() -> None:
    async def run() -> int:
        async with running_hub(Hub(Config(), CATALOG, reraises=True)) as hub:
            hub.services.provide(Provider("/go", "std_srvs/Trigger", "it", never))
            async with ros_lib_device(hub, trigger(), TRIGGER_RESPONSE) as connected:
                for _ in range(3):
                    await connected.device.send(REQUESTS, b"")
                await asyncio.sleep(0.1)
            await asyncio.sleep(0.1)
            return sum("service calls" in task.get_name() for task in asyncio.all_tasks())

    assert run_virtual(run()) == 0


# -- any combination of calls ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(40))
def test_no_device_waits_longer_than_the_deadline_and_none_is_crashed(seed: int) -> None:
    draw = random.Random(seed)
    layout = draw.choice(["bool success\nstring message", *ANY_LAYOUTS])
    response = response_type(layout)
    buffer_bytes = draw.choice([0, 9, 40, 100, 280, 512, 2048])
    topics = draw.choice([
        trigger(buffer_bytes=buffer_bytes),
        clients("/go", "my_srvs/Mine", md5=UNKNOWN, buffer_bytes=buffer_bytes),
        clients("/go", "std_srvs/Trigger", md5=UNKNOWN, buffer_bytes=buffer_bytes),
    ])  # fmt: skip
    is_trigger = topics[0].type == "std_srvs/Trigger" and topics[0].md5 != UNKNOWN[0]
    response = TRIGGER_RESPONSE if is_trigger else response
    topics = [info for info in topics if draw.random() < 0.95 or not info.is_to_device]
    values = {"success": draw.choice([True, 1, "x", None]), "message": draw.choice(["", "m" * 3000, "é" * 500, 7])}
    answer = draw.choice([answering(values), answering({}), never, with_a_bug])
    providers = [Provider("/go", draw.choice(["std_srvs/Trigger", "my_srvs/Mine", "std_srvs/Empty"]), "it", answer)]
    fits = response.layout.minimum_bytes + OVERHEAD_BYTES <= (buffer_bytes or 512)
    if not fits and not is_trigger:
        return  # no host can know that nothing of an unknown layout fits
    found, after_s, end = outcome(
        topics, response, *providers[: draw.randrange(2)], request=draw.randbytes(draw.choice([0, 0, 3]))
    )
    assert after_s <= LATEST_S
    can_be_answered = fits and len(topics) == 2
    assert isinstance(found, dict) == can_be_answered
    assert end == (None if can_be_answered else LinkEnd.UNANSWERABLE)
