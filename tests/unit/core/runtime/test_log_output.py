"""LogOutput: no failure of the output ends or blocks the daemon."""

import io
import json
import logging
import os
import sys
import time
from collections.abc import Iterator
from typing import TextIO

import pytest
import structlog

from hostlink.core.runtime import logs
from hostlink.core.runtime.log_output import CHUNK_BYTES, LogOutput

LINE = "x" * 99 + "\n"


@pytest.fixture
def pipe() -> Iterator[tuple[int, TextIO]]:
    reading, writing = os.pipe()
    stream = os.fdopen(writing, "w")
    yield reading, stream
    for close in (lambda: os.close(reading), stream.close):
        try:
            close()
        except OSError:
            assert sys.exc_info()[1] is not None  # the stream was closed by a test


def test_lines_arrive_whole(pipe: tuple[int, TextIO]) -> None:
    reading, stream = pipe
    output = LogOutput(stream)
    output.write("one\n")
    output.write("tw\udcffo\n")
    assert os.read(reading, 100) == b"one\ntw\\udcffo\n"
    assert output.lost_lines == 0


def test_blocked_reader_loses_lines_without_delay(pipe: tuple[int, TextIO]) -> None:
    reading, stream = pipe
    output = LogOutput(stream)
    began_s = time.monotonic()
    for _ in range(2000):  # three times the capacity of the pipe
        output.write(LINE)
    assert time.monotonic() - began_s < 5.0
    assert output.lost_lines > 500
    kept = 2000 - output.lost_lines
    data = b""
    while len(data) < kept * len(LINE):
        data += os.read(reading, 1 << 16)
    assert data == LINE.encode() * kept
    output.write(LINE)
    assert os.read(reading, 1 << 16) == LINE.encode()
    assert (output.pop_lost(), output.pop_lost()) == (2000 - kept, 0)


def test_line_that_was_cut_is_ended_before_the_next(pipe: tuple[int, TextIO]) -> None:
    reading, stream = pipe
    output = LogOutput(stream)
    output.write("y" * (1 << 17) + "\n")
    assert output.lost_lines == 1
    cut = os.read(reading, 1 << 17)
    assert 0 < len(cut) <= 1 << 17
    assert len(cut) % CHUNK_BYTES == 0
    output.write(LINE)
    assert os.read(reading, 1 << 17) == b"\n" + LINE.encode()


def test_closed_pipe_loses_lines_without_error(pipe: tuple[int, TextIO]) -> None:
    reading, stream = pipe
    output = LogOutput(stream)
    os.close(reading)
    output.write(LINE)
    assert output.lost_lines == 1


def test_full_disk_loses_lines_without_error() -> None:
    with open("/dev/full", "w") as full:  # noqa: PTH123
        output = LogOutput(full)
        output.write(LINE)
        assert output.lost_lines == 1


@pytest.mark.parametrize("stream", [None, io.StringIO()])
def test_missing_or_closed_stream_loses_lines_without_error(stream: io.StringIO | None) -> None:
    if stream is not None:
        stream.close()
    output = LogOutput(stream)
    output.write(LINE)
    assert output.lost_lines == 1
    assert not output.isatty()


@pytest.fixture
def log() -> Iterator[io.StringIO]:
    """Return the daemon's own log, in memory."""
    stream = io.StringIO()
    logs.configure(stream=stream)
    yield stream
    logging.captureWarnings(capture=False)
    structlog.reset_defaults()


def events(log: io.StringIO) -> list[dict[str, object]]:
    return [json.loads(line) for line in log.getvalue().splitlines()]


def test_lines_of_a_peer_have_a_budget_and_refused_ones_are_logged(log: io.StringIO) -> None:
    for peer in ("192.0.2.77", "192.0.2.78"):
        with structlog.contextvars.bound_contextvars(**logs.of_peer(peer)):
            for number in range(700 if peer.endswith("77") else 3):
                structlog.get_logger().info("device.logged", number=number)
    logs.log_what_is_missing()
    found = events(log)
    assert "log_budget" not in found[0]
    reported = [line for line in found if line["event"] == "log.lines_left_out" and line["about"] == "192.0.2.77"]
    assert len(reported) == 1
    lines = reported[0]["lines"]
    assert isinstance(lines, int)
    assert 150 <= lines <= 200  # of 700 lines: the rest of the burst of 500, and what the rate allowed meanwhile
    assert len([line for line in found if line["event"] == "device.logged"]) == 703 - lines
