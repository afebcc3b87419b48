"""ROS 1 without sockets: a node whose calls are answered by the test, and connections that keep what is sent."""

import asyncio
from collections.abc import Callable
from typing import Any, cast

from hostlink.components.ros1.connections import Wire
from hostlink.components.ros1.local_node import LocalNode, Rpc
from hostlink.components.ros1.settings import Ros1Config
from hostlink.components.ros1.tcpros import MAX_HEADER_BYTES, Header, MessageStream
from hostlink.components.ros1.xml_rpc import Unreachable
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.queue import Queue
from tests.support.hosts import host_in

MASTER = "http://master:11311/"


class FakeRpc:
    """Calls of other nodes, answered by `answer`."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, str, tuple[object, ...]]] = []
        self.answer: Callable[[str, str], Any] = self.refuse

    async def call(self, uri: str, method: str, *arguments: object) -> Any:
        self.calls.append((uri, method, arguments))
        return self.answer(uri, method)

    async def parse(self, decode: Callable[[bytes], Any], body: bytes) -> Any:
        return decode(body)

    async def aclose(self) -> None:
        """End nothing."""

    @staticmethod
    def refuse(uri: str, method: str) -> Any:
        raise Unreachable(f"{uri} {method}")


class FakeWire:
    """Connection to another node, which keeps headers, messages and refusals."""

    def __init__(self) -> None:
        self.headers: list[Header] = []
        self.sent: list[bytes] = []
        self.answers: list[bytes] = []
        self.refusals: list[str] = []
        self.is_closed, self.is_replaceable, self.peer = False, True, "10.0.0.9:5"
        self.stream = MessageStream(MAX_HEADER_BYTES)
        self.outgoing: Queue[bytes] = Queue(len, asyncio.get_running_loop().time)
        self.receive: Callable[[list[bytes]], None] = lambda _: None
        self.on_end: Callable[[], None] = lambda: None

    def send_header(self, fields: Header) -> None:
        self.headers.append(fields)

    def send(self, data: bytes, *, is_answer: bool = False) -> None:
        (self.answers if is_answer else self.sent).append(data)

    def refuse(self, reason: str) -> None:
        self.refusals.append(reason)
        self.close()

    def close(self) -> None:
        if not self.is_closed:
            self.is_closed = True
            self.on_end()

    @property
    def wire(self) -> Wire:
        return cast("Wire", self)


def local_node(hub: Hub, tasks: asyncio.TaskGroup, **settings: Any) -> tuple[LocalNode, FakeRpc]:
    """Make a node in the hub, and its calls."""
    node = LocalNode(host_in(hub, "ros1"), Ros1Config(master=MASTER, **settings), "/hostlink", tasks)
    rpc = FakeRpc()
    node.uri, node.rpc = "http://here:1/", cast("Rpc", rpc)
    return node, rpc
