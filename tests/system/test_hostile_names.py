"""Every command that prints what a device or a program calls itself: none of it reaches the terminal as a code."""

import asyncio
import json
import struct

import pytest

from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import encode
from tests.support.daemon import daemon
from tests.support.fake_device import FakeDevice, fake_device, pose, robot_topics, topic
from tests.support.process import run
from tests.support.rosbridge import Client

HOSTILE = "\x1b]0;x\x07\x1b[2J\x9b31m\u202e\u2066\x7f[red][/x]"
TOPICS = [*robot_topics(), topic(EndpointKind.PUBLISHER, 126, "/robot_0/text", "std_msgs/String")]


async def log_text(device: FakeDevice) -> None:
    data = HOSTILE.encode()
    while True:
        await device.send(encode(126, struct.pack("<I", len(data)) + data) + pose(1.0))
        await asyncio.sleep(0.05)


def texts(value: object) -> list[str]:
    """Every text of a JSON value, names without their first slash."""
    if isinstance(value, dict):
        return texts(list(value.values()))
    if isinstance(value, list):
        return [text for each in value for text in texts(each)]
    return [str(value).removeprefix("/")]


@pytest.mark.parametrize(
    "arguments",
    [
        ("topics",),
        ("topics", "--json"),
        ("echo", "/robot_0/text", "--count", "1"),
        ("echo", "/robot_0/text", "--count", "1", "--json"),
        ("call", "/rosapi/topics"),
        ("call", f"/{HOSTILE}"),
        ("pub", f"/{HOSTILE}", '{"no": 1}'),
        ("top", "--once", "--interval", "0.1"),
        ("doctor",),
        ("teleop", HOSTILE),
    ],
    ids=lambda words: " ".join(word for word in words if HOSTILE not in word),
)
async def test_a_command_prints_only_what_is_printable(arguments: tuple[str, ...]) -> None:
    async with (
        daemon() as host,
        host.session.ws_connect(host.url) as socket,
        fake_device(host.tcp, TOPICS) as device,
        asyncio.TaskGroup() as tasks,
    ):
        await Client(socket).send(op="advertise", topic=f"/{HOSTILE}", type="std_msgs/String")
        await Client(socket).call("/rosapi/topics")
        talking = tasks.create_task(log_text(device))
        _, out, err = await run(*arguments, "--url", host.url)
        talking.cancel()
    assert out + err
    assert [line for line in (out + err).split("\n") if not line.isprintable()] == []
    if "--json" in arguments:
        assert HOSTILE in texts(json.loads(out))
