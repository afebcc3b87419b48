"""ClientSocket without a socket: execution and writes of one turn of the loop, and when a client is disconnected."""

import asyncio
import contextlib
import json
from collections import Counter
from collections.abc import AsyncIterator, Callable
from typing import Any, cast

import pytest
from aiohttp import WSMessage, WSMsgType, web
from structlog.testing import capture_logs

from hostlink.components.gateway.clients import MAX_MESSAGES, Client, ClientQueue, Operation, Outgoing, VelocityOf
from hostlink.components.gateway.listener import PacedReading
from hostlink.components.gateway.web_socket import (
    PING_INTERVAL_S,
    READY_TIMEOUT_S,
    SEND_BATCH,
    SEND_TIMEOUT_S,
    ClientSocket,
)
from hostlink.components.gateway.write_pace import LEAST_BYTES, SLOW_S, WRITE_BYTES
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.queue import MAX_RESULTS
from hostlink.core.link.fair_share import TURN_S, URGENT_PIECES, URGENT_TURN_S
from hostlink.core.runtime.latency import Latency
from tests.support.fake_device import CATALOG
from tests.support.hosts import host_in
from tests.support.logs import logged
from tests.support.virtual_loop import run_virtual, virtual


class Socket:
    """Fake of what ClientSocket uses of aiohttp's WebSocket, its connection and the API's client."""

    def __init__(self) -> None:
        self.messages = asyncio.Queue[WSMessage]()
        self.written: list[bytes] = []
        self.pings = 0
        self.close_code: int | None = None
        self.closed = self.is_writing_paused = self.is_paused = False
        self.came_s = 0.0
        self.reads = self.unread_bytes = 0
        self.has_room = False
        self.transport = self
        self.kind = "rosbridge"
        self.messages_from_client = self.messages_to_client = self.bytes_to_client = 0
        self.on_message: Callable[[bytes], bool]
        self.on_read: Callable[[], None]
        self.on_full: Callable[[], None]
        self.on_writable: Callable[[], None]

    def put(self, *texts: str) -> None:
        """Messages of one read."""
        for text in texts:
            self.messages.put_nowait(WSMessage(WSMsgType.TEXT, text, None))

    async def receive(self) -> WSMessage:
        return await self.messages.get()

    async def ping(self) -> None:
        self.pings += 1

    async def close(self, *, code: int, message: bytes, drain: bool) -> None:  # noqa: ARG002 - aiohttp's signature
        self.close_code, self.closed = code, True

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def is_closing(self) -> bool:
        return self.closed

    def become_web_socket(
        self,
        *,
        on_message: Callable[[bytes], bool],
        on_read: Callable[[], None],
        on_full: Callable[[], None],
        on_writable: Callable[[], None],
    ) -> None:
        self.on_message = on_message
        self.on_read, self.on_full, self.on_writable = on_read, on_full, on_writable

    def fill(self, for_s: float) -> None:
        """Let the system take nothing for some time."""
        self.is_writing_paused = True
        self.on_full()
        asyncio.get_running_loop().call_later(for_s, self._take_all)

    def _take_all(self) -> None:
        self.is_writing_paused = False
        self.on_writable()

    def pause(self) -> None:
        self.is_paused = True

    def resume(self) -> None:
        self.is_paused = False

    def note_reading(self) -> None: ...
    def leave_web_socket(self) -> None: ...
    def receive_control(self, _: int) -> None: ...


