"""Zenoh: component that joins the fleet and ROS 2 over Zenoh, on one session."""

import asyncio
import contextlib
import importlib
import importlib.util
from collections.abc import AsyncIterator, Callable

from hostlink.components.zenoh.fleet import fleet_running
from hostlink.components.zenoh.session import opened
from hostlink.components.zenoh.settings import library
from hostlink.core.config import ZenohConfig
from hostlink.core.host import Component, Host
from hostlink.errors import LibraryMissing


class Zenoh(Component[ZenohConfig]):
    """The graphs that [zenoh] switches on."""

    name = "zenoh"
    settings_type = ZenohConfig

    async def run(self, host: Host) -> None:
        """Take part in them until cancelled."""
        async with zenoh_running(host, self.settings):
            await asyncio.Event().wait()


def loaded(config: ZenohConfig) -> Callable[[], Zenoh]:
    """Import all that a run needs, so that none stops the event loop for it. Return what makes the component of a run.

    Raises:
        LibraryMissing: eclipse-zenoh is not installed, or a library for ROS 2.
    """
    library()
    if config.ros2:
        try:
            importlib.import_module("hostlink.components.zenoh.rmw_bridge")
        except ImportError as error:
            missing = "rosbags" if importlib.util.find_spec("rosbags") is None else "xxhash"
            raise LibraryMissing("zenoh.ros2", missing, "zenoh") from error
    return lambda: Zenoh(config)


@contextlib.asynccontextmanager
async def zenoh_running(host: Host, config: ZenohConfig) -> AsyncIterator[None]:
    """The daemon's parts in graphs over Zenoh, for the length of the block. `loaded` has imported them.

    Raises:
        ConfigError: Zenoh refuses the settings.
    """
    async with opened(config, host.around) as session, contextlib.AsyncExitStack() as parts:
        host.count_by(lambda: session.counts)
        host.spawn(session.run(), name="zenoh")
        if config.fleet:
            await parts.enter_async_context(fleet_running(host, session, config))
        if config.ros2:
            from hostlink.components.zenoh.rmw_bridge import ros2_bridged  # noqa: PLC0415 - a fleet without it is lighter

            await parts.enter_async_context(ros2_bridged(host, session, config))
        yield
