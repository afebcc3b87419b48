"""Zenoh: component that joins the fleet and ROS 2 over Zenoh, on one session."""

import asyncio
import contextlib
import importlib
import importlib.util
from collections.abc import AsyncIterator, Iterable

from hostlink.components.zenoh.fleet import fleet_running
from hostlink.components.zenoh.session import opened
from hostlink.components.zenoh.settings import ZenohSettings, library, reach_of, settings_of, warnings_of
from hostlink.core.host import Component, Host
from hostlink.errors import LibraryMissing


class Zenoh(Component[ZenohSettings]):
    """Graphs over Zenoh: the fleet, and ROS 2 by rmw_zenoh's protocol."""

    name = "zenoh"
    settings_type = ZenohSettings

    def check(self) -> Iterable[str]:
        """Check the settings, and import what a run needs: it would stop the event loop of a daemon that serves."""
        library()
        if self.settings.ros2:
            for name in ("rosbags", "xxhash"):
                if importlib.util.find_spec(name) is None:
                    raise LibraryMissing("zenoh.ros2", name, "zenoh")
            importlib.import_module("hostlink.components.zenoh.rmw_bridge")
        return tuple(warnings_of(settings_of(self.settings), self.settings))

    def describe(self) -> str:
        """One line for --check-config: the graphs, and who can reach the session."""
        zenoh = self.settings
        parts = [f"the fleet {zenoh.fleet_name}"] * zenoh.fleet + [f"ROS 2, domain {zenoh.ros_domain_id}"] * zenoh.ros2
        reach = reach_of(settings_of(zenoh), zenoh)
        return "; ".join([f"Zenoh, a {zenoh.mode}: {' and '.join(parts) or 'nothing'}", *reach])

    async def run(self, host: Host) -> None:
        """Take part in them until cancelled."""
        async with zenoh_running(host, self.settings):
            await asyncio.Event().wait()


@contextlib.asynccontextmanager
async def zenoh_running(host: Host, config: ZenohSettings) -> AsyncIterator[None]:
    """The daemon's parts in graphs over Zenoh, for the length of the block.

    Raises:
        ConfigError: eclipse-zenoh is not installed, or Zenoh refuses the settings.
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
