"""A hub and two programs of the Python client in virtual time, for commands that drive a robot."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Sequence
from dataclasses import dataclass

import pytest
from structlog.testing import capture_logs

from hostlink.components.gateway.rosapi import RosApi
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.robot import LocalRobot
from hostlink.core.protocol.endpoint import DeviceEndpoint
from hostlink.errors import HostlinkError
from hostlink.workbench.sim.firmware_world import RobotKind
from tests.support.fake_device import CATALOG
from tests.support.hosts import host_in
from tests.support.memory_client import MemoryHost, memory_host
from tests.support.ros_lib_device import running_hub
from tests.support.scripted_device import ScriptedDevice
from tests.support.simulated import DisturbedRobot, simulated_in_memory
from tests.support.waiting import expect


@dataclass
class Bench:
    """A hub, and two programs."""

    hub: Hub
    tasks: asyncio.TaskGroup
    me: MemoryHost
    other: MemoryHost

    @property
    def robot(self) -> LocalRobot:
        """robot_0 in the daemon."""
        return self.hub.robots.find_here("robot_0")

    async def device(self, infos: Sequence[DeviceEndpoint]) -> ScriptedDevice:
        """Connect a device that does what the test says."""
        device = ScriptedDevice(self.hub, infos, address="10.0.0.1")
        await asyncio.sleep(0.5)
        return device

    def program(self, *_: object, **__: object) -> contextlib.AbstractAsyncContextManager[MemoryHost]:
        """Connect one more program, as `connected(url, token)` does."""
        return memory_host(self.hub, self.tasks)


async def refused(work: Awaitable[object]) -> str:
    """Return the reason of the error that ends the work."""
    with pytest.raises(HostlinkError) as caught:
        await work
    return str(caught.value)


@contextlib.asynccontextmanager
async def bench(config: Config | None = None) -> AsyncIterator[Bench]:
    hub = Hub(Config() if config is None else config, CATALOG, reraises=True)
    RosApi(host_in(hub)).offer()
    with capture_logs():
        async with (
            running_hub(hub),
            asyncio.TaskGroup() as tasks,
            memory_host(hub, tasks) as me,
            memory_host(hub, tasks) as other,
        ):
            yield Bench(hub, tasks, me, other)


@contextlib.asynccontextmanager
async def with_robot(
    config: Config | None = None, kind: RobotKind = RobotKind.PAPER
) -> AsyncIterator[tuple[Bench, DisturbedRobot]]:
    """A bench with a simulated robot that is ready."""
    async with bench(config) as here, simulated_in_memory(here.hub, kind=kind) as robot:
        await expect(lambda: here.robot.odometry.count > 5 and robot.is_configured)
        yield here, robot
