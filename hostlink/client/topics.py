"""Topics of this client: subscriptions, advertisements and the watched graph; restored after each reconnection."""

import contextlib
import itertools
import weakref
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from hostlink.client.connection import HostConnection, refused_by
from hostlink.client.mailbox import Mailbox
from hostlink.client.views import RawMessage
from hostlink.core.messages.serialisation import ROS1
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import HostlinkError, Refused

# -- topics -----------------------------------------------------------------------------------------------------------

Subscription = Mailbox[dict[str, Any]]
RawSubscription = Mailbox[RawMessage]
RAW = {"compression": "cbor-raw", "any_encoding": True}  # option of a subscription that `read_raw` reads
Item = TypeVar("Item")


@dataclass(slots=True)
class _Subscribed:
    topic: str
    read: Callable[[dict[str, Any]], Any]
    mailbox: Mailbox[Any]


class Topics:
    """Subscriptions, each with an id of its own, advertisements, and refusals of what was published."""

    def __init__(self, connection: HostConnection) -> None:
        self._connection = connection
        self._numbers = itertools.count(1)
        self._subscribed: dict[str, _Subscribed] = {}
        self._refusals: dict[str, Refused] = {}  # by topic
        self.is_settled = True  # nothing was published since the daemon has read all of it
        connection.handlers["publish"].append(self._deliver)
        connection.handlers["status"].append(self._receive_refusal)

    async def publish(self, topic: str, message: Mapping[str, Any], type_name: str, priority: int) -> None:
        """Send one message: {"msg": its fields} or {"raw": it is serialised, as base64}.

        Raises:
            HostlinkError: there is no connection, or an earlier message on this topic was refused.
        """
        if (refusal := self._refusals.pop(topic, None)) is not None:
            raise refusal
        request = {"op": "publish", "id": f"publish:{topic}", "topic": topic, "priority": priority}
        self.is_settled = False
        await self._connection.send({**request, **message, **_typed(type_name)})

    def pop_refusal(self, topic: str) -> str:
        """Return why a message on the topic was refused since the last call; empty if none was."""
        refusal = self._refusals.pop(topic, None)
        return "" if refusal is None else refusal.reason

    def raise_refusals(self) -> None:
        """Raise the refusals that were not reported yet.

        Raises:
            HostlinkError: there are some.
        """
        refusals = list(self._refusals.values())
        self._refusals.clear()
        if len(refusals) > 1:
            raise Refused(refusals[0].kind, "; ".join(refusal.reason for refusal in refusals))
        if refusals:
            raise refusals[0]

    def advertise(
        self, topic: str, type_name: str, *, is_latched: bool
    ) -> contextlib.AbstractAsyncContextManager[None]:
        """Be a publisher of the topic for the length of the block.

        Raises:
            HostlinkError: there is no connection.
        """
        latch = {"latch": True} if is_latched else {}
        request = {"op": "advertise", "id": f"publish:{topic}", "topic": topic, "type": type_name, **latch}
        return self._connection.keeping(f"publish:{topic}", request, {"op": "unadvertise", "topic": topic})

    @contextlib.asynccontextmanager
    async def subscribe(
        self,
        topic: str,
        type_name: str,
        options: Mapping[str, Any],
        read: Callable[[dict[str, Any]], Item],
        timeout_s: float | None = None,
    ) -> AsyncIterator[Mailbox[Item]]:
        """The messages of a topic as `read` returns them, from now on, for the length of the block.

        Raises:
            HostlinkError: there is no connection.
        """
        key = f"subscribe:{next(self._numbers)}"
        request = {"op": "subscribe", "id": key, "topic": topic, **options, **_typed(type_name)}
        async with self._connection.keeping(key, request, {"op": "unsubscribe", "id": key, "topic": topic}):
            mailbox: Mailbox[Item] = Mailbox(topic, self._connection.callers.note, timeout_s=timeout_s)
            self._subscribed[key] = _Subscribed(topic, read, mailbox)
            try:
                yield mailbox
            finally:
                del self._subscribed[key]

    def end(self, error: HostlinkError) -> None:
        """End every subscription: each iteration raises the error."""
        for subscribed in self._subscribed.values():
            subscribed.mailbox.put(error)

    def _deliver(self, message: dict[str, Any]) -> None:
        for subscribed in self._subscribed.values():
            if subscribed.topic == message["topic"]:
                subscribed.mailbox.put(subscribed.read(message["msg"]))

    def _receive_refusal(self, message: dict[str, Any]) -> None:
        key, refusal = str(message.get("id", "")), refused_by(message)
        if key in self._subscribed:
            self._subscribed[key].mailbox.put(refusal)
        elif key.startswith("publish:"):
            self._refusals[key.removeprefix("publish:")] = refusal


def read_raw(message: dict[str, Any]) -> RawMessage:
    stamp_ns = message["secs"] * NS_PER_S + message["nsecs"]
    return RawMessage(message["bytes"], stamp_ns, message.get("encoding", ROS1))


def _typed(type_name: str) -> dict[str, str]:
    return {"type": type_name} if type_name else {}


# -- graph ------------------------------------------------------------------------------------------------------------

Graphs = Mailbox[dict[str, Any]]


class GraphWatch:
    """Watchers of the graph. Nothing is requested without a watcher."""

    def __init__(self, connection: HostConnection) -> None:
        self._connection = connection
        self._watchers: weakref.WeakSet[Graphs] = weakref.WeakSet()
        connection.handlers["graph"].append(self._receive)
        connection.on_open.append(self._request)

    async def watch(self) -> Graphs:
        """The graph now, and after every change, as long as the reader keeps what this returns.

        Raises:
            HostlinkError: there is no connection.
        """
        watcher: Graphs = Mailbox("the graph", self._connection.callers.note)
        self._watchers.add(watcher)
        await self._request()
        return watcher

    async def _request(self) -> None:
        if self._watchers:
            await self._connection.send({"op": "watch_graph"})

    def _receive(self, graph: dict[str, Any]) -> None:
        for watcher in self._watchers:
            watcher.put(graph)
