"""A device in virtual time: a simulated robot, its 38400 baud UART, and the passthrough that dials the host again."""

import asyncio
import struct
from collections.abc import Awaitable, Callable
from typing import Protocol

from hostlink.core.messages.catalog import Catalog
from hostlink.core.runtime.cancellation import raise_if_cancelled
from hostlink.core.transport.base import Transport
from hostlink.workbench.sim.robot import SimulatedRobot
from tests.support.original_device import DeviceCrashed, OriginalDevice
from tests.support.uart import Uart

LOOP_S = 1 / 30
RECONNECT_S = 0.5  # docs/reliability.md#the-papers-link: how long this device waits before it dials again
LINE_POLL_S = 0.004  # how often it polls the UART
POSE, TWIST = struct.Struct("<3d"), struct.Struct("<6d")


class Line(Protocol):
    """The host's way to a device."""

    def send(self, data: bytes, now_s: float) -> None:
        """Put bytes on it."""
        ...

    def cut(self) -> None:
        """Cut the line."""
        ...


class Lines(Protocol):
    """Lines of a device in both directions."""

    @property
    def from_host(self) -> Line: ...
    @property
    def to_host(self) -> Uart: ...


class Program(Protocol):
    """Program of a device."""

    @property
    def device(self) -> Lines: ...

    def turn(self, now_s: float) -> float | None:
        """One turn of its loop; None when it is done, else call again after so many seconds."""
        ...

    def reboot(self) -> None:
        """Power off and on."""
        ...


class NumberedRobot:
    """A robot whose messages differ: pose n is (n, 0, 0). It keeps the commands that reach it."""

    loop_s = LOOP_S
    publish_every = 3

    def __init__(self, catalog: Catalog, *, retries: bool = True) -> None:
        self.device = OriginalDevice(retries=retries)
        self.sent: list[tuple[float, int]] = []  # (time, number)
        self.commands: list[tuple[float, bytes]] = []
        self._turns = 0
        self._now_s = 0.0
        types = [catalog.message(name) for name in ("geometry_msgs/Pose2D", "geometry_msgs/Twist")]
        pose, twist = (type_ for type_ in types if type_ is not None)
        self._odometry = self.device.advertise("/robot_0/odometry", pose.name, pose.md5)
        self.device.subscribe("/robot_0/velocity_commands", twist.name, twist.md5, self._receive)

    def turn(self, now_s: float) -> float | None:
        self._now_s = now_s
        wait_s = self.device.spin(now_s)
        if wait_s is None:
            self._turns += 1
            number = len(self.sent)
            if self._turns % self.publish_every == 0 and self.device.publish(self._odometry, pose(number), now_s):
                self.sent.append((now_s, number))
        return wait_s

    def reboot(self) -> None:
        self.device.reboot()

    def _receive(self, payload: bytes) -> None:
        self.commands.append((self._now_s, payload))


class FirmwareProgram:
    """The Due's firmware, whose board has a UART of its own."""

    loop_s = LINE_POLL_S

    def __init__(self) -> None:
        self.robot = SimulatedRobot("robot_0")
        self.from_host, self.to_host = self, Uart(baud=None)

    @property
    def device(self) -> Lines:
        return self

    def turn(self, now_s: float) -> None:
        self.to_host.send(self.robot.advance(now_s), now_s)

    def reboot(self) -> None:
        self.robot.reboot()

    def send(self, data: bytes, _: float) -> None:
        self.robot.send(data)

    def cut(self) -> None:
        self.robot.cut()


def pose(number: int) -> bytes:
    """Pose n."""
    return POSE.pack(number, 0.0, 0.0)


class VirtualDevice:
    """Runner of a program, which carries its UART to the host through the transport that `dial` opens."""

    def __init__(self, program: Program, dial: Callable[[], Awaitable[Transport]], *, loop_s: float = LOOP_S) -> None:
        self.program = program
        self.connections = self.crashes = 0
        self._dial = dial
        self._loop_s = loop_s
        self._spoke = asyncio.Event()

    async def run(self) -> None:
        """Until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._turn(), name="device loop")
            while True:
                transport = await self._dial()
                self.connections += 1
                await self._talk(transport)
                await transport.aclose()
                self.program.device.from_host.cut()
                self.program.device.to_host.cut()
                await asyncio.sleep(RECONNECT_S)

    async def _turn(self) -> None:
        now_s = asyncio.get_running_loop().time
        next_s = now_s()
        while True:
            try:
                wait_s = self.program.turn(now_s())
            except DeviceCrashed:  # its watchdog starts it again
                self.crashes += 1
                self.program.reboot()
                wait_s = None
            if self.program.device.to_host.next_arrival_s() is not None:
                self._spoke.set()
            if wait_s is None:
                next_s = max(next_s + self._loop_s, now_s())
                wait_s = next_s - now_s()
            await asyncio.sleep(wait_s)

    async def _talk(self, transport: Transport) -> None:
        try:
            async with asyncio.TaskGroup() as tasks:
                passing = tasks.create_task(self._pass_on(transport), name="device UART")
                try:
                    while data := await transport.receive():
                        self.program.device.from_host.send(data, asyncio.get_running_loop().time())
                finally:
                    passing.cancel()
        except* OSError:
            pass  # the host is gone: the device connects again
        raise_if_cancelled()

    async def _pass_on(self, transport: Transport) -> None:
        now_s = asyncio.get_running_loop().time
        line = self.program.device.to_host
        while True:
            arrival_s = line.next_arrival_s()
            if arrival_s is None:
                self._spoke.clear()
                await self._spoke.wait()
                continue
            await asyncio.sleep(max(0.0, arrival_s - now_s()) + LINE_POLL_S)
            if data := line.pop(now_s()):
                await transport.send(data)
