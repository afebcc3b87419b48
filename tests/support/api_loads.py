"""Loads on the API's port, each a process of its own: bodies, readers of /metrics, latched messages, and a publisher.

python -m tests.support.api_loads uploads http://127.0.0.1:9090 --connections 200 --token READ-TOKEN
"""

import argparse
import asyncio
import base64
import contextlib
import json
import socket
import struct
import sys
import time
from collections.abc import Awaitable, Callable
from urllib.parse import urlsplit

from tests.support.background import meanwhile

AGE_PERIOD_S = 100.0  # the velocity of a publisher tells when it was sent, modulo this
BODY_BYTES = 1_000_000
PUBLISH_HZ = 20.0
READ_BYTES = 65536
TOPIC = "/robot_0/velocity_commands"


def encode_time(now_s: float) -> float:
    """A velocity in m/s that tells when it was sent, above 0 and within the default limits."""
    return (now_s % AGE_PERIOD_S) / AGE_PERIOD_S or 1e-9


def age_s(velocity_m_s: float, now_s: float) -> float:
    """Age of a velocity of this speed."""
    return (now_s - velocity_m_s * AGE_PERIOD_S) % AGE_PERIOD_S


def head(method: str, path: str, token: str, *lines: str) -> bytes:
    """The head of a request."""
    access = [f"Authorization: Bearer {token}"] if token else []
    return "\r\n".join([f"{method} {path} HTTP/1.1", "Host: 127.0.0.1", *access, *lines, "", ""]).encode()


def frame(data: bytes, opcode: int = 1) -> bytes:
    """A WebSocket frame of a client, masked with zeros."""
    if len(data) < 126:
        length = bytes([0x80 | len(data)])
    elif len(data) < 65536:
        length = b"\xfe" + struct.pack(">H", len(data))
    else:
        length = b"\xff" + struct.pack(">Q", len(data))
    return bytes([0x80 | opcode]) + length + bytes(4) + data


def operation(**request: object) -> bytes:
    """An operation of rosbridge as a frame."""
    return frame(json.dumps(request).encode())


def websocket_head(token: str, *more: str) -> bytes:
    """The request of a WebSocket, with more header lines."""
    key = base64.b64encode(bytes(16)).decode()
    upgrade = ("Upgrade: websocket", "Connection: Upgrade", f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13")
    return head("GET", "/", token, *upgrade, *more)


# -- loads ------------------------------------------------------------------------------------------------------------


async def upload(address: tuple[str, int], request: bytes, body: bytes) -> None:
    """Send a body again and again, on a new connection where the old one was closed; read every answer."""
    reader, writer = await asyncio.open_connection(*address)
    try:
        async with meanwhile(_read_all(reader)):
            while not reader.at_eof():
                writer.write(request)
                for start in range(0, len(body), READ_BYTES):
                    writer.write(body[start : start + READ_BYTES])
                    await writer.drain()
    finally:
        writer.close()


async def _read_all(reader: asyncio.StreamReader) -> None:
    with contextlib.suppress(OSError):
        while await reader.read(READ_BYTES):
            continue


async def ask(address: tuple[str, int], request: bytes) -> None:
    """Send a request again and again, each when the one before is answered."""
    reader, writer = await asyncio.open_connection(*address)
    try:
        while True:
            writer.write(request)
            answer = await reader.readuntil(b"\r\n\r\n")
            length = next(line for line in answer.lower().split(b"\r\n") if line.startswith(b"content-length"))
            await reader.readexactly(int(length.partition(b":")[2]))
    finally:
        writer.close()


async def latch(address: tuple[str, int], token: str, number: int, topics: int, body_bytes: int) -> None:
    """Publish one large message on each of several latched topics, and stay."""
    reader, writer = await asyncio.open_connection(*address)
    writer.write(websocket_head(token))
    await reader.readuntil(b"\r\n\r\n")
    try:
        for each in range(topics):
            name = f"/latched_{number}_{each}"
            message = {"data": "x" * body_bytes}
            writer.write(operation(op="publish", topic=name, type="std_msgs/String", latch=True, msg=message))
            await writer.drain()
        await _read_all(reader)
    finally:
        writer.close()


async def forever(work: Callable[[], Awaitable[None]]) -> None:
    """Repeat the work, also after the daemon ended the connection."""
    while True:
        try:
            await work()
        except* (OSError, asyncio.IncompleteReadError):
            await asyncio.sleep(0.01)


async def load(arguments: argparse.Namespace) -> None:
    """Run until killed."""
    parts = urlsplit(arguments.url)
    assert parts.hostname is not None
    assert parts.port is not None
    address, token = (parts.hostname, parts.port), arguments.token
    body = b"x" * arguments.bytes
    length = f"Content-Length: {len(body)}"

    def work(number: int) -> Callable[[], Awaitable[None]]:
        match arguments.load:
            case "uploads":
                return lambda: upload(address, head("POST", "/api/robots/zzz/lock", token, length), body)
            case "bodies":
                return lambda: upload(address, head("PUT", "/api/robots/robot_0/velocity", token, length), body)
            case "metrics":
                return lambda: ask(address, head("GET", "/metrics", token))
            case _:
                return lambda: latch(address, token, number, arguments.topics, arguments.bytes)

    async with asyncio.TaskGroup() as tasks:
        for number in range(arguments.connections):
            tasks.create_task(forever(work(number)))


# -- a driver ---------------------------------------------------------------------------------------------------------


def publish(url: str, token: str, hz: float) -> None:
    """Publish velocities that tell when they were sent, until killed. A line is printed when the first was sent."""
    parts = urlsplit(url)
    with socket.create_connection((parts.hostname or "", parts.port or 0)) as raw:
        raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        raw.sendall(websocket_head(token))
        answer = b""
        while b"\r\n\r\n" not in answer:
            answer += raw.recv(READ_BYTES)
        raw.sendall(operation(op="advertise", topic=TOPIC, type="geometry_msgs/Twist"))
        due_s = time.monotonic()
        sys.stdout.write("publishing\n")
        sys.stdout.flush()
        while True:
            velocity = {"linear": {"x": encode_time(time.monotonic())}}
            raw.sendall(operation(op="publish", topic=TOPIC, msg=velocity))
            due_s = max(due_s + 1 / hz, time.monotonic() - 1 / hz)
            time.sleep(max(0.0, due_s - time.monotonic()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("load", choices=("uploads", "bodies", "metrics", "latched", "publish"))
    parser.add_argument("url")
    parser.add_argument("--token", default="")
    parser.add_argument("--connections", type=int, default=60)
    parser.add_argument("--bytes", type=int, default=BODY_BYTES)
    parser.add_argument("--topics", type=int, default=16)
    parser.add_argument("--hz", type=float, default=PUBLISH_HZ)
    arguments = parser.parse_args()
    if arguments.load == "publish":
        with contextlib.suppress(OSError):
            publish(arguments.url, arguments.token, arguments.hz)
    else:
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(load(arguments))


def command(load_name: str, url: str, *flags: str) -> list[str]:
    """The command of one load."""
    return [sys.executable, "-m", "tests.support.api_loads", load_name, url, *flags]


if __name__ == "__main__":
    main()
