"""GraphWatch: the daemon's graph as it changes; requested again after each loss of the connection."""

import weakref
from typing import Any

from hostlink.client.connection import Connection
from hostlink.client.mailbox import Mailbox

Graphs = Mailbox[dict[str, Any]]


class GraphWatch:
    """Nothing is requested while nobody watches."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._watchers: weakref.WeakSet[Graphs] = weakref.WeakSet()
        connection.handlers["graph"].append(self._receive)
        connection.on_open.append(self._request)

    async def watch(self) -> Graphs:
        """The graph now, and after every change, as long as the reader keeps what this returns.

        Raises:
            HostlinkError: there is no connection.
        """
        watcher: Graphs = Mailbox("the graph")
        self._watchers.add(watcher)
        await self._request()
        return watcher

    async def _request(self) -> None:
        if self._watchers:
            await self._connection.send({"op": "watch_graph"})

    def _receive(self, graph: dict[str, Any]) -> None:
        for watcher in self._watchers:
            watcher.put(graph)
