"""Device port with a key: a device without it is refused before the first byte of rosserial."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from hostlink.core.config import Config, TcpConfig
from hostlink.core.protocol.rosserial.frame import TOPICS_REQUEST
from hostlink.core.transport.keyed import ANSWER_BYTES, PROOF_TIMEOUT_S, exchange_proofs, read_key
from hostlink.errors import ConfigError
from tests.support.daemon import daemon
from tests.support.fake_device import FakeDevice, fake_device, pose, robot_topics
from tests.support.keyed_device import prove_key
from tests.support.memory_transport import memory_pair
from tests.support.virtual_loop import run_virtual
from tests.support.waiting import expect

KEY = b"a key of 16 bytes, or of more"


@pytest.fixture
def config(tmp_path: Path) -> Config:
    (tmp_path / "hostlink.key").write_bytes(KEY + b"\n")
    return Config(tcp=TcpConfig(key_file=tmp_path / "hostlink.key", keyless=("127.0.0.7",)))


@contextlib.asynccontextmanager
async def connection(address: tuple[str, int]) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    reader, writer = await asyncio.open_connection(*address)
    try:
        yield reader, writer
    finally:
        writer.close()


async def test_device_with_the_key_connects_and_verifies_the_host(config: Config) -> None:
    async with daemon(config) as host, connection(host.tcp) as (reader, writer):
        assert await prove_key(reader, writer, KEY)
        device = FakeDevice(reader, writer)
        await device.announce(robot_topics())
        await device.send(pose(1.0))
        await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 1)
        assert not host.hub.counts.refused


async def test_a_device_with_another_key_is_closed_and_counted(config: Config) -> None:
    with capture_logs() as lines:
        async with daemon(config) as host, connection(host.tcp) as (reader, writer):
            with pytest.raises(asyncio.IncompleteReadError) as end:
                await prove_key(reader, writer, b"another key, as long as it is")
            assert end.value.partial == b""  # not even the host's proof
            await expect(lambda: not host.hub.links.all())
            assert host.hub.counts.refused == {"wrong_key": 1}
    assert [line["cause"] for line in lines if line["event"] == "connection.refused"] == ["wrong_key"]
    assert [line["reason"] for line in lines if line["event"] == "link.closed"] == ["unauthenticated"]


@pytest.mark.parametrize(
    "sent_bytes",
    [bytes(ANSWER_BYTES), TOPICS_REQUEST * 10, b"HLK1" + bytes(ANSWER_BYTES)],
    ids=["zeros", "rosserial", "more"],
)
async def test_connection_without_the_key_is_closed(config: Config, sent_bytes: bytes) -> None:
    async with daemon(config) as host, connection(host.tcp) as (reader, writer):
        writer.write(sent_bytes)
        assert len(await reader.read()) == 20  # the challenge, and no request for topics
        assert host.hub.counts.refused == {"no_key": 1}


async def test_an_address_that_needs_no_key_talks_rosserial_at_once(config: Config) -> None:
    async with daemon(config) as host, fake_device(host.tcp, robot_topics(), local_host="127.0.0.7") as device:
        await device.send(pose(1.0))
        await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 1)


async def wait_for_a_silent_device() -> tuple[list[str], float]:
    host, device = memory_pair()
    causes: list[str] = []
    with pytest.raises(ConnectionRefusedError):
        await exchange_proofs(host, KEY, on_refused=causes.append)
    assert len(await device.receive()) == 20
    return causes, asyncio.get_running_loop().time()


def test_a_silent_device_is_given_up() -> None:
    assert run_virtual(wait_for_a_silent_device()) == (["no_key"], PROOF_TIMEOUT_S)


async def test_no_answer_is_good_twice(config: Config) -> None:
    """An answer recorded on one connection does not open another, because the host's random bytes differ."""
    async with daemon(config) as host, connection(host.tcp) as (reader, _), connection(host.tcp) as (other, _):
        assert await reader.readexactly(20) != await other.readexactly(20)


@pytest.mark.parametrize(
    ("content", "problem"), [(b"too short \n", "a key has at least 16 bytes"), (None, "No such file or directory")]
)
async def test_invalid_key_file_prevents_the_start(tmp_path: Path, content: bytes | None, problem: str) -> None:
    path = tmp_path / "key"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=f"tcp.key_file: {path}: {problem}"):
        read_key(path, "tcp.key_file")
    with pytest.raises(ConfigError, match=problem):
        async with daemon(replace(Config(), tcp=TcpConfig(key_file=path))):
            raise AssertionError("it serves")
