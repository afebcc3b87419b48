"""LocalNode: the daemon as a node of ROS 1, with its calls of other nodes, its tasks and its counts."""

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, TypeVar

import aiohttp

from hostlink.components.ros1.settings import Ros1Config
from hostlink.components.ros1.xml_rpc import (
    CALL_TIMEOUT_S,
    HEADERS,
    MAX_ANSWER_BYTES,
    BadXml,
    CallRefused,
    Unreachable,
    decode_answer,
    encode_call,
    reason_of,
)
from hostlink.core.host import Host, Participant
from hostlink.core.mirror.log_once import LogOnce

GROUP = "ros1"
Parsed = TypeVar("Parsed")

THREAD_BYTES = 16 * 1024  # a body of so much takes a millisecond
TIMEOUT_S = 5.0  # to connect to another node, and for its header


class RegistrationKind(StrEnum):
    """Kind of a registration; the value is the master's word for it."""

    PUBLISHER = "Publisher"
    SUBSCRIBER = "Subscriber"
    SERVICE = "Service"

    __hash__ = str.__hash__  # an Enum's own is in Python: a tenth of a second for a thousand robots


@dataclass(slots=True)
class Ros1Counts:
    """Counts since the start: messages, and what each limit or policy refused."""

    messages_from_ros: int = 0
    messages_to_ros: int = 0
    dropped_to_slow_subscribers: int = 0
    superseded_velocities: int = 0  # a newer one was in the same piece of the stream
    refused_messages: int = 0  # by a robot, a gate or a lock
    malformed_messages: int = 0  # bytes that are not of the type that was agreed upon
    too_large_messages: int = 0
    refused_connections: int = 0  # too many, or from a network that is not allowed
    refused_headers: int = 0  # no header, or for an unknown topic or service
    refused_calls: int = 0  # of the slave API: no XML-RPC, or unknown
    failed_services: int = 0
    re_registrations: int = 0  # the master had forgotten this node
    crowded_out: int = 0  # publishers and services of the graph over a bound


class Rpc:
    """Calls of the master and of other nodes by XML-RPC, each with a deadline and a bound on its answer."""

    def __init__(self) -> None:
        self._session: aiohttp.ClientSession | None = None
        self._is_closed = False
        self._parsing = asyncio.Lock()  # a second thread would only take the interpreter from the loop

    async def aclose(self) -> None:
        """End all connections. Later calls raise Unreachable."""
        self._is_closed = True
        if self._session is not None:
            await self._session.close()

    async def call(self, uri: str, method: str, *arguments: object) -> Any:
        """Return the value of the answer.

        Raises:
            Unreachable: the call was not answered.
            CallRefused: the other side could not do it.
            BadXml: an argument has no form in XML-RPC.
        """
        body = encode_call(method, arguments)
        try:
            try:
                answer = await self._post(uri, body)
            except aiohttp.ServerDisconnectedError:  # it had closed the connection of the call before
                answer = await self._post(uri, body)
            return await self.parse(decode_answer, answer)
        except (aiohttp.ClientError, OSError, BadXml, ValueError) as error:  # a TimeoutError is an OSError
            raise Unreachable(reason_of(error)) from error

    async def parse(self, decode: Callable[[bytes], Parsed], body: bytes) -> Parsed:
        """Return what `decode` returns. A large body is parsed in a thread, so that no stop waits for it."""
        if len(body) <= THREAD_BYTES:
            return decode(body)
        async with self._parsing:
            return await asyncio.to_thread(decode, body)

    async def _post(self, uri: str, body: bytes) -> bytes:
        if self._is_closed:
            raise ConnectionAbortedError("the node has ended")
        if self._session is None:
            timeout = aiohttp.ClientTimeout(total=CALL_TIMEOUT_S)
            # Without decompression a kilobyte of an answer is at most a kilobyte.
            self._session = aiohttp.ClientSession(timeout=timeout, headers=HEADERS, auto_decompress=False)
        async with self._session.post(uri, data=body) as response:
            answer = bytearray()
            async for piece in response.content.iter_any():
                answer += piece
                if len(answer) > MAX_ANSWER_BYTES:
                    raise BadXml(f"an answer of more than {MAX_ANSWER_BYTES} bytes")
            return bytes(answer)


class LocalNode:
    """Name and address of this node, its calls, tasks and counts. `aclose` ends calls and tasks."""

    def __init__(self, host: Host, config: Ros1Config, name: str, tasks: asyncio.TaskGroup) -> None:
        """`name`: the full name in ROS."""
        self.host, self.config, self.name = host, config, name
        self.uri = ""  # where the slave API answers, once its port is bound
        self.master_uri = config.master
        self.rpc, self.counts, self.log_once = Rpc(), Ros1Counts(), LogOnce()
        self._group = tasks
        self._tasks: set[asyncio.Task[None]] = set()

    async def aclose(self) -> None:
        """Cancel the tasks, and end the connections of calls."""
        for task in self._tasks:
            task.cancel()
        await self.rpc.aclose()

    def join(self, who: str, on_end: Callable[[], None] = lambda: None) -> Participant:
        """Let another node take part in the hub until it leaves."""
        return self.host.join(f"{GROUP} {who}"[:64], group=GROUP, on_end=on_end)

    def spawn(self, work: Coroutine[Any, Any, object], *, name: str) -> asyncio.Task[None]:
        """Run a task until the node ends. A crash of it ends nothing else."""
        task = self._group.create_task(self._isolated(work, name), name=name)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        task.add_done_callback(lambda _: work.close())  # it may be cancelled before it begins
        return task

    async def _isolated(self, work: Coroutine[Any, Any, object], name: str) -> None:
        with self.host.around("task", task=name):
            await work

    async def call_master(self, method: str, *arguments: object) -> Any:
        """Return the value of the master's answer. Errors are those of `Rpc.call`."""
        return await self.rpc.call(self.master_uri, method, self.name, *arguments)

    async def find_own_uri(self) -> str | None:
        """Return the address that the master has for this node's name; None when it has none.

        Raises:
            Unreachable: the master does not answer.
        """
        try:
            found = await self.call_master("lookupNode", self.name)
        except CallRefused:
            return None
        if not isinstance(found, str):
            raise Unreachable("the master's address of a node is not a text")
        return found