class Echo:
    """A program that answers each word with the word; `fail` fails, `robot=2` is a velocity, `call` is a call."""

    def __init__(self, queue: ClientQueue, tasks: asyncio.TaskGroup) -> None:
        self.queue, self.done, self.calls, self.is_closed = queue, list[str](), 0, False
        self._tasks = tasks
        self.held_back: list[tuple[float, str]] = []  # what is due, and when

    def take(self, data: bytes, came_s: float) -> bool:  # noqa: ARG002 - of a program
        is_plain = b"=" in data
        if is_plain:
            self.done.append(data.decode())
            self.queue.put_result(Outgoing(data))
        return is_plain

    def read(self, data: str | bytes, came_s: float) -> Operation[str]:
        robot, is_velocity, value = str(data).partition("=")
        return Operation(str(data), came_s, VelocityOf("drive", robot) if is_velocity else None, value == "0")

    def do(self, operation: Operation[str]) -> None:
        if operation.content == "fail":
            raise ValueError("a defect")
        if operation.content == "call":
            self.calls += 1
            self._tasks.create_task(self._call())
            return
        self.done.append(operation.content)
        self.queue.put_result(Outgoing(operation.content.encode()))

    async def _call(self) -> None:
        self.done.append("call")
        await asyncio.sleep(1.0)
        self.calls -= 1

    def flush(self, now_s: float) -> float | None:
        for due_s, word in list(self.held_back):
            if due_s <= now_s:
                self.held_back.remove((due_s, word))
                self.queue.put_message("topic", Outgoing(word.encode()))
        return min((due_s for due_s, _ in self.held_back), default=None)

    def close(self) -> None:
        self.is_closed = True


class Connected:
    """One ClientSocket that runs."""

    def __init__(self, tasks: asyncio.TaskGroup, kind: str, max_messages_s: float) -> None:
        self.socket, self.queue = Socket(), ClientQueue()
        self.socket.kind = kind
        self.program, self.latency = Echo(self.queue, tasks), Latency()
        self.hub, self._replaced = Hub(Config(), CATALOG), Counter[str]()
        self.connection = ClientSocket(
            cast(web.WebSocketResponse, self.socket),
            cast(PacedReading, self.socket),
            cast(Client, self.socket),
            cast(Any, self.program),
            self.queue,
            host_in(self.hub),
            tasks=tasks,
            to_client=self.latency,
            replaced=self._replaced,
            max_messages_s=max_messages_s,
        )
        tasks.create_task(self.connection.receive())

    @property
    def replaced(self) -> int:
        return self._replaced.total()

    def written(self) -> list[bytes]:
        """Payloads of short frames, one list item for each write."""
        return [data[2:] for data in self.socket.written]

    async def leave(self) -> None:
        self.socket.messages.put_nowait(WSMessage(WSMsgType.CLOSE, None, None))
        await asyncio.sleep(0.01)


@contextlib.asynccontextmanager
async def connected(kind: str = "rosbridge", max_messages_s: float = 1000.0) -> AsyncIterator[Connected]:
    async with asyncio.TaskGroup() as tasks:
        made = Connected(tasks, kind, max_messages_s)
        await asyncio.sleep(0.01)
        yield made
        if not made.socket.closed:
            await made.leave()
            assert made.program.is_closed


def test_messages_of_one_read_are_answered_in_one_write() -> None:
    async def run() -> None:
        async with connected() as client:
            client.socket.put("one", "two", "three")
            await asyncio.sleep(0.01)
            assert client.socket.written == [b"\x81\x03one\x81\x03two\x81\x05three"]
            assert (client.socket.messages_from_client, client.socket.messages_to_client) == (3, 3)
            assert client.socket.bytes_to_client == len("onetwothree")
            assert sum(client.latency.counts) == 3

    run_virtual(run())


def test_velocities_of_one_read_only_the_newest_is_executed() -> None:
    async def run() -> None:
        async with connected() as client:
            client.socket.put("a=1", "a=2", "a=3")
            await asyncio.sleep(0.01)
            assert (client.program.done, client.replaced) == (["a=3"], 2)

    run_virtual(run())


def test_messages_of_a_topic_that_are_queued_in_one_turn_are_one_write() -> None:
    async def run() -> None:
        async with connected() as client:
            for word in (b"a", b"b"):
                client.queue.put_message("topic", Outgoing(word, is_binary=True, before=b"time"))
            await asyncio.sleep(0.01)
            assert client.socket.written == [b"\x82\x04time\x82\x01a\x82\x04time\x82\x01b"]

    run_virtual(run())


