"""What [zenoh] switches on, on one session."""

import contextlib
from collections.abc import AsyncIterator

from hostlink.config import ZenohConfig
from hostlink.graphs.zenoh.fleet import fleet_running
from hostlink.graphs.zenoh.session import opened
from hostlink.hub.hub import Hub


@contextlib.asynccontextmanager
async def zenoh_running(hub: Hub, config: ZenohConfig) -> AsyncIterator[None]:
    """The daemon's parts in graphs over Zenoh, for the length of the block.

    Raises:
        ConfigError: eclipse-zenoh is not installed, or Zenoh refuses the settings.
    """
    async with opened(config, hub.isolation) as session, contextlib.AsyncExitStack() as parts:
        hub.graph_counts["zenoh"] = session.counts
        if config.fleet:
            await parts.enter_async_context(fleet_running(hub, session, config))
        yield
