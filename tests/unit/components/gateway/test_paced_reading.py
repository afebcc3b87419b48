"""PacedReading: how old the bytes of a connection may be, when they are held back, and when reading is paused."""

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from hostlink.components.gateway.listener import (
    CONTROL_FRAME_BYTES,
    IDLE_TIMEOUT_S,
    LARGE_BYTES,
    REQUEST_BYTES,
    SOCKET_BYTES,
    ApiConnection,
    ApiConnections,
    PacedReading,
)
from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.link.fair_share import TURN_S
from hostlink.core.transport.base import READ_BYTES
from tests.support.api_memory import ApiTransport
from tests.support.fake_device import CATALOG
from tests.support.hosts import host_in
from tests.support.virtual_loop import VirtualLoop, inside, run_virtual

TIMEOUT_S = 7.0


class Inner(asyncio.Protocol):
    """HTTP or WebSocket protocol that keeps what it received."""

    def __init__(self) -> None:
        self.pieces: list[bytes] = []
        self.calls: list[str] = []
        self.on_data: Callable[[], None] = lambda: None

    def data_received(self, data: bytes) -> None:
        self.pieces.append(data)
        self.on_data()

    def connection_made(self, _: asyncio.BaseTransport) -> None:
        self.calls.append("made")

    def pause_writing(self) -> None:
        self.calls.append("paused")

    def resume_writing(self) -> None:
        self.calls.append("resumed")

    def connection_lost(self, _: Exception | None) -> None:
        self.calls.append("lost")


class Scene:
    """One connection whose bytes the test delivers."""

    def __init__(self, behind_since_s: float | None = None) -> None:
        config = ApiConfig(request_timeout_s=TIMEOUT_S)
        self.hub = Hub(Config().with_tables(api=config), CATALOG, reraises=True)
        self.connections = ApiConnections(4, 4, request_timeout_s=TIMEOUT_S)
        self.connection = self.connect()
        self.inner, self.transport = Inner(), ApiTransport("127.0.0.1")
        self.reading = PacedReading(
            self.inner, host_in(self.hub), config, self.connections, self.connection, behind_since_s
        )
        self.transport.protocol = self.reading
        self.reading.connection_made(self.transport)
        self.reads: list[None] = []
        self.messages: list[bytes] = []  # that were offered
        self.takes = True
        self.share = self.hub.budget["receiving"]

    def connect(self) -> ApiConnection:
        made, _ = self.connections.enter("127.0.0.1", self.now_s)
        assert made is not None
        return made

    @property
    def now_s(self) -> float:
        return asyncio.get_running_loop().time()

    @property
    def received(self) -> bytes:
        return b"".join(self.inner.pieces)

    def read(self, data: bytes) -> None:
        """Let bytes arrive in one read, or in as many as they need."""
        while data:
            assert not self.transport.is_paused
            buffer = self.reading.get_buffer(-1)
            piece, data = data[: len(buffer)], data[len(buffer) :]
            buffer[: len(piece)] = piece
            self.reading.buffer_updated(len(piece))

    def burn(self, seconds: float) -> None:
        """Let time pass without a turn of the loop."""
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        loop.burn(seconds)

    def become_web_socket(self) -> None:
        self.reading.become_web_socket(
            on_message=self._take,
            on_read=lambda: self.reads.append(None),
            on_full=lambda: None,
            on_writable=lambda: None,
        )

    def _take(self, text: bytes) -> bool:
        self.messages.append(text)
        return self.takes

    def fill_turn(self) -> None:
        """Use up this turn of the loop by another client."""
        self.hub.turns().end(self.now_s - 10 * TURN_S)


def check(test: Callable[[Scene], Awaitable[None]], behind_since_s: float | None = None) -> None:
    async def run() -> None:
        await asyncio.sleep(100.0)  # so that no time is zero by accident
        await test(Scene(behind_since_s))

    run_virtual(run())


@inside(check)
async def test_request_read_alone_is_passed_on_at_once_and_as_old_as_its_read(scene: Scene) -> None:
    assert len(scene.reading.get_buffer(-1)) == REQUEST_BYTES
    scene.read(b"GET")
    assert (scene.received, scene.reading.reads, scene.reading.came_s) == (b"GET", 1, 100.0)
    await asyncio.sleep(1.0)
    scene.read(b" /")
    assert (scene.received, scene.reading.reads, scene.reading.came_s) == (b"GET /", 2, 101.0)
    scene.reading.begin_request()
    assert scene.reading.request_came_s == 100.0


@inside(check, behind_since_s=40.0)
async def test_first_bytes_of_a_connection_are_as_old_as_its_wait_for_acceptance(scene: Scene) -> None:
    scene.read(b"GET")
    assert scene.reading.came_s == 40.0
    scene.read(b" /")
    assert scene.reading.came_s == 100.0