def test_many_messages_are_written_in_batches() -> None:
    async def run() -> None:
        async with connected() as client:
            for _ in range(SEND_BATCH + 1):
                client.queue.put_message("topic", Outgoing(b"x"))
            await asyncio.sleep(0.01)
            assert [len(data) for data in client.socket.written] == [3 * SEND_BATCH, 3]

    run_virtual(run())


def test_write_ends_with_the_message_that_fills_it() -> None:
    async def run() -> None:
        async with connected() as client:
            for size in (WRITE_BYTES - 1, 1, 1):
                client.queue.put_message("topic", Outgoing(b"x" * size))
            await asyncio.sleep(0.01)
            assert len(client.socket.written) == 2

    run_virtual(run())


def test_messages_wait_while_the_transport_is_full() -> None:
    async def run() -> None:
        async with connected() as client:
            client.socket.is_writing_paused = True
            client.queue.put_message("topic", Outgoing(b"x"))
            await asyncio.sleep(0.01)
            assert client.socket.written == []
            assert client.queue.waiting_messages == 1
            client.socket.is_writing_paused = False
            client.socket.on_writable()
            await asyncio.sleep(0.01)
            assert client.written() == [b"x"]

    run_virtual(run())


@pytest.mark.parametrize("is_full", [False, True])
@pytest.mark.parametrize("read_s", [0.0, 1.0])
def test_client_that_leaves_before_it_has_read_its_answers_is_let_go(is_full: bool, read_s: float) -> None:
    async def run() -> None:
        async with connected() as client:
            words = [str(number) for number in range(MAX_RESULTS)]
            client.socket.is_writing_paused = is_full
            client.socket.put(*words)
            await asyncio.sleep(read_s)
            client.socket.closed = True
            client.socket.messages.put_nowait(WSMessage(WSMsgType.CLOSE, None, None))
            await asyncio.sleep(0.1)
            assert client.program.done == words
            assert client.program.is_closed

    run_virtual(run())


def test_client_that_does_not_read_is_disconnected() -> None:
    async def run() -> None:
        async with connected() as client:

            def fill(data: bytes) -> None:
                client.socket.is_writing_paused = True
                client.socket.written.append(data)
                client.socket.on_full()

            client.socket.write = fill  # type: ignore[method-assign]
            client.queue.put_message("topic", Outgoing(b"x"))
            await asyncio.sleep(SEND_TIMEOUT_S - 0.1)
            client.socket.on_writable()
            client.socket.is_writing_paused = False
            client.socket.reads += 1  # it sends something
            client.queue.put_message("topic", Outgoing(b"x"))
            await asyncio.sleep(SEND_TIMEOUT_S + 0.1)
            raise AssertionError("it was not cut off")

    with pytest.raises(ExceptionGroup) as caught:
        run_virtual(run())
    assert caught.group_contains(TimeoutError, match="it does not read")


def test_client_that_is_silent_is_pinged_and_then_disconnected() -> None:
    async def run() -> None:
        async with connected() as client:
            await asyncio.sleep(PING_INTERVAL_S / 2)
            client.socket.reads += 1
            await asyncio.sleep(PING_INTERVAL_S)
            assert client.socket.written == []
            await asyncio.sleep(PING_INTERVAL_S / 2 + 0.1)
            assert client.socket.written == [b"\x89\x00"]
            client.socket.reads += 1  # its pong
            await asyncio.sleep(1.5 * PING_INTERVAL_S)
            assert client.socket.written == [b"\x89\x00"] * 2
            await asyncio.sleep(PING_INTERVAL_S / 2)
            raise AssertionError("it was not cut off")

    with pytest.raises(ExceptionGroup) as caught:
        run_virtual(run())
    assert caught.group_contains(TimeoutError, match="it answers no ping")


