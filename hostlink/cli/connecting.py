"""The connection of a command to the daemon."""

import contextlib
from collections.abc import AsyncIterator

from hostlink.cli.waiting import waiting
from hostlink.client import Host, connect


@contextlib.asynccontextmanager
async def connected(url: str, token: str | None) -> AsyncIterator[Host]:
    """A connection to the daemon for the length of the block; what is lost is not made again.

    Raises:
        HostlinkError: there is no hostlink at `url`, it refuses, or the connection is lost.
    """
    async with contextlib.AsyncExitStack() as stack:
        with waiting(f"connecting to {url}"):
            host = await stack.enter_async_context(connect(url, token=token, reconnect=False))
        yield host
