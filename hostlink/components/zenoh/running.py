"""Start of the graphs that [zenoh] enables, on one session."""

import contextlib
import importlib.util
from collections.abc import AsyncIterator

from hostlink.components.zenoh.fleet import fleet_running
from hostlink.components.zenoh.session import opened
from hostlink.core.config import ZenohConfig
from hostlink.core.hub.hub import Hub
from hostlink.errors import LibraryMissing


@contextlib.asynccontextmanager
async def zenoh_running(hub: Hub, config: ZenohConfig) -> AsyncIterator[None]:
    """The daemon's parts in graphs over Zenoh, for the length of the block.

    Raises:
        ConfigError: eclipse-zenoh is not installed, or Zenoh refuses the settings.
    """
    async with opened(config, hub.isolation) as session, contextlib.AsyncExitStack() as parts:
        hub.counts.components["zenoh"] = lambda: session.counts
        hub.spawn(session.run(), name="zenoh")
        if config.fleet:
            await parts.enter_async_context(fleet_running(hub, session, config))
        if config.ros2:
            try:
                from hostlink.components.zenoh.rmw_bridge import ros2_bridged  # noqa: PLC0415 - a fleet without it is lighter
            except ImportError as error:
                library = "rosbags" if importlib.util.find_spec("rosbags") is None else "xxhash"
                raise LibraryMissing("zenoh.ros2", library, "zenoh") from error
            await parts.enter_async_context(ros2_bridged(hub, session, config))
        yield
