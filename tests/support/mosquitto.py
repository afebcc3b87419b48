"""A real mosquitto, and a program that reads and writes at it."""

import asyncio
import contextlib
import json
import shutil
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import aiomqtt

from hostlink.core.runtime.cancellation import raise_if_cancelled
from tests.support.waiting import TIMEOUT_S, expect

PROGRAM = shutil.which("mosquitto") or "/usr/sbin/mosquitto"


@contextlib.asynccontextmanager
async def broker(folder: Path, port: int, *lines: str) -> AsyncIterator[asyncio.subprocess.Process]:
    """mosquitto on this port of loopback, killed at the end of the block. `lines` are added to its configuration."""
    file = folder / f"mosquitto-{port}.conf"
    settings = lines or ("allow_anonymous true",)
    file.write_text("\n".join([f"listener {port} 127.0.0.1", "user root", "persistence false", *settings, ""]))
    with (folder / "mosquitto.log").open("ab") as log:
        child = await asyncio.create_subprocess_exec(PROGRAM, "-c", str(file), stdout=log, stderr=log)
    try:
        async with asyncio.timeout(TIMEOUT_S):
            while not await _listens(port):
                assert child.returncode is None, (folder / "mosquitto.log").read_text()
                await asyncio.sleep(0.01)
        yield child
    finally:
        if child.returncode is None:
            child.kill()
        await child.wait()


async def _listens(port: int) -> bool:
    try:
        _, writer = await asyncio.open_connection("127.0.0.1", port)
    except OSError:
        return False
    writer.close()
    return True


class Program:
    """A program at the broker that has subscribed to everything."""

    def __init__(self, client: aiomqtt.Client) -> None:
        self._client = client
        self.newest: dict[str, str] = {}  # by topic; without those that were removed
        self.statuses: list[str] = []  # of hostlink, in order
        self.answers: list[dict[str, Any]] = []

    async def read(self) -> None:
        """Read until the broker vanishes."""
        with contextlib.suppress(aiomqtt.MqttError):
            await self._read()

    async def _read(self) -> None:
        async for message in self._client.messages:
            topic, text = message.topic.value, bytes(message.payload).decode()
            if topic == "hostlink/status":
                self.statuses.append(text)
            if topic.endswith("/answer"):
                self.answers.append(json.loads(text))
            elif text:
                self.newest[topic] = text
            else:
                self.newest.pop(topic, None)

    async def send(self, topic: str, payload: str = "", *, retain: bool = False) -> None:
        await self._client.publish(topic, payload, qos=1, retain=retain)

    async def flood(self, topic: str, payload: str, count: int) -> None:
        """Send a message many times without waiting for the broker."""
        for _ in range(count):
            await self._client.publish(topic, payload)

    async def drive(self, linear: float, robot: str = "robot_0", **fields: object) -> None:
        payload = json.dumps({"linear": linear, "sent_s": time.time(), **fields})
        await self._client.publish(f"hostlink/robots/{robot}/drive", payload)
        raise_if_cancelled()  # asyncio.wait_for, by which the client waits, drops a cancellation in Python 3.11

    async def ask(self, topic: str, payload: str = "", *, retain: bool = False) -> dict[str, Any]:
        """Send a command; returns its answer."""
        verb, before = topic.rpartition("/")[2], len(self.answers)
        verb = {"LOCK": "lock", "UNLOCK": "unlock"}.get(payload, verb)
        await self.send(topic, payload, retain=retain)
        await expect(lambda: [each for each in self.answers[before:] if each["command"] == verb])
        return next(each for each in self.answers[before:] if each["command"] == verb)

    def state(self, robot: str = "robot_0") -> dict[str, Any]:
        """Newest state of a robot; a KeyError without one."""
        found: dict[str, Any] = json.loads(self.newest[f"hostlink/robots/{robot}/state"])
        return found


@contextlib.asynccontextmanager
async def program(port: int, **settings: Any) -> AsyncIterator[Program]:
    """A program at the broker, for the length of the block."""
    async with aiomqtt.Client("127.0.0.1", port, timeout=TIMEOUT_S, **settings) as client:
        made = Program(client)
        await client.subscribe("#", qos=1)
        async with asyncio.TaskGroup() as tasks:
            reading = tasks.create_task(made.read())
            try:
                yield made
            finally:
                reading.cancel()