@inside(check)
async def test_second_request_read_before_the_first_is_answered_is_as_old_as_the_first(scene: Scene) -> None:
    scene.read(b"1")
    scene.reading.begin_request()
    await asyncio.sleep(2.0)
    scene.read(b"2")
    scene.reading.begin_request()
    assert scene.reading.request_came_s == 100.0
    scene.reading.end_request()
    await asyncio.sleep(2.0)
    scene.read(b"3")
    scene.reading.begin_request()
    assert scene.reading.request_came_s == 104.0


@pytest.mark.parametrize("is_web_socket", [False, True])
@inside(check)
async def test_bytes_behind_a_full_buffer_are_as_old_as_those_before_them(scene: Scene, is_web_socket: bool) -> None:
    if is_web_socket:
        scene.become_web_socket()
    size = READ_BYTES if is_web_socket else REQUEST_BYTES
    assert len(scene.reading.get_buffer(-1)) == size
    scene.read(bytes(size))
    await asyncio.sleep(0.01)
    scene.burn(0.99)
    scene.read(b"behind")
    assert scene.reading.came_s == 100.0
    await asyncio.sleep(1.0)
    scene.read(b"later")
    assert scene.reading.came_s == 102.0


@pytest.mark.parametrize("size", [3, REQUEST_BYTES])
@inside(check)
async def test_request_after_one_that_waited_for_its_turn_is_as_old_as_its_own_read(scene: Scene, size: int) -> None:
    scene.fill_turn()
    scene.read(bytes(size))
    assert scene.transport.is_paused
    scene.burn(0.6)
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert not scene.transport.is_paused
    scene.reading.begin_request()
    scene.reading.end_request()
    await asyncio.sleep(0.1)
    scene.read(b"GET")
    scene.reading.begin_request()
    assert scene.reading.request_came_s == scene.now_s


@inside(check)
async def test_bytes_that_waited_while_the_inner_protocol_had_paused_reading_are_as_old(scene: Scene) -> None:
    scene.become_web_socket()
    scene.inner.on_data = scene.transport.pause_reading
    scene.read(b"x")
    await asyncio.sleep(2.0)
    scene.transport.resume_reading()
    scene.reading.note_reading()
    scene.inner.on_data = lambda: None
    scene.read(b"y")
    assert scene.reading.came_s == 100.0
    await asyncio.sleep(1.0)
    scene.read(b"z")
    assert scene.reading.came_s == 103.0