def test_client_with_too_many_answers_is_closed_and_logged() -> None:
    async def run() -> Connected | None:
        client = None
        with contextlib.suppress(*[ExceptionGroup]):
            async with connected() as client:
                for _ in range(MAX_RESULTS + 1):
                    client.queue.put_result(Outgoing(b"x"))
                await asyncio.sleep(0.01)
        return client

    with capture_logs() as lines:
        client = run_virtual(run())
    assert client is not None
    assert client.socket.close_code == 1008
    assert logged(lines) == ["client.too_slow"]


def test_client_whose_participant_ended_is_closed() -> None:
    async def run() -> Connected | None:
        client = None
        with contextlib.suppress(*[ExceptionGroup]):
            async with connected() as client:
                client.queue.close()
                await asyncio.sleep(0.01)
        return client

    client = run_virtual(run())
    assert client is not None
    assert client.socket.close_code == 1011


def test_exception_ends_the_tasks_of_the_client() -> None:
    async def run() -> None:
        async with connected() as client:
            client.socket.put("fail")
            await asyncio.sleep(1)

    with pytest.raises(ExceptionGroup) as caught:
        run_virtual(run())
    assert caught.group_contains(ValueError, match="a defect")


def test_flood_of_messages_is_refused() -> None:
    async def run() -> Connected:
        async with connected(max_messages_s=10.0) as client:
            client.socket.put(*["x"] * 21)
            await asyncio.sleep(0.01)
            assert client.socket.close_code == 1008
            return client

    with capture_logs() as lines:
        assert run_virtual(run()).program.is_closed
    assert lines[0]["event"] == "client.too_fast"


def test_two_seconds_of_messages_at_once_are_accepted() -> None:
    async def run() -> None:
        async with connected(max_messages_s=10.0) as client:
            client.socket.put(*["x"] * 20)
            await asyncio.sleep(0.01)
            assert client.socket.close_code is None
            assert len(client.program.done) == 20

    run_virtual(run())


@pytest.mark.parametrize("answers", [True, False])
def test_foxglove_client_is_sent_nothing_before_a_pong_or_a_second(answers: bool) -> None:
    async def run() -> None:
        async with connected("foxglove") as client:
            client.queue.put_result(Outgoing(b"hello"))
            await asyncio.sleep(0.1)
            assert (client.socket.pings, client.socket.written) == (1, [])
            if answers:
                client.socket.messages.put_nowait(WSMessage(WSMsgType.PONG, b"", None))
                await asyncio.sleep(0.01)
            else:
                await asyncio.sleep(READY_TIMEOUT_S)
            assert client.written() == [b"hello"]

    run_virtual(run())


def test_ping_is_answered() -> None:
    async def run() -> None:
        async with connected() as client:
            client.socket.messages.put_nowait(WSMessage(WSMsgType.PING, b"no", None))
            await asyncio.sleep(0.01)
            assert client.socket.written == [b"\x8a\x02no"]

    run_virtual(run())


def test_pings_of_a_client_that_does_not_read_delay_no_command_and_the_last_is_answered() -> None:
    async def run() -> None:
        async with connected() as client:
            client.socket.fill(for_s=3.0)
            for number in range(3):
                client.socket.messages.put_nowait(WSMessage(WSMsgType.PING, str(number).encode(), None))
            client.socket.put("stop")
            await asyncio.sleep(0.01)
            assert client.program.done == ["stop"]
            assert client.socket.written == []
            await asyncio.sleep(3.0)
            assert client.socket.written[:1] == [b"\x8a\x012"]

    run_virtual(run())


def pong(client: Connected, number: int) -> None:
    client.socket.messages.put_nowait(WSMessage(WSMsgType.PONG, str(number).encode(), None))


