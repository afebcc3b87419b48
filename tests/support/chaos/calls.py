"""Devices that call a service and wait, as ros_lib's ServiceClient::call does: without end, for one frame that fits."""

import asyncio
import contextlib
import json
import random
import re
import time

from hostlink.core.protocol.endpoint import DeviceEndpoint
from hostlink.core.protocol.rosserial.frame import OVERHEAD_BYTES, Frame, encode
from hostlink.core.protocol.rosserial.stream import DEFAULT_LIMIT_BYTES, FrameStream
from tests.support.chaos import frames, requests
from tests.support.chaos.connection import Connection, reading
from tests.support.chaos.devices import quietly
from tests.support.chaos.names import SERVICE_TYPES, UNKNOWN_SERVICE, request_of
from tests.support.chaos.plan import Action
from tests.support.chaos.stage import Stage, introduce

PATIENCE_S = 9.0  # longer than any limit: the run judges the result
TIME_INTERVAL_S = 2.5  # it spins while it waits, and so it requests the time
SETTLE_S = 0.1
PROVIDERS = ("nobody", "program", "program", "device")
DEVICE_MANNERS = ("right", "other", "never")


async def call(stage: Stage, action: Action) -> None:
    """Call services as a device. A program, a device or none answers: well, badly, too much or never."""
    dice = action.dice()
    service, type_name = f"/asked_{action.number}/do", dice.choice(SERVICE_TYPES)
    provider = dice.choice(PROVIDERS)
    manner = dice.choice(DEVICE_MANNERS if provider == "device" else requests.MANNERS) if provider != "nobody" else ""
    buffer_bytes = dice.choice((280, 280, 512, 2048, 64))
    who = f"call {action.number}: a device with {buffer_bytes} bytes"
    what = f"{who} asks for {type_name} of {provider} {manner}".strip()
    stage.report({"action": action.number, "what": what})
    async with asyncio.TaskGroup() as tasks:
        work = []
        if provider == "program":
            work.append(tasks.create_task(quietly(provide, stage, dice, service, type_name, manner)))
        elif provider == "device":
            work.append(tasks.create_task(quietly(serve, stage, dice, service, type_name, manner)))
        await asyncio.sleep(2 * SETTLE_S)
        await quietly(request, stage, dice, frames.service_client(service, type_name, buffer_bytes), what)
        for each in work:
            each.cancel()


async def request(stage: Stage, dice: random.Random, infos: list[DeviceEndpoint], what: str) -> None:
    """Reports how long it waited, and for what."""
    requests_to, answers_by = infos
    async with stage.device(dice, is_verified=True) as connection:
        await introduce(connection, frames.introduction(infos))
        await asyncio.sleep(SETTLE_S)
        began_s = time.monotonic()
        stage.report({"calls": what, "began_s": began_s})
        outcome = "the link ended"
        try:
            await connection.send(encode(requests_to.id, request_of(requests_to.type, dice)))
            outcome = await wait_for_answer(connection, answers_by.id, answers_by.buffer_bytes)
        finally:
            stage.report({"called": what, "waited_s": time.monotonic() - began_s, "outcome": outcome})


async def wait_for_answer(connection: Connection, topic_id: int, buffer_bytes: int) -> str:
    """Return how the call ended: with an answer, with a too large one, by the link's end, or without an answer."""
    outcome = "no answer"
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as tasks:
            spinning = tasks.create_task(quietly(spin, connection))
            outcome = await first_answer(connection, topic_id, buffer_bytes)
            spinning.cancel()
    return outcome


async def first_answer(connection: Connection, topic_id: int, buffer_bytes: int) -> str:
    stream = FrameStream(limit_bytes=max(buffer_bytes, DEFAULT_LIMIT_BYTES))
    try:
        while data := await connection.receive():
            for item in stream.feed(data):
                if isinstance(item, Frame) and item.topic_id == topic_id:
                    size = len(item.payload) + OVERHEAD_BYTES
                    return "answered" if size <= buffer_bytes else f"an answer of {size} bytes"
    except OSError:
        return "the link ended"
    return "the link ended"


async def spin(connection: Connection) -> None:
    while True:
        await connection.send(frames.TIME)
        await asyncio.sleep(TIME_INTERVAL_S)


async def provide(stage: Stage, dice: random.Random, service: str, type_name: str, manner: str) -> None:
    """A program that offers the service."""
    async with stage.websocket(dice) as connection:
        await connection.send(requests.operation(op="advertise_service", service=service, type=type_name))
        heard = b""
        while data := await connection.receive():
            heard += data
            for found in re.finditer(rb'\{"op":"call_service".*?\}\}?', heard):
                if manner == "leaves":
                    return
                with contextlib.suppress(ValueError):
                    answer = requests.provider_answer(manner, service, _id_in(found[0]))
                    await connection.send(answer or b"")
            heard = heard[-200:] if b"call_service" not in heard else b""


def _id_in(call: bytes) -> object:
    found = re.search(rb'"id":("[^"]*"|\d+)', call)
    return json.loads(found[1]) if found else None


async def serve(stage: Stage, dice: random.Random, service: str, type_name: str, manner: str) -> None:
    """A device that offers the service; `other`: its answers have another layout."""
    infos = frames.service_server(service, type_name if type_name != UNKNOWN_SERVICE else SERVICE_TYPES[0])
    answer = {"right": bytes(5), "other": dice.randbytes(dice.randrange(40))}.get(manner)
    async with stage.device(dice) as connection:
        await introduce(connection, frames.introduction(infos))
        if answer is None:
            async with reading(connection):
                await spin(connection)
        stream = FrameStream()
        while data := await connection.receive():
            for item in stream.feed(data):
                if isinstance(item, Frame) and item.topic_id == infos[0].id:
                    await connection.send(encode(infos[1].id, answer or b""))
