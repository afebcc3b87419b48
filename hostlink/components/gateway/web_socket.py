"""ClientSocket: the WebSocket of one client. Executes its messages in turns and writes its queue once a turn."""

import asyncio
import contextlib
import contextvars
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any

import structlog
from aiohttp import WSCloseCode, WSMsgType, web

from hostlink.components.gateway.clients import Client, ClientProgram, ClientQueue, OperationQueue
from hostlink.components.gateway.frames import PING, PONG, control_frame, frame_head
from hostlink.components.gateway.listener import PacedReading
from hostlink.components.gateway.write_pace import WritePace
from hostlink.core.host import Host
from hostlink.core.runtime.latency import Latency

log = structlog.get_logger()

DEBT_S = 1.0  # that a client may be ahead of its message rate: programs subscribe to many topics at first
# Without progress in writing the client is disconnected. Some kernels report that a program reads 24 kB/s each 5 s.
SEND_TIMEOUT_S = 10.0
PING_INTERVAL_S = 10.0  # without a byte from the client; half of it later it counts as lost
READY_TIMEOUT_S = 1.0  # for the answer to the first ping; after that messages are sent without an answer
SEND_BATCH = 64  # messages in one write
CLOSING = (WSMsgType.CLOSE, WSMsgType.CLOSING, WSMsgType.CLOSED)