def test_client_that_was_slow_gets_the_next_piece_when_it_has_read_the_one_before() -> None:
    """A client that reads fast again gets all at once."""

    async def run() -> None:
        async with connected() as client:
            client.socket.fill(for_s=SLOW_S)
            piece = bytes(LEAST_BYTES // 2)
            for _ in range(200):
                client.queue.put_message("topic", Outgoing(piece))
            await asyncio.sleep(5.0)
            written = client.socket.written
            assert [data.count(piece) for data in written] == [2]
            assert written[0].endswith(b"\x89\x011")
            pong(client, 0)
            await asyncio.sleep(0.01)
            assert len(written) == 1
            pong(client, 1)
            await asyncio.sleep(SLOW_S)
            pong(client, 2)
            await asyncio.sleep(0.01)
            for number in range(3, 7):
                pong(client, number)
                await asyncio.sleep(0.01)
            assert [data.count(piece) for data in written] == [2, 2, 2, 4, 8, 16, 32, 32, 32, 32, 32, 6]
            assert [b"\x89" in data for data in written] == 6 * [True] + 6 * [False]
            assert client.queue.waiting_messages == 0

    run_virtual(run())


def test_slow_client_that_answers_no_ping_is_sent_all_after_a_while() -> None:
    async def run() -> None:
        async with connected() as client:
            client.socket.fill(for_s=SLOW_S)
            for _ in range(20):
                client.queue.put_message("topic", Outgoing(bytes(LEAST_BYTES)))
            await asyncio.sleep(SEND_TIMEOUT_S / 2)
            client.socket.reads += 1  # it sends something
            await asyncio.sleep(SEND_TIMEOUT_S / 2)
            assert len(client.socket.written) == 1
            await asyncio.sleep(1.0)
            assert client.queue.waiting_messages == 0

    run_virtual(run())


def test_slow_client_whose_operations_have_no_room_is_not_waited_for() -> None:
    """The pong is behind messages that are not read before the answers have room."""

    async def run() -> None:
        async with connected() as client:
            client.socket.fill(for_s=SLOW_S)
            words = [f"{number:03}" for number in range(3 * MAX_RESULTS)]
            client.socket.put(*words)
            pongs: list[int] = []

            def answer(data: bytes) -> None:
                client.socket.written.append(data)
                if b"\x89" in data:
                    pongs.append(int(data.partition(b"\x89")[2][1:]))
                    pong(client, pongs[-1])

            client.socket.write = answer  # type: ignore[method-assign]
            await asyncio.sleep(1.0)
            assert pongs
            assert client.program.done == words
            assert b"".join(client.socket.written).count(b"\x81\x03") == len(words)

    run_virtual(run())


def test_client_is_not_read_from_while_its_operations_have_no_room() -> None:
    async def run() -> None:
        async with connected() as client:
            client.socket.fill(for_s=SLOW_S / 2)
            client.socket.put(*map(str, range(MAX_RESULTS // 2 + MAX_MESSAGES + 10)))
            await asyncio.sleep(SLOW_S / 4)
            assert client.socket.is_paused
            await asyncio.sleep(SLOW_S / 2)
            assert not client.socket.is_paused

    run_virtual(run())


def test_throttled_message_is_sent_when_due() -> None:
    async def run() -> None:
        async with connected() as client:
            now_s = asyncio.get_running_loop().time()
            client.program.held_back = [(now_s + 2.0, "late"), (now_s + 1.0, "soon")]
            client.queue.wake()
            await asyncio.sleep(0.9)
            assert client.socket.written == []
            await asyncio.sleep(0.2)
            assert client.written() == [b"soon"]
            await asyncio.sleep(1.0)
            assert client.written() == [b"soon", b"late"]

    run_virtual(run())


def test_operations_of_a_client_that_leaves_are_executed() -> None:
    async def run() -> None:
        async with connected() as client:
            client.socket.put("one", "two")
            await client.leave()
            assert client.program.done == ["one", "two"]

    run_virtual(run())


def test_call_begins_before_the_operations_behind_it() -> None:
    async def run() -> None:
        async with connected() as client:
            words = ["a=1", "call", "a=2", "call", "call", "one"]
            client.socket.put(*words)
            await asyncio.sleep(0.01)
            assert client.program.done == words

    run_virtual(run())


def test_call_of_a_client_that_leaves_begins_before_its_end() -> None:
    async def run() -> None:
        async with connected() as client:
            client.socket.put("one", "call")
            client.program.close = lambda: client.program.done.append("end")  # type: ignore[method-assign]
            await client.leave()
            assert client.program.done == ["one", "call", "end"]
            client.program.is_closed = client.socket.closed = True

    run_virtual(run())


def test_operations_wait_while_answers_have_no_room() -> None:
    async def run() -> None:
        async with connected(max_messages_s=1e6) as client:
            client.socket.is_writing_paused = True
            client.socket.put(*[json.dumps(number) for number in range(200)])
            await asyncio.sleep(0.01)
            assert len(client.program.done) == MAX_RESULTS // 2 + 1
            client.socket.is_writing_paused = False
            client.socket.on_writable()
            await asyncio.sleep(0.01)
            assert len(client.program.done) == 200

    run_virtual(run())


# -- at once ----------------------------------------------------------------------------------------------------------


@virtual
async def test_velocity_read_alone_is_executed_and_answered_in_the_turn_of_its_read() -> None:
    async with connected() as made:
        assert made.socket.on_message(b"a=1")
        assert (made.program.done, made.written()) == (["a=1"], [b"a=1"])
        assert made.socket.messages_from_client == 1
        assert not made.socket.on_message(b"word")
        assert made.socket.messages_from_client == 1


@pytest.mark.parametrize("obstacle", ["operation", "work", "answers", "turn", "closed"])
@virtual
async def test_velocity_waits_behind_what_waits(obstacle: str) -> None:
    async with connected() as made:
        if obstacle == "operation":
            made.socket.put("word")
            await asyncio.sleep(0)
        elif obstacle == "work":
            made.socket.on_read()
        elif obstacle == "answers":
            made.socket.fill(100.0)
            for _ in range(MAX_RESULTS // 2 + 1):
                made.queue.put_result(Outgoing(b"answer"))
        elif obstacle == "turn":
            for _ in range(URGENT_PIECES):
                made.hub.turns().end(asyncio.get_running_loop().time() - 1.0)
        else:
            made.socket.closed = True
        assert not made.socket.on_message(b"a=1")
        assert "a=1" not in made.program.done
        made.socket.closed = False


def test_failure_of_a_velocity_at_once_ends_the_client() -> None:
    async def run() -> None:
        async with connected() as made:
            made.program.take = _fail  # type: ignore[method-assign]
            assert made.socket.on_message(b"a=1")
            assert not made.socket.on_message(b"a=1")
            await asyncio.sleep(0.01)

    with pytest.raises(ExceptionGroup) as raised:
        run_virtual(run())
    assert raised.value.subgroup(ZeroDivisionError) is not None


def _fail(data: bytes, came_s: float) -> bool:
    raise ZeroDivisionError


@virtual
async def test_velocity_is_executed_although_a_turn_is_used_up_until_velocities_have_used_up_theirs() -> None:
    async with connected() as made:
        loop, turns = asyncio.get_running_loop(), made.hub.turns()
        turns.end(loop.time() - TURN_S)
        order: list[str] = []
        turns.call(lambda: order.append("other"), is_flooding=False)
        assert made.socket.on_message(b"a=1")
        assert order == []
        for _ in range(URGENT_PIECES - 3):
            turns.end(loop.time() - 100 * URGENT_TURN_S)
        assert made.socket.on_message(b"a=1")  # few pieces of work, which took long on a busy machine
        assert not made.socket.on_message(b"a=2")
        await asyncio.sleep(0.01)
        assert order == ["other"]
        assert made.socket.on_message(b"a=3")  # in a later turn of the loop
