"""The native board's line to the host is as slow as the real one."""

import contextlib
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hostlink.core.protocol.rosserial.frame import TOPICS_REQUEST, Frame, Id
from hostlink.core.protocol.rosserial.stream import FrameStream
from tests.firmware.boards import build_native

BYTES_S = 38400 / 10
RING_BYTES = 128  # of the Due's UART: this many bytes may already be on their way
TOPICS = 8


@contextlib.contextmanager
def board(*words: str) -> Iterator[socket.socket]:
    """Connection of the board to a host that sends nothing by itself."""
    program = build_native() / "due_native"
    with socket.create_server(("127.0.0.1", 0)) as server:
        command = [program, "127.0.0.1", str(server.getsockname()[1]), *words]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
            try:
                server.settimeout(20.0)
                connection, _ = server.accept()
                with connection:
                    connection.settimeout(20.0)
                    yield connection
            finally:
                process.kill()


def answer(connection: socket.socket) -> tuple[int, float]:
    """Request the topics; returns the bytes up to the last TopicInfo, and their duration."""
    stream, infos, size = FrameStream(), 0, 0
    began_s = time.monotonic()
    connection.sendall(TOPICS_REQUEST)
    while infos < TOPICS:
        data = connection.recv(4096)
        assert data, "the board hung up"
        size += len(data)
        infos += sum(
            isinstance(item, Frame) and item.topic_id in (Id.PUBLISHER, Id.SUBSCRIBER) for item in stream.feed(data)
        )
    return size, time.monotonic() - began_s


@pytest.mark.parametrize("words", [(), ("38400",)], ids=["default", "38400 baud"])
def test_the_topics_last_as_long_as_their_bytes_on_the_line(words: tuple[str, ...]) -> None:
    with board(*words) as connection:
        size, lasted_s = answer(connection)
        assert size > 500
        assert lasted_s >= (size - RING_BYTES) / BYTES_S * 0.99


def test_a_line_without_a_speed_is_as_fast_as_tcp() -> None:
    with board("0") as connection:
        assert min(answer(connection)[1] for _ in range(5)) < 0.1  # on the line it would take 0.17 s


@pytest.mark.parametrize(("text", "line"), [("track_m=0.2\ntrack=0.2\n", 2), ("track_m=wide\n", 1)])
def test_invalid_world_is_refused_with_its_line(tmp_path: Path, text: str, line: int) -> None:
    world = tmp_path / "world.txt"
    world.write_text(text)
    command = [build_native() / "due_native", "127.0.0.1", "1", "38400", world]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20.0, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith(f"due_native: {world}: line {line} is no number of a world")