class ClientSocket:
    """The WebSocket of one client: a task that receives, and callbacks of the event loop that execute and send.

    | turn of the loop | what happens                                                                                  |
    |------------------|-----------------------------------------------------------------------------------------------|
    | bytes are read   | a velocity that arrives alone is executed at once, and answered (`_take`);                    |
    |                  | PacedReading passes all other bytes to aiohttp, which decodes the messages                    |
    | the next one     | `receive` queues all; `_work` executes them, and writes velocities and answers at once        |
    | a device's bytes | the hub queues messages                                                                       |
    | the next one     | `_send` writes all of them at once                                                            |

    While the transport's buffer is not empty, or a slow client has not read the last write (WritePace), nothing is
    written: messages wait in the queue, which is bounded and counts.
    """

    def __init__(
        self,
        socket: web.WebSocketResponse,
        reading: PacedReading,
        client: Client,
        program: ClientProgram[Any],
        queue: ClientQueue,
        host: Host,
        *,
        tasks: asyncio.TaskGroup,
        to_client: Latency,
        replaced: Counter[str],
        max_messages_s: float,
    ) -> None:
        """Take over the socket.

        `to_client`: latency from the arrival of a message to the socket, of all clients. `replaced`: counter of their
        replaced velocities, by kind. `max_messages_s`: allowed rate of messages.
        """
        self._socket, self._transport, self._reading = socket, reading.transport, reading
        self._client, self._program, self._queue = client, program, queue
        self._turns, self._host, self._tasks, self._to_client = host.turns(), host, tasks, to_client
        self._loop = asyncio.get_running_loop()
        self._context = contextvars.copy_context()  # so that log lines of callbacks name the client
        self._max_messages_s = max_messages_s
        note_replaced = partial(replaced.update, (client.kind,))
        self._operations = OperationQueue[Any](program, note_replaced, self._max_messages_s, host.share("operations"))
        self._progress = asyncio.Event()  # set when an operation was executed
        self._is_ended = False
        self._is_work_due = self._is_send_due = False  # whether a callback is scheduled
        self._is_ready = client.kind != "foxglove"  # rosbridge clients send first
        self._flush_timer: asyncio.TimerHandle | None = None
        self._flush_due_s: float | None = None
        self._stuck_timer: asyncio.TimerHandle | None = None
        self._pace = WritePace()
        self._full_s = 0.0  # when the transport's buffer filled
        self._pong: bytes | None = None  # payload of the last ping that is not answered
        self._pong_timer: asyncio.TimerHandle | None = None
        self._alive_timer: asyncio.TimerHandle | None = None
        queue.on_news = self._note_news
        reading.become_web_socket(
            on_message=self._take,
            on_read=self._expect_work,
            on_full=self._note_full,
            on_writable=self._note_writable,
        )

    # -- from the client ----------------------------------------------------------------------------------------------

    async def receive(self) -> None:
        """Receive until the client disconnects, then end its participant."""
        operations, loop, reading = self._operations, self._loop, self._reading
        self._watch_silence(reading.reads)
        try:
            if self._is_ready:
                self._note_news()
            else:
                await self._socket.ping()
                loop.call_later(READY_TIMEOUT_S, self._become_ready, context=self._context)
            while True:
                reads = reading.reads
                message = await self._socket.receive()
                reading.note_reading()
                if message.type in CLOSING:
                    self._note_news()  # answers that wait are dropped
                    await self._until(lambda: not operations.waiting)
                    await asyncio.sleep(0)  # if the last one was a call, it begins before the participant ends
                    return
                if message.type not in (WSMsgType.TEXT, WSMsgType.BINARY):
                    await self._receive_control(message.type, message.data)
                    continue
                self._client.messages_from_client += 1
                operations.put(message.data, reading.came_s, loop.time(), is_behind=reading.reads == reads)
                if not self._is_work_due:
                    self._expect_work()
                if operations.debt_s > DEBT_S:
                    await self._refuse_flood()
                    return
                if not operations.has_room:
                    self._pace.skip()  # a pong is behind what is not read now
                    self._end_wait()
                    reading.pause()
                    await self._until(lambda: operations.has_room)
                    reading.resume()
                reading.unread_bytes = 0
                if reading.has_room:
                    reading.give_room()
        finally:
            self._is_ended = True
            for timer in (self._flush_timer, self._stuck_timer, self._pong_timer, self._alive_timer):
                if timer is not None:
                    timer.cancel()
            reading.leave_web_socket()
            operations.close()
            self._program.close()

    async def _receive_control(self, kind: WSMsgType, data: bytes | None) -> None:
        if kind is WSMsgType.PING:
            self._pong = data or b""  # of several only the last is answered: RFC 6455, 5.5.3
            self._note_news()
        elif kind is WSMsgType.PONG:
            self._become_ready()
            if self._pace.confirm(data or b"", self._loop.time()):
                self._end_wait()
        if kind in (WSMsgType.PING, WSMsgType.PONG):  # otherwise the frame is invalid, and aiohttp closes the socket
            self._reading.receive_control(len(data or b""))

    async def _until(self, is_right: Callable[[], bool]) -> None:
        """Wait until a condition of the operations holds."""
        while not is_right():
            self._progress.clear()
            await self._progress.wait()

    async def _refuse_flood(self) -> None:
        """Close the connection. Reading more slowly would delay commands, and the stop behind them."""
        log.warning("client.too_fast", limit_s=self._max_messages_s)
        reason = f"more than {self._max_messages_s:g} messages a second"
        await self._socket.close(code=WSCloseCode.POLICY_VIOLATION, message=reason.encode(), drain=False)

    def _take(self, text: bytes) -> bool:
        """Execute a message that was read alone, if it is a velocity and nothing waits. Return whether it was."""
        operations, turns = self._operations, self._turns
        if (
            self._is_work_due
            or self._is_ended
            or self._socket.closed
            or not self._queue.has_room
            or not turns.share.is_free_for_urgent
        ):
            return False
        began_s, is_send_due = self._loop.time(), self._is_send_due
        self._is_send_due = True  # the answer is sent below
        self._host.hold_writes()
        try:
            is_taken = self._context.run(operations.take, text, self._reading.came_s, began_s)
        except Exception as error:  # noqa: BLE001 - raised in the client's task group
            self._fail(error)
            return True
        finally:
            self._host.write_held()
            self._is_send_due = is_send_due
        if is_taken:
            turns.end(began_s)
            self._client.messages_from_client += 1
            if not is_send_due and (self._queue.waiting_messages or self._queue.is_flush_due):
                self._send()
        return is_taken

    # -- its turns ----------------------------------------------------------------------------------------------------

    def _expect_work(self) -> None:
        """Schedule work for when all that was read is queued, so that only the newest velocity is executed."""
        if not self._is_work_due:
            self._is_work_due = True
            self._loop.call_soon(self._work, context=self._context)

    def _work(self, *, is_admitted: bool = False) -> None:
        """Execute operations while the client has its turn, then send the answers."""
        self._is_work_due = False
        if self._is_ended:
            return
        operations, queue, turns = self._operations, self._queue, self._turns
        self._is_send_due = True  # the answers are sent together, at the end
        self._host.hold_writes()
        try:
            while operations.waiting and not self._is_work_due:
                if is_admitted or turns.share.is_free(is_flooding=operations.is_flooding):
                    is_admitted = False
                    began_s, calls = self._loop.time(), self._program.calls
                    try:
                        operations.work()
                    finally:
                        turns.end(began_s)
                        self._progress.set()
                    if not queue.has_room:  # a client that does not read its answers is not read from
                        self._is_work_due = True
                        self._tasks.create_task(self._work_with_room(), context=self._context)
                    elif self._program.calls > calls:  # the call begins before the operations behind it
                        self._expect_work()
                else:
                    self._is_work_due = True
                    work = partial(self._context.run, partial(self._work, is_admitted=True))
                    turns.call(work, is_flooding=operations.is_flooding)
        except Exception as error:  # noqa: BLE001 - raised in the client's task group
            self._fail(error)
        finally:
            self._host.write_held()
        self._send()

    async def _work_with_room(self) -> None:
        await self._queue.room()
        self._work()

    # -- to the client ------------------------------------------------------------------------------------------------

    def _note_news(self) -> None:
        """Schedule one write for all messages of this turn of the loop."""
        if not self._is_send_due and not self._is_ended:
            self._is_send_due = True
            self._loop.call_soon(self._send, context=self._context)

    def _send(self) -> None:
        """Write what is queued, up to a bound, and schedule the rest."""
        self._is_send_due = False
        queue = self._queue
        if self._socket.closed or self._transport.is_closing():
            queue.clear()  # its last operations are executed, and wait for room for their answers
            return
        if self._is_ended or self._reading.is_writing_paused:
            return
        now_s = self._loop.time()
        if self._pong is not None:
            pong, self._pong = self._pong, None
            self._transport.write(control_frame(PONG, pong))
        if not self._is_ready or self._reading.is_writing_paused:
            return
        if queue.is_too_slow or queue.is_closed:
            self._tasks.create_task(self._end(), context=self._context)
            return
        if self._pace.is_waiting:
            return
        try:
            if queue.is_flush_due or (self._flush_due_s is not None and now_s >= self._flush_due_s):
                self._flush(now_s)
            pieces: list[bytes] = []
            count = size_bytes = 0
            while count < SEND_BATCH and size_bytes < self._pace.max_bytes and (waiting := queue.pop()) is not None:
                item = waiting.item
                if item.before:
                    pieces += (frame_head(len(item.before), is_binary=True), item.before)
                pieces += (frame_head(len(item.data), is_binary=item.is_binary), item.data)
                count += 1
                size_bytes += waiting.size_bytes
                self._to_client.add(now_s - waiting.since_s)
            if not count:
                return
            if self._operations.has_room and (ping := self._pace.ask(now_s)):  # otherwise no pong is read
                pieces.append(control_frame(PING, ping))
                self._pong_timer = self._loop.call_later(SEND_TIMEOUT_S, self._miss_pong)
            self._client.messages_to_client += count
            self._client.bytes_to_client += size_bytes
            self._transport.write(b"".join(pieces))
        except Exception as error:  # noqa: BLE001 - raised in the client's task group
            self._fail(error)
            return
        if waiting is not None:  # a bound of this write was reached, and more may wait
            self._note_news()

    def _flush(self, now_s: float) -> None:
        """Queue messages that throttled subscriptions held back until now."""
        self._queue.is_flush_due = False
        due_s = self._program.flush(now_s)
        if due_s != self._flush_due_s:
            if self._flush_timer is not None:
                self._flush_timer.cancel()
            self._flush_due_s = due_s
            self._flush_timer = None
            if due_s is not None:
                self._flush_timer = self._loop.call_at(due_s, self._note_news, context=self._context)

    def _become_ready(self) -> None:
        """Start sending: the client has seen that the connection is open.

        Programs add their listeners then. Listeners miss a message that is read together with the end of the handshake:
        Foxglove's `mcap-record` missed the channels and recorded nothing.
        """
        if not self._is_ready:
            self._is_ready = True
            self._note_news()

    def _note_full(self) -> None:
        """Disconnect the client unless the transport's buffer is empty in time."""
        if not self._is_ended:
            self._full_s = self._loop.time()
            error = TimeoutError("it does not read")
            self._stuck_timer = self._loop.call_later(SEND_TIMEOUT_S, self._fail, error, context=self._context)

    def _note_writable(self) -> None:
        """Continue to send: the transport's buffer is empty."""
        if self._stuck_timer is not None:
            self._stuck_timer.cancel()
            self._stuck_timer = None
            self._pace.note_pause(self._loop.time() - self._full_s)
        self._note_news()

    def _miss_pong(self) -> None:
        """Continue to send without pings: the client has not answered in time."""
        self._pace.give_up()
        self._end_wait()

    def _end_wait(self) -> None:
        """Continue to send: no pong is awaited any longer."""
        if self._pong_timer is not None:
            self._pong_timer.cancel()
            self._pong_timer = None
            self._note_news()

    def _watch_silence(self, reads: int, *, is_pinged: bool = False) -> None:
        """Ping a client that is silent, then disconnect it. aiohttp would do so, but leave a reference cycle behind."""
        wait_s = PING_INTERVAL_S / 2 if is_pinged else PING_INTERVAL_S
        self._alive_timer = self._loop.call_later(wait_s, self._check_silence, reads, is_pinged, context=self._context)

    def _check_silence(self, reads: int, is_pinged: bool) -> None:
        if self._is_ended or self._transport.is_closing():
            return
        if self._reading.reads > reads:
            self._watch_silence(self._reading.reads)
        elif is_pinged:
            self._fail(TimeoutError("it answers no ping"))
        else:
            if not self._reading.is_writing_paused:  # otherwise it is known to be stuck
                self._transport.write(control_frame(PING, b""))
            self._watch_silence(reads, is_pinged=True)

    # -- its end ------------------------------------------------------------------------------------------------------

    def _fail(self, error: Exception) -> None:
        """End the client's tasks with an error."""
        if not self._is_ended:
            self._is_ended = True
            self._tasks.create_task(_raise(error))

    async def _end(self) -> None:
        """Close the connection: answers exceed the queue, or the participant has ended."""
        queue = self._queue
        if self._is_ended:
            return
        self._is_ended = True
        if queue.is_closed:  # a fault of hostlink has ended the participant; it is logged there
            await self._socket.close(code=WSCloseCode.INTERNAL_ERROR, message=b"a fault of hostlink", drain=False)
            raise ConnectionAbortedError("internal error of hostlink")
        log.warning("client.too_slow", dropped=queue.dropped)
        reason = b"too slow: answers pile up"
        await self._socket.close(code=WSCloseCode.POLICY_VIOLATION, message=reason, drain=False)
        raise ConnectionAbortedError("answers pile up")  # ends the receiving task, which may wait for room


async def _raise(error: Exception) -> None:
    raise error


async def close_going_away(socket: web.WebSocketResponse, timeout_s: float) -> None:
    """Close a socket because the daemon ends."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(timeout_s):
            await socket.close(code=WSCloseCode.GOING_AWAY, message=b"hostlink stops", drain=False)
