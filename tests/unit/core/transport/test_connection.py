"""Connection and StreamTransport on a fake asyncio transport: reading in pieces, backpressure, errors and closing."""

import asyncio
from typing import Any

import pytest

from hostlink.core.transport.base import CLOSE_TIMEOUT_S, READ_BYTES
from hostlink.core.transport.connection import StreamTransport
from tests.support.virtual_loop import virtual


class FakeTransport(asyncio.Transport):
    """Transport of asyncio that records its calls. `ends`: whether `close` ends the connection at once."""

    def __init__(self, *, ends: bool = True) -> None:
        super().__init__()
        self.calls: list[str] = []
        self.written = b""
        self.protocol: Any = None
        self._ends, self._is_closing = ends, False

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:  # noqa: ARG002 - asyncio's signature
        self.calls.append(f"high water {high}")

    def pause_reading(self) -> None:
        self.calls.append("pause")

    def resume_reading(self) -> None:
        self.calls.append("resume")

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.written += bytes(data)

    def is_closing(self) -> bool:
        return self._is_closing

    def close(self) -> None:
        self.calls.append("close")
        self._is_closing = True
        if self._ends:
            self.protocol.connection_lost(None)

    def abort(self) -> None:
        self.calls.append("abort")
        self._is_closing = True
        self.protocol.connection_lost(None)


def connected(*, ends: bool = True) -> tuple[StreamTransport, FakeTransport]:
    stream, fake = StreamTransport(peer="192.168.4.2:1", address="192.168.4.2"), FakeTransport(ends=ends)
    fake.protocol = stream
    stream.connection_made(fake)
    assert fake.calls.pop() == "high water 0"
    return stream, fake


def receive(stream: StreamTransport, data: bytes) -> None:
    """Pass data as asyncio's selector loop does: through the shared buffer."""
    stream.get_buffer(-1)[: len(data)] = data
    stream.buffer_updated(len(data))


@virtual
async def test_received_bytes_are_read_in_pieces_and_counted() -> None:
    stream, _ = connected()
    receive(stream, b"abc")
    stream.data_received(b"de")
    assert stream.unread_bytes == 5
    assert [stream.read(2), stream.read(2), stream.read(2), stream.read(2)] == [b"ab", b"cd", b"e", b""]
    assert stream.unread_bytes == 0


@virtual
async def test_each_arrival_and_the_end_call_the_reader() -> None:
    stream, _ = connected()
    observed = []
    stream.start(lambda: observed.append((stream.unread_bytes, stream.is_ended)))
    assert observed == []
    receive(stream, b"a")
    assert stream.eof_received()
    assert observed == [(1, False), (1, True)]


@pytest.mark.parametrize("is_ended", [False, True])
@virtual
async def test_reader_that_starts_late_is_called_at_once(*, is_ended: bool) -> None:
    stream, _ = connected()
    stream.eof_received() if is_ended else receive(stream, b"a")
    called = []
    stream.start(lambda: called.append(True))
    assert called == [True]


@virtual
async def test_reading_pauses_at_the_limit_and_resumes_when_everything_was_read() -> None:
    stream, fake = connected()
    receive(stream, bytes(READ_BYTES - 1))
    assert fake.calls == []
    receive(stream, b"a")
    receive(stream, b"b")
    assert fake.calls == ["pause"]
    stream.read(READ_BYTES)
    assert fake.calls == ["pause"]
    stream.read(1)
    assert fake.calls == ["pause", "resume"]
    stream.read(1)
    assert fake.calls == ["pause", "resume"]


@virtual
async def test_closing_connection_does_not_resume() -> None:
    stream, fake = connected()
    receive(stream, bytes(READ_BYTES))
    fake.close()
    stream.read(READ_BYTES)
    assert fake.calls == ["pause", "close"]


@virtual
async def test_error_is_raised_after_the_last_byte() -> None:
    stream, _ = connected()
    receive(stream, b"ab")
    stream.connection_lost(ConnectionResetError("reset"))
    assert stream.is_ended
    assert stream.read(8) == b"ab"
    with pytest.raises(ConnectionResetError, match="reset"):
        stream.read(8)


@virtual
async def test_orderly_end_reads_as_no_bytes() -> None:
    stream, _ = connected()
    stream.connection_lost(None)
    assert stream.read(8) == b""


@virtual
async def test_write_reports_whether_the_peer_keeps_up() -> None:
    stream, fake = connected()
    assert stream.write(b"a")
    stream.pause_writing()
    assert not stream.write(b"b")
    stream.resume_writing()
    assert stream.write(b"c")
    fake.close()
    assert not stream.write(b"d")
    assert fake.written == b"abc"


@virtual
async def test_drain_waits_for_the_system() -> None:
    stream, _ = connected()
    await stream.drain()
    stream.pause_writing()
    asyncio.get_running_loop().call_later(2.0, stream.resume_writing)
    await stream.drain()
    assert asyncio.get_running_loop().time() == pytest.approx(2.0)


@pytest.mark.parametrize("error", [None, BrokenPipeError("broken")])
@virtual
async def test_drain_fails_when_the_connection_is_lost_meanwhile(error: OSError | None) -> None:
    stream, _ = connected()
    stream.pause_writing()
    asyncio.get_running_loop().call_later(2.0, stream.connection_lost, error)
    with pytest.raises(ConnectionResetError if error is None else BrokenPipeError):
        await stream.drain()
    with pytest.raises(ConnectionResetError if error is None else BrokenPipeError):
        await stream.drain()


@virtual
async def test_drain_of_a_closing_connection_fails() -> None:
    stream, fake = connected(ends=False)
    fake.close()
    with pytest.raises(ConnectionResetError):
        await stream.drain()


@virtual
async def test_receive_waits_for_bytes_and_returns_none_at_the_end() -> None:
    stream, _ = connected()
    asyncio.get_running_loop().call_later(1.0, receive, stream, b"abc")
    assert await stream.receive() == b"abc"
    assert asyncio.get_running_loop().time() == pytest.approx(1.0)
    stream.eof_received()
    assert await stream.receive() == b""


@virtual
async def test_close_ends_the_connection_once() -> None:
    stream, fake = connected()
    await stream.send(b"last")
    await stream.aclose()
    await stream.aclose()
    assert (fake.written, fake.calls) == (b"last", ["close"])
    assert stream.descriptor() is None


@virtual
async def test_close_of_a_dead_peer_aborts_after_the_timeout() -> None:
    stream, fake = connected(ends=False)
    await stream.aclose()
    assert fake.calls == ["close", "abort"]
    assert asyncio.get_running_loop().time() == pytest.approx(CLOSE_TIMEOUT_S)


@virtual
async def test_cancelled_close_aborts() -> None:
    stream, fake = connected(ends=False)
    closing = asyncio.get_running_loop().create_task(stream.aclose())
    await asyncio.sleep(CLOSE_TIMEOUT_S / 2)
    closing.cancel()
    with pytest.raises(asyncio.CancelledError):
        await closing
    assert fake.calls == ["close", "abort"]


@virtual
async def test_closed_stream_calls_its_reader_no_more() -> None:
    stream, _ = connected()
    called = []
    stream.start(lambda: called.append(True))
    await stream.aclose()
    called.clear()
    stream.on_readable()
    assert called == []
