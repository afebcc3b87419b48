"""`connect`, the way to a Host for programs that use asyncio."""

import contextlib
import ssl
from collections.abc import AsyncIterator, Generator
from types import TracebackType
from typing import Any, NoReturn

from hostlink.client.host import Host
from hostlink.client.http_client import DEFAULT_PORT, HttpClient
from hostlink.errors import HostlinkError

DEFAULT_URL = f"http://127.0.0.1:{DEFAULT_PORT}"
_ADVICE = (
    "is not open yet: write `async with hostlink.client.connect() as host:`; "
    "without asyncio `with hostlink.client.connect_blocking() as host:`"
)


def connect(
    url: str = DEFAULT_URL,
    *,
    token: str | None = None,
    ssl: ssl.SSLContext | None = None,
    reconnect: bool = True,
    group: str = "",
) -> "Connecting":
    """A connection to hostlink for the length of the block. Leaving it stops every robot that it drives.

    `url`: http, https, ws or wss. `token`: one of the daemon's configuration, also as `?token=` in the URL.
    `ssl`: trust a certificate of your own. `reconnect`: when the connection is lost it is made again, subscriptions
    and advertisements too, velocities never; without it, whatever waits for a message raises. `group`: of a bridge
    to another graph, as ROS 2: it receives nothing that a connection of the same group has published.

    Raises:
        HostlinkError: when the block begins: there is no hostlink at `url`, or it refuses. At its end: a message that
            was published in it was refused.
    """
    return Connecting(url, _connected(url, token, ssl, reconnect=reconnect, group=group))


class Connecting(contextlib.AbstractAsyncContextManager[Host]):
    """A connection that is not open yet: `async with` opens it, and every other use explains that."""

    def __init__(self, url: str, connected: contextlib.AbstractAsyncContextManager[Host]) -> None:
        self._url, self._connected = url, connected

    async def __aenter__(self) -> Host:
        """Open it."""
        return await self._connected.__aenter__()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> bool | None:
        """Stop what is driven, and close it."""
        return await self._connected.__aexit__(kind, error, traceback)

    def __enter__(self) -> NoReturn:
        """`with` instead of `async with`."""
        raise HostlinkError(f"{self!r} {_ADVICE}")

    def __exit__(self, *_: object) -> None:
        """Python looks for it before it enters."""

    def __await__(self) -> Generator[Any, Any, NoReturn]:
        """`await connect()`."""
        raise HostlinkError(f"{self!r} {_ADVICE}")

    def __getattr__(self, name: str) -> NoReturn:
        """`connect().robots()`."""
        raise AttributeError(f"{name!r}: {self!r} {_ADVICE}")

    def __repr__(self) -> str:
        return f"<connect to {self._url}>"


@contextlib.asynccontextmanager
async def _connected(
    url: str, token: str | None, context: ssl.SSLContext | None, *, reconnect: bool, group: str
) -> AsyncIterator[Host]:
    http = HttpClient(url, token, context)
    try:
        host = Host(http, reconnect=reconnect, group=group)
        async with host.running():
            yield host
    finally:
        await http.aclose()
