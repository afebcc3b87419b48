"""Host, relay and one device together in virtual time: the daemon's hub, tools/relay.py, and a simulated robot."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from typing import Any

from hostlink.core.config import Config, LinkConfig
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.message import Message
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.rosserial.session import Session
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import HostlinkError
from tests.support.gates import drive_gate
from tests.support.memory_transport import MemoryTransport, memory_pair
from tests.support.participants import subscribe
from tests.support.virtual_device import POSE, Program, VirtualDevice
from tools.faults import Script
from tools.relay import Relay

CATALOG = Catalog()
LEAST_STEP_M_S = 0.0001  # commands differ by their speed
NUMBERS = 9000  # so many, up to 0.9 m/s; then they begin again


class Tap(MemoryTransport):
    """The host's end of a connection; keeps what the host read and what it wrote."""

    def __init__(self, end: MemoryTransport, *, number: int) -> None:
        super().__init__(end._from_peer, end._to_peer, address="robot")
        self.peer = f"robot:{number}"
        self.read_bytes = bytearray()
        self.written: list[bytes] = []
        self.session: Session  # once the link is open

    def read(self, limit_bytes: int) -> bytes:
        data = super().read(limit_bytes)
        self.read_bytes += data
        return data

    def write(self, data: bytes) -> bool:
        self.written.append(data)
        return super().write(data)


@dataclass
class World:
    """Parts of the world, and the records of them."""

    hub: Hub
    relay: Relay
    device: VirtualDevice
    taps: list[Tap]
    poses: list[tuple[float, bytes]] = field(default_factory=list)  # (time, payload) at a subscriber
    reported: list[tuple[float, str, dict[str, Any]]] = field(default_factory=list)  # what the relay reported
    commands: list[tuple[float, int]] = field(default_factory=list)  # (time, number) of what the host accepted
    commanded: int = 0

    @property
    def numbers(self) -> list[float]:
        """The poses that the subscriber got, by number."""
        return [POSE.unpack(payload)[0] for _, payload in self.poses]

    def command(self) -> None:
        """The next velocity, if the robot is there."""
        number = self.commanded % NUMBERS
        if command(self.hub, number):
            self.commands.append((asyncio.get_running_loop().time(), number))
        self.commanded += 1

    def is_working(self) -> bool:
        """Whether the host knows the robot, on a connection that is the device's newest."""
        links = {link.peer for link in self.hub.links.all()}
        with contextlib.suppress(HostlinkError):
            robot = self.hub.robots.find_here("robot_0")
            return robot.link is not None and robot.link.peer == self.taps[-1].peer in links
        return False


def command(hub: Hub, number: int) -> bool:
    """Drive robot_0 at the speed of this number. Return False when the host has no such robot."""
    velocity = PlanarVelocity(x_m_s=(number + 1) * LEAST_STEP_M_S)
    try:
        robot = hub.robots.find_here("robot_0")
        drive_gate(robot, velocity, owner="test", epoch=robot.gate.admission.epoch)
    except HostlinkError:
        return False
    return True


@contextlib.asynccontextmanager
async def world(script: Script, program: Program, *, loop_s: float = 1 / 30) -> AsyncIterator[World]:
    """For the length of the block, in the loop that runs it."""
    hub = Hub(Config(link=LinkConfig(uart_bytes_s=3840)), CATALOG, reraises=True)
    taps: list[Tap] = []
    passages: list[asyncio.Task[None]] = []
    now_s = asyncio.get_running_loop().time
    async with asyncio.TaskGroup() as tasks:

        async def reach_host() -> MemoryTransport:
            host_end, relay_end = memory_pair()
            tap = Tap(host_end, number=len(taps))
            taps.append(tap)
            link = hub.links.open(tap, ROSSERIAL)
            tap.session = link.session
            hub.spawn(hub.links.serve(link), name=f"link to {tap.peer}")
            return relay_end

        async def reach_relay() -> MemoryTransport:
            relay_end, device_end = memory_pair()
            passages[:] = [task for task in passages if not task.done()]
            passages.append(tasks.create_task(relay.serve(relay_end), name="passage"))
            return device_end

        relay = Relay(script, reach_host, lambda what, facts: made.reported.append((now_s(), what, facts)))
        made = World(hub, relay, VirtualDevice(program, reach_relay, loop_s=loop_s), taps)
        running = [tasks.create_task(hub.run(), name="hub")]
        await hub.is_running.wait()
        subscribe(hub, "/robot_0/odometry", lambda message: _record_pose(made, message))
        running += [tasks.create_task(made.device.run(), name="device"), tasks.create_task(relay.run(), name="relay")]
        try:
            yield made
        finally:
            for task in (*running, *passages):
                task.cancel()


def _record_pose(made: World, message: Message) -> None:
    made.poses.append((asyncio.get_running_loop().time(), message.payload))
