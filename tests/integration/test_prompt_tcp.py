"""A device that writes one message with two calls, and leaves Nagle's algorithm on, waits for no acknowledgement."""

import asyncio
import socket
import statistics
import time

import pytest

from hostlink.core.config import TcpConfig
from hostlink.core.transport.base import Transport
from hostlink.core.transport.tcp import serve_tcp

EXCHANGES = 15


def exchange(address: tuple[str, int]) -> list[float]:
    """Send messages in two parts, each after the answer to the one before. Return how long each took."""
    took_s = []
    with socket.create_connection(address) as device:
        for _ in range(EXCHANGES):
            began_s = time.monotonic()
            device.send(b"\x04\x00")
            device.send(b"text")
            received = 0
            while received < 6:
                received += len(device.recv(6))
            took_s.append(time.monotonic() - began_s)
    return took_s


async def echo(transport: Transport) -> None:
    """Answer each message of six bytes with itself."""
    message = b""
    while data := await transport.receive():
        message += data
        if len(message) >= 6:
            transport.write(message[:6])
            message = message[6:]
    await transport.aclose()


async def median_s(*, is_prompt: bool) -> float:
    async with (
        asyncio.TaskGroup() as tasks,
        asyncio.timeout(60),
        serve_tcp(
            TcpConfig(host="127.0.0.1", port=0),
            lambda transport: tasks.create_task(echo(transport)),
            on_exhausted=lambda: None,
            is_prompt=is_prompt,
        ) as listener,
    ):
        return statistics.median(await asyncio.to_thread(exchange, listener.address))


@pytest.mark.skipif(not hasattr(socket, "TCP_QUICKACK"), reason="needs Linux")
async def test_message_in_two_parts_waits_for_no_delayed_acknowledgement() -> None:
    plain_s = await median_s(is_prompt=False)
    assert plain_s > 0.03, "this system delays no acknowledgement"
    assert await median_s(is_prompt=True) < plain_s / 2
