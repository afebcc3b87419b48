"""A hub in virtual time whose devices are in memory: for tests of the hub without sockets."""

import asyncio
import contextlib
import struct
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import dataclass, field

from structlog.testing import capture_logs
from structlog.typing import EventDict

from hostlink.core.config import Config
from hostlink.core.hub.gates import Guard
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.robot import LocalRobot
from hostlink.core.protocol.endpoint import DeviceEndpoint
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.runtime.stop_frames import StopFrames
from tests.support.background import cancelling
from tests.support.fake_device import CATALOG, robot_topics
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import run_virtual

SETTLED_S = 0.05  # a device has announced its topics


def twist_zeros(*topic_ids: int) -> list[bytes]:
    """Return the frames that stop these topics of a Twist."""
    return [encode(topic_id, bytes(48)) for topic_id in topic_ids]


@dataclass
class RecordingGuard:
    """Guard that records its calls."""

    watched: dict[int, tuple[list[bytes], int]] = field(default_factory=dict)
    ends: dict[int, bytes] = field(default_factory=dict)
    connections: dict[int, Callable[[], int | None]] = field(default_factory=dict)
    released: list[int] = field(default_factory=list)
    driven: set[int] = field(default_factory=set)
    beats: int = 0

    def watch(self, number: int, connection: Callable[[], int | None], stop: StopFrames) -> None:
        self.watched[number], self.ends[number] = (list(stop.zeros), stop.claim_bytes), stop.end
        self.connections[number] = connection

    def beat(self, driven: set[int]) -> None:
        self.driven, self.beats = set(driven), self.beats + 1

    def release(self, number: int) -> None:
        self.released.append(number)
        self.watched.pop(number, None)


class MemoryHub:
    """A running hub, and the log of it."""

    def __init__(self, hub: Hub, guard: RecordingGuard, logs: list[EventDict]) -> None:
        self.hub, self.guard, self.logs = hub, guard, logs

    async def connect(
        self,
        infos: Sequence[DeviceEndpoint] | None = None,
        *,
        address: str = "10.0.0.2",
        peer: str | None = None,
    ) -> ScriptedDevice:
        """Connect a device, by default robot_0, and wait until it has announced its topics."""
        device = ScriptedDevice(self.hub, robot_topics() if infos is None else infos, address=address, peer=peer)
        await asyncio.sleep(SETTLED_S)
        return device

    def robot(self, name: str = "robot_0") -> LocalRobot:
        return self.hub.robots.find_here(name)

    def logged(self, event: str) -> list[EventDict]:
        return [each for each in self.logs if each["event"] == event]

    @property
    def now_s(self) -> float:
        return asyncio.get_running_loop().time()


@contextlib.asynccontextmanager
async def running(hub: Hub) -> AsyncIterator[asyncio.TaskGroup]:
    """A hub that runs for the length of the block."""
    async with cancelling() as tasks:
        tasks.create_task(hub.run())
        await hub.is_running.wait()
        yield tasks


def in_hub(
    test: Callable[[MemoryHub], Awaitable[None]], config: Config | None = None, *, reraises: bool = True
) -> None:
    """Run a test with a running hub, in virtual time."""

    async def run(logs: list[EventDict]) -> None:
        guard = RecordingGuard()
        given: Guard = guard
        hub = Hub(Config() if config is None else config, CATALOG, reraises=reraises, guard=given)
        async with running(hub):
            await test(MemoryHub(hub, guard, logs))

    with capture_logs() as logs:
        run_virtual(run(logs))


def velocities(device: ScriptedDevice, topic_id: int = 100) -> list[tuple[float, float]]:
    """The velocities that a device received: m/s, rad/s."""
    return [
        (linear, angular)
        for linear, *_, angular in (struct.unpack("<6d", payload) for payload in device.payloads(topic_id))
    ]
