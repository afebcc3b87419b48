"""The key of the passthrough: its SHA-256 compared with Python's, its proof with the host's, and other clients."""

import asyncio
import ctypes
import hashlib
import hmac
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hostlink.core.config import Config, TcpConfig
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.transport.keyed import ANSWER_BYTES, MAGIC, proof
from hostlink.workbench.sim.robot import SimulatedRobot
from hostlink.workbench.sim.run import run_over_streams
from tests.firmware.esp8266 import Bridge, library, running_sketch
from tests.support.daemon import daemon
from tests.support.waiting import expect

pytestmark = pytest.mark.usefixtures("esp8266_built")

KEY = b"a key of 16 bytes, or of more"
RANDOM = bytes(range(16))
COMMAND = encode(101, bytes(48))


def digest_of(function: str, *arguments: bytes | int) -> bytes:
    digest = ctypes.create_string_buffer(32)
    getattr(library(), function)(*arguments, digest)
    return digest.raw


@given(st.binary(max_size=300), st.data())
def test_the_hash_is_sha_256_however_its_message_is_cut(message: bytes, data: st.DataObject) -> None:
    cut = data.draw(st.integers(0, len(message)))
    assert digest_of("sha256", message, len(message), cut) == hashlib.sha256(message).digest()


@given(st.binary(max_size=200), st.binary(max_size=200))
def test_the_hmac_is_hmac_sha_256(key: bytes, message: bytes) -> None:
    assert digest_of("hmac_sha256", key, len(key), message, len(message)) == hmac.digest(key, message, "sha256")


def test_a_message_over_the_length_of_one_word() -> None:
    message = bytes(1 << 20)
    assert digest_of("sha256", message, len(message), 7) == hashlib.sha256(message).digest()


def connect(bridge: Bridge) -> None:
    for _ in range(3):
        bridge.turn(1)


@settings(deadline=None)
@given(st.integers(1, 60), st.integers(1, 60))
def test_host_and_device_with_one_key_agree_however_their_words_are_cut(from_host: int, to_host: int) -> None:
    with Bridge(KEY) as bridge:
        connect(bridge)
        bridge.from_device(COMMAND)  # sent before the link is up: it is not for this host

        def exchange(data: bytes) -> bytes:
            for at in range(0, len(data), from_host):
                bridge.from_host(data[at : at + from_host])
                assert not bridge.turn(1, host_room=to_host) or data[at + from_host :] == b""
            answer = b"".join(bridge.to_host())
            for _ in range(60):
                bridge.turn(1, host_room=to_host)
                answer += b"".join(bridge.to_host())
            return answer

        answer = exchange(MAGIC + RANDOM)
        assert len(answer) == ANSWER_BYTES
        device_random = answer[4:20]
        assert answer[20:] == proof(KEY, b"device", RANDOM, device_random)
        assert exchange(proof(KEY, b"host", RANDOM, device_random)) == b""
        assert bridge.turn(1)
        bridge.from_host(COMMAND)
        for _ in range(5):
            bridge.turn(1)
        assert bridge.to_device() == COMMAND


def test_bytes_directly_after_the_host_s_proof_reach_the_device() -> None:
    with Bridge(KEY) as bridge:
        connect(bridge)
        bridge.from_host(MAGIC + RANDOM)
        bridge.turn(1)
        (answer,) = bridge.to_host()
        bridge.from_host(proof(KEY, b"host", RANDOM, answer[4:20]) + COMMAND)
        for _ in range(5):
            bridge.turn(1)
        assert bridge.to_device() == COMMAND


@settings(deadline=None)
@given(st.lists(st.binary(max_size=80), max_size=8), st.booleans())
def test_host_without_the_key_never_reaches_the_device(parts: list[bytes], begins_right: bool) -> None:
    with Bridge(KEY) as bridge:
        connect(bridge)
        for part in [MAGIC + RANDOM] * begins_right + parts:
            bridge.from_host(part)
            assert not bridge.turn(1)
        for _ in range(100):
            bridge.from_host(COMMAND)
            assert not bridge.turn(50)
        assert bridge.to_device() == b""


def test_the_random_bytes_of_two_connections_differ() -> None:
    answers = []
    for _ in range(2):
        with Bridge(KEY) as bridge:
            connect(bridge)
            bridge.from_host(MAGIC + RANDOM)
            bridge.turn(1)
            answers += bridge.to_host()
    assert len({answer[4:20] for answer in answers}) == 2


@pytest.mark.parametrize(("key", "refused"), [(KEY, {}), (b"another key, as long as it is", {"wrong_key"})])
async def test_sketch_and_daemon_with_one_key_connect(tmp_path: Path, key: bytes, refused: set[str]) -> None:
    """A simulated robot behind the unmodified sketch, on a daemon that requires the key."""
    (tmp_path / "key").write_bytes(KEY)
    config = Config(tcp=TcpConfig(key_file=tmp_path / "key"))
    async with daemon(config) as host, asyncio.TaskGroup() as tasks:
        with running_sketch(host.tcp[1], "--key", key.decode()) as sketch:
            reader, writer = await asyncio.open_connection("127.0.0.1", sketch.uart_port)
            robot = tasks.create_task(run_over_streams(SimulatedRobot("robot_0"), reader, writer))
            if refused:
                await expect(lambda: host.hub.counts.refused["wrong_key"] > 1)  # the device reconnects
                assert not host.hub.robots.all()
            else:
                await expect(lambda: host.hub.robots.find("robot_0").odometry.snapshot(0.0), timeout_s=15)
            assert set(host.hub.counts.refused) == set(refused)
            robot.cancel()
