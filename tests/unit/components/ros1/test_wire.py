"""Wire of TCPROS and ports of this node, without sockets: reading in pieces, writing in batches, and their ends."""

import asyncio
import contextlib
import socket
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from structlog.testing import capture_logs

from hostlink.components.ros1.connections import BATCH_BYTES, CLOSE_TIMEOUT_S, PIECE_BYTES, Port, Wire
from hostlink.components.ros1.local_node import Ros1Counts
from hostlink.components.ros1.tcpros import decode_header, encode_message
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.queue import MAX_MESSAGES, MAX_RESULTS
from tests.support.api_memory import ApiTransport
from tests.support.fake_device import CATALOG
from tests.support.hosts import host_in
from tests.support.virtual_loop import run_virtual


class Scene:
    """A wire whose bytes the test delivers and reads."""

    def __init__(self, *, reraises: bool = True) -> None:
        self.hub = Hub(Config(), CATALOG, reraises=reraises)
        self.received: list[list[bytes]] = []
        self.ends = 0
        self.wire = Wire(host_in(self.hub), self.received.append, self._end)
        self.transport = ApiTransport("10.0.0.9")
        self.transport.protocol = self.wire
        self.wire.connection_made(self.transport)

    def _end(self) -> None:
        self.ends += 1

    def arrive(self, data: bytes) -> None:
        self.wire.data_received(data)

    @property
    def messages(self) -> list[bytes]:
        return [message for read in self.received for message in read]


def check(test: Callable[[Scene], Awaitable[None]], *, reraises: bool = True) -> None:
    async def run() -> None:
        await test(Scene(reraises=reraises))

    with capture_logs():
        run_virtual(run())


def test_wire_names_its_peer_and_passes_messages_on() -> None:
    async def test(scene: Scene) -> None:
        assert scene.wire.peer == "10.0.0.9:40000"
        data = encode_message(b"one") + encode_message(b"two")
        scene.arrive(data[:9])
        await asyncio.sleep(0.01)
        assert scene.messages == [b"one"]
        scene.arrive(data[9:])
        await asyncio.sleep(0.01)
        assert scene.messages == [b"one", b"two"]

    check(test)


def test_small_messages_are_read_in_pieces_and_a_large_one_at_once() -> None:
    async def test(scene: Scene) -> None:
        small = encode_message(bytes(12))
        scene.arrive(small * 100)
        await asyncio.sleep(0.01)
        assert scene.messages == [bytes(12)] * 100
        assert max(map(len, scene.received)) == PIECE_BYTES // len(small)
        scene.received.clear()
        large = encode_message(bytes(10 * PIECE_BYTES))
        scene.arrive(large)
        await asyncio.sleep(0.01)
        assert scene.received == [[bytes(10 * PIECE_BYTES)]]

    check(test)


def test_header_is_written_at_once_and_messages_of_a_turn_together() -> None:
    async def test(scene: Scene) -> None:
        scene.wire.send_header({"callerid": "/here"})
        assert decode_header(bytes(scene.transport.written)[4:]) == {"callerid": "/here"}
        scene.transport.written.clear()
        scene.wire.send(b"one")
        scene.wire.send(b"two")
        assert scene.transport.written == b""
        await asyncio.sleep(0)
        assert scene.transport.written == b"onetwo"

    check(test)


def test_messages_wait_while_writing_is_paused_and_leave_afterwards() -> None:
    async def test(scene: Scene) -> None:
        scene.wire.pause_writing()
        scene.wire.send(bytes(BATCH_BYTES))
        scene.wire.send(b"last")
        await asyncio.sleep(0.01)
        assert (scene.transport.written, scene.wire.outgoing.waiting_messages) == (b"", 2)
        scene.wire.resume_writing()
        assert scene.transport.written == bytes(BATCH_BYTES) + b"last"
        scene.wire.send(b"more")
        await asyncio.sleep(0)
        assert scene.transport.written.endswith(b"more")

    check(test)


def test_batch_has_an_end() -> None:
    async def test(scene: Scene) -> None:
        scene.wire.pause_writing()
        for _ in range(100):
            scene.wire.send(bytes(1000))
        written: list[bytes] = []
        transport: Any = scene.transport
        transport.write = written.append
        scene.wire.resume_writing()
        assert BATCH_BYTES <= len(written[0]) < BATCH_BYTES + 1000
        assert sum(map(len, written)) == 100_000

    check(test)


def test_messages_for_a_slow_node_are_held_by_the_budget_of_all_clients_and_lost_with_it() -> None:
    async def test(scene: Scene) -> None:
        share = scene.hub.budget["queues"]
        scene.wire.pause_writing()
        for _ in range(MAX_MESSAGES + 3):
            scene.wire.send(bytes(10))
        assert (scene.wire.outgoing.dropped, share.held_bytes) == (3, 10 * MAX_MESSAGES)
        scene.wire.close()
        scene.wire.send(b"late")
        assert share.held_bytes == 0

    check(test)