@inside(check)
async def test_large_read_waits_for_its_turn_while_reading_is_paused(scene: Scene) -> None:
    data = bytes(range(256)) * (REQUEST_BYTES // 256)
    scene.read(data)
    assert (scene.received, scene.transport.is_paused) == (b"", True)
    await asyncio.sleep(0.001)
    assert (scene.received, scene.transport.is_paused) == (data, False)


@inside(check)
async def test_request_waits_while_another_client_has_the_turn(scene: Scene) -> None:
    scene.fill_turn()
    scene.read(b"GET")
    assert (scene.received, scene.transport.is_paused) == (b"", True)
    await asyncio.sleep(0.001)
    assert (scene.received, scene.transport.is_paused) == (b"GET", False)


@inside(check)
async def test_reading_that_the_inner_protocol_pauses_stays_paused(scene: Scene) -> None:
    scene.inner.on_data = scene.transport.pause_reading
    scene.read(bytes(REQUEST_BYTES))
    await asyncio.sleep(0.001)
    assert (len(scene.received), scene.transport.is_paused) == (REQUEST_BYTES, True)


@inside(check)
async def test_held_bytes_of_a_closed_connection_are_dropped(scene: Scene) -> None:
    scene.read(bytes(REQUEST_BYTES))
    scene.transport.close()
    scene.reading.connection_lost(None)
    await asyncio.sleep(0.001)
    assert (scene.received, scene.inner.calls[:2]) == (b"", ["made", "lost"])
    assert len(scene.connections) == 0


@inside(check)
async def test_held_bytes_of_a_closing_connection_are_passed_on_without_reading_more(scene: Scene) -> None:
    scene.read(bytes(REQUEST_BYTES))
    scene.transport.is_closed = True
    await asyncio.sleep(0.001)
    assert (len(scene.received), scene.transport.is_paused) == (REQUEST_BYTES, True)


@inside(check)
async def test_refused_body_is_not_read(scene: Scene) -> None:
    scene.read(b"POST")
    scene.reading.refuse_body()
    scene.read(b"body")
    await asyncio.sleep(1.0)
    assert (scene.received, scene.transport.is_paused) == (b"POST", True)


@inside(check)
async def test_connection_waits_before_a_request_in_a_body_and_after_an_answer(scene: Scene) -> None:
    overdue = scene.connections.overdue
    scene.reading.begin_request()
    assert overdue(1e6) == []
    with scene.reading.receiving_body():
        assert overdue(100.0 + IDLE_TIMEOUT_S - 0.1) == []
        assert scene.connections._waiting
    assert overdue(1e6) == []
    scene.reading.end_request()
    assert overdue(100.0 + IDLE_TIMEOUT_S) == [scene.connection]


@inside(check)
async def test_web_socket_message_is_passed_on_at_once_even_in_a_used_up_turn(scene: Scene) -> None:
    scene.become_web_socket()
    scene.fill_turn()
    scene.read(bytes(READ_BYTES))
    assert (len(scene.received), len(scene.reads)) == (READ_BYTES, 1)
    assert (scene.reading.unread_bytes, scene.share.held_bytes) == (READ_BYTES, 0)
    scene.reading.leave_web_socket()
    scene.reading.unread_bytes = 0
    scene.read(b"x")
    assert len(scene.reads) == 1


@inside(check)
async def test_large_web_socket_message_takes_room_until_it_is_given_back(scene: Scene) -> None:
    scene.become_web_socket()
    scene.read(bytes(LARGE_BYTES))
    assert (scene.reading.has_room, scene.share.held_bytes) == (False, 0)
    scene.read(b"x")
    room = min(scene.hub.config.table("api", ApiConfig).max_message_bytes, scene.share.max_bytes)
    assert (scene.reading.has_room, scene.share.held_bytes) == (True, room)
    scene.read(b"x")
    assert scene.share.held_bytes == room
    scene.reading.give_room()
    scene.reading.give_room()
    assert (scene.reading.has_room, scene.share.held_bytes) == (False, 0)
    await asyncio.sleep(2 * TIMEOUT_S)
    assert not scene.transport.is_closed


@inside(check)
async def test_large_web_socket_message_that_does_not_end_is_aborted_after_the_timeout(scene: Scene) -> None:
    scene.become_web_socket()
    scene.read(bytes(LARGE_BYTES))
    scene.read(b"x")
    await asyncio.sleep(TIMEOUT_S - 0.1)
    assert not scene.transport.is_closed
    await asyncio.sleep(0.2)
    assert (scene.transport.is_closed, scene.share.held_bytes) == (True, 0)


@inside(check)
async def test_large_web_socket_message_waits_until_the_budget_has_room(scene: Scene) -> None:
    scene.become_web_socket()
    scene.share.add(scene.share.max_bytes)
    scene.read(bytes(LARGE_BYTES))
    scene.read(b"rest")
    assert (len(scene.received), scene.transport.is_paused) == (LARGE_BYTES, True)
    scene.share.give(1)
    assert (len(scene.received), scene.transport.is_paused) == (LARGE_BYTES, True)
    await asyncio.sleep(5.0)
    scene.share.give(scene.share.held_bytes)
    assert (scene.received[LARGE_BYTES:], scene.transport.is_paused) == (b"rest", False)
    assert (scene.reading.unread_bytes, scene.reading.has_room) == (LARGE_BYTES + 4, True)
    scene.read(b"after")
    assert scene.reading.came_s == 100.0  # it may have waited in the socket as long


@inside(check)
async def test_lost_web_socket_that_waits_for_room_takes_none(scene: Scene) -> None:
    scene.become_web_socket()
    scene.share.add(scene.share.max_bytes)
    scene.read(bytes(LARGE_BYTES))
    scene.read(b"rest")
    scene.reading.connection_lost(None)
    scene.share.give(scene.share.max_bytes)
    assert (scene.share.held_bytes, len(scene.received)) == (0, LARGE_BYTES)


@inside(check)
async def test_pings_do_not_count_as_bytes_of_a_message(scene: Scene) -> None:
    scene.become_web_socket()
    scene.read(bytes(CONTROL_FRAME_BYTES + 4))
    scene.reading.receive_control(4)
    assert scene.reading.unread_bytes == 0
    scene.reading.receive_control(4)
    assert scene.reading.unread_bytes == 0
    scene.read(bytes(100))
    scene.reading.receive_control(4)
    assert scene.reading.unread_bytes == 100 - 4 - CONTROL_FRAME_BYTES


@inside(check)
async def test_paused_web_socket_leaves_bytes_in_the_socket_and_they_are_as_old(scene: Scene) -> None:
    scene.become_web_socket()
    scene.read(b"x")
    scene.reading.pause()
    assert scene.transport.is_paused
    await asyncio.sleep(2.0)
    scene.reading.resume()
    scene.read(b"y")
    assert (scene.received, scene.reading.came_s) == (b"xy", 100.0)
    await asyncio.sleep(1.0)
    scene.read(b"z")
    assert scene.reading.came_s == 103.0


@inside(check)
async def test_web_socket_that_the_inner_protocol_has_paused_is_resumed_by_it_alone(scene: Scene) -> None:
    scene.become_web_socket()
    scene.inner.on_data = scene.transport.pause_reading
    scene.read(b"x")
    scene.reading.pause()
    scene.reading.resume()
    assert scene.transport.is_paused


@inside(check)
async def test_paused_web_socket_that_is_closed_stays_paused(scene: Scene) -> None:
    scene.become_web_socket()
    scene.reading.pause()
    scene.transport.close()
    scene.reading.resume()
    assert scene.transport.is_paused


@inside(check)
async def test_web_socket_is_read_in_small_pieces_except_the_rest_of_a_large_message(scene: Scene) -> None:
    scene.become_web_socket()
    assert len(scene.reading.get_buffer(-1)) == READ_BYTES
    scene.read(bytes(READ_BYTES - 1))
    assert len(scene.reading.get_buffer(-1)) == READ_BYTES
    scene.read(b"x")
    assert len(scene.reading.get_buffer(-1)) == SOCKET_BYTES
    scene.reading.unread_bytes = 0  # the message was received
    assert len(scene.reading.get_buffer(-1)) == READ_BYTES


@inside(check)
async def test_writing_that_may_continue_calls_the_web_socket(scene: Scene) -> None:
    calls: list[str] = []
    scene.reading.become_web_socket(
        on_message=lambda _: False,
        on_read=lambda: None,
        on_full=lambda: calls.append("full"),
        on_writable=lambda: calls.append("writable"),
    )
    scene.reading.pause_writing()
    assert (scene.reading.is_writing_paused, calls) == (True, ["full"])
    scene.reading.resume_writing()
    assert (scene.reading.is_writing_paused, calls) == (False, ["full", "writable"])
    assert scene.inner.calls == ["made", "paused", "resumed"]


@inside(check)
async def test_abort_of_a_connection_closes_its_transport(scene: Scene) -> None:
    scene.connection.abort()
    assert scene.transport.is_closed
    ApiConnection("127.0.0.1").abort()  # not accepted yet: nothing to close


# -- messages that are read alone -------------------------------------------------------------------------------------

HEAD = b"GET / HTTP/1.1\r\n\r\n"


def message(payload: bytes) -> bytes:
    return bytes((0x81, 0x80 | len(payload))) + bytes(4) + payload  # this mask changes nothing


@inside(check)
async def test_message_read_alone_is_offered_and_passed_on_if_it_is_not_taken(scene: Scene) -> None:
    scene.read(HEAD)
    scene.become_web_socket()
    scene.read(message(b"one"))
    assert (scene.messages, scene.received, scene.reads) == ([b"one"], HEAD, [])
    scene.takes = False
    scene.read(message(b"two"))
    assert (scene.messages, scene.received) == ([b"one", b"two"], HEAD + message(b"two"))
    assert scene.reads == [None]


@inside(check)
async def test_message_with_others_around_it_is_not_offered(scene: Scene) -> None:
    scene.read(HEAD)
    scene.become_web_socket()
    scene.read(message(b"one") + message(b"two"))
    scene.read(message(b"three"))  # those before it are not received yet
    assert scene.messages == []
    scene.reading.unread_bytes = 0
    scene.read(message(b"four")[:4])
    scene.read(message(b"four")[4:])
    scene.reading.unread_bytes = 0
    scene.read(message(b"five"))
    assert scene.messages == [b"five"]
    size = len(scene.reading.get_buffer(-1))
    long = b"\x81\xfe" + (size - 8).to_bytes(2) + bytes(4) + b"x" * (size - 8)
    scene.read(long)  # more may be behind it
    assert scene.messages == [b"five"]


@pytest.mark.parametrize("behind", [b"\x81", message(b"early"), message(b"early")[:5]])
@inside(check)
async def test_message_is_not_offered_where_bytes_came_with_the_handshake(scene: Scene, behind: bytes) -> None:
    scene.read(HEAD + behind)
    scene.become_web_socket()
    scene.read(message(b"one"))
    assert scene.messages == []


@inside(check)
async def test_message_is_not_offered_when_the_web_socket_has_ended(scene: Scene) -> None:
    scene.read(HEAD)
    scene.become_web_socket()
    scene.reading.leave_web_socket()
    scene.read(message(b"one"))
    assert (scene.messages, scene.received) == ([], HEAD + message(b"one"))
