"""`connect_blocking`: the client for programs without asyncio, and for notebooks."""

import ssl

from hostlink.client.blocking_calls import HostCalls
from hostlink.client.host import DEFAULT_URL, connect
from hostlink.client.loop_thread import LoopThread
from hostlink.errors import HostlinkError


def connect_blocking(
    url: str = DEFAULT_URL,
    *,
    token: str | None = None,
    ssl: ssl.SSLContext | None = None,
    reconnect: bool = True,
    group: str = "",
) -> "BlockingHost":
    """A connection to hostlink for programs without asyncio: `with connect_blocking() as host:`.

    Without `with` it stays open, over the cells of a notebook too, until `close()`. Whatever ends the block or the
    program, an error or Ctrl-C in a cell, and the end of the last reference to it stop every robot that it drives. The
    arguments are those of `connect`.

    Raises:
        HostlinkError: there is no hostlink at `url`, or it refuses.
    """
    return BlockingHost(LoopThread(connect(url, token=token, ssl=ssl, reconnect=reconnect, group=group)))


class BlockingHost(HostCalls):
    """A running hostlink. Get one from `connect_blocking`; any thread may use it."""

    def __init__(self, loop: LoopThread) -> None:
        super().__init__(loop, loop.host)

    def close(self) -> None:
        """Close the connection; what it drives stops.

        Raises:
            HostlinkError: a published message was refused, and the refusal was not reported yet.
        """
        self._loop.close()

    def __enter__(self) -> "BlockingHost":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Close the connection. An error in the block takes precedence over one that `close` raises."""
        try:
            self.close()
        except HostlinkError:
            if kind is None:
                raise

    def __repr__(self) -> str:
        return repr(self._host).replace("Host", "BlockingHost", 1)