def test_answer_is_kept_where_messages_are_dropped() -> None:
    async def test(scene: Scene) -> None:
        scene.wire.pause_writing()
        scene.wire.send(b"answer", is_answer=True)
        for _ in range(MAX_MESSAGES + 1):
            scene.wire.send(b"x")
        scene.wire.resume_writing()
        assert scene.transport.written == b"answer" + b"x" * MAX_MESSAGES

    check(test)


def test_node_that_reads_no_answers_is_cut_off() -> None:
    async def test(scene: Scene) -> None:
        scene.wire.pause_writing()
        for _ in range(MAX_RESULTS):
            scene.wire.send(b"answer", is_answer=True)
        assert not scene.wire.is_closed
        scene.wire.send(b"answer", is_answer=True)
        assert scene.wire.is_closed

    check(test)


def test_refused_header_is_answered_with_the_reason_before_the_end() -> None:
    async def test(scene: Scene) -> None:
        scene.wire.refuse("unknown topic")
        assert decode_header(bytes(scene.transport.written)[4:]) == {"error": "unknown topic"}
        assert (scene.wire.is_closed, scene.transport.is_closed, scene.ends) == (True, True, 1)

    check(test)


def test_closed_wire_ends_once_writes_nothing_and_is_aborted_after_a_time() -> None:
    async def test(scene: Scene) -> None:
        aborted: list[float] = []
        transport: Any = scene.transport
        transport.abort = lambda: aborted.append(asyncio.get_running_loop().time())
        scene.wire.send(b"late")
        scene.wire.close()
        scene.wire.close()
        await asyncio.sleep(10 * CLOSE_TIMEOUT_S)
        assert (scene.ends, scene.transport.written, aborted) == (1, b"", [CLOSE_TIMEOUT_S])

    check(test)


def test_wire_closes_when_its_peer_is_lost() -> None:
    async def test(scene: Scene) -> None:
        scene.wire.connection_lost(None)
        await asyncio.sleep(0.01)
        assert (scene.wire.is_closed, scene.ends) == (True, 1)

    check(test)


def test_fault_of_hostlink_ends_its_wire_alone() -> None:
    async def test(scene: Scene) -> None:
        def fail(_: list[bytes]) -> None:
            raise ZeroDivisionError

        scene.wire.receive = fail
        scene.arrive(encode_message(b"one"))
        await asyncio.sleep(0.01)
        assert (scene.wire.is_closed, scene.ends) == (True, 1)

    check(test, reraises=False)


class OpenConnection:
    """An accepted connection, of which Port asks only this."""

    def __init__(self, *, is_replaceable: bool) -> None:
        self.is_replaceable, self.is_closed = is_replaceable, False

    def is_closing(self) -> bool:
        return self.is_closed

    def abort(self) -> None:
        self.is_closed = True

    close = abort


@pytest.mark.parametrize("is_replaceable", [False, True])
def test_full_port_gives_the_place_of_its_oldest_replaceable_connection(is_replaceable: bool) -> None:
    counts = Ros1Counts()
    port = Port(counts, allow=(), max_connections=3)
    made: Any = [OpenConnection(is_replaceable=each) for each in (False, is_replaceable, is_replaceable)]
    port._open = {each: each for each in made}
    assert port.admits("10.0.0.1") is is_replaceable
    assert [each.is_closed for each in made] == [False, is_replaceable, False]
    assert counts.refused_connections == is_replaceable
    made[0].close()
    assert port.admits("10.0.0.1")  # a closing connection holds no place
    port.close()
    assert all(each.is_closed for each in port._open)


class Peerless(asyncio.Protocol):
    """Protocol of a connection that says nothing."""

    is_replaceable = True


async def test_port_that_is_closed_in_any_turn_after_an_accept_leaves_no_connection_open() -> None:
    loop = asyncio.get_running_loop()
    for turns in range(12):
        port = Port(Ros1Counts(), allow=(), max_connections=3)
        number = await port.bind("127.0.0.1", 0)
        async with asyncio.TaskGroup() as tasks:
            began = asyncio.Event()

            def spawn(work: Any, *, name: str, began: asyncio.Event = began, tasks: Any = tasks) -> None:
                tasks.create_task(work, name=name)
                began.set()

            port.accept(Peerless, spawn)
            with socket.socket() as client:
                client.setblocking(False)
                await loop.sock_connect(client, ("127.0.0.1", number))
                await began.wait()
                for _ in range(turns):
                    await asyncio.sleep(0)
                port.close()
                with contextlib.suppress(ConnectionResetError):
                    async with asyncio.timeout(10.0):
                        assert await loop.sock_recv(client, 1) == b""
