"""Radio: datagrams between a hub and a micro-ROS board in virtual time, which are lost, doubled and overtaken."""

import asyncio
from collections import deque
from collections.abc import Callable

from hostlink.core.hub.hub import Hub
from hostlink.core.protocol.xrce.protocol import MICRO_ROS_UDP
from hostlink.core.transport.base import READ_BYTES
from tests.support import xrce_board as board
from tests.support.background import meanwhile
from tests.support.xrce_device import Device

BOOT_S = 0.1  # of a board, longer than a datagram is on its way


class Radio:
    """The host's end: a Transport that keeps datagrams."""

    kind = "udp"

    def __init__(self, network: board.Link, address: str) -> None:
        self.peer, self.address = f"{address}:1", address
        self.network = network
        self.on_sent: Callable[[bytes], None] = lambda _: None  # gets what reaches the board
        self.is_ended = self.is_behind = False
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[bytes] = deque()
        self._on_readable: Callable[[], None] = lambda: None

    def send_to_host(self, data: bytes) -> None:
        """Send a datagram of the board."""
        for at_s in self.network.arrivals(self._loop.time(), to_board=False):
            self._loop.call_at(at_s, self.arrive, data)

    def arrive(self, data: bytes) -> None:
        """Let a datagram reach the host, if its kernel has room."""
        if not self.is_ended and self.unread_bytes < 2 * READ_BYTES:
            self._waiting.append(data)
            self._loop.call_soon(self._on_readable)

    def start(self, on_readable: Callable[[], None]) -> None:
        self._on_readable = on_readable
        if self._waiting:
            on_readable()

    @property
    def unread_bytes(self) -> int:
        return sum(map(len, self._waiting))

    def read(self, limit_bytes: int) -> bytes:  # noqa: ARG002 - the next datagram
        return self._waiting.popleft() if self._waiting else b""

    def write(self, data: bytes) -> bool:
        if not self.is_ended:
            for at_s in self.network.arrivals(self._loop.time(), to_board=True):
                self._loop.call_at(at_s, self.on_sent, data)
        return True

    async def drain(self) -> None: ...

    async def receive(self) -> bytes:
        raise NotImplementedError("links read in callbacks")

    async def send(self, data: bytes) -> None:
        self.write(data)

    def round_trip_s(self) -> float | None:
        return None

    def descriptor(self) -> int | None:
        return None

    async def aclose(self) -> None:
        self.is_ended = True
        self._loop.call_soon(self._on_readable)


class RadioBoard:
    """A stock board at an address, and its link to a hub. It may be switched off and on."""

    def __init__(self, hub: Hub, network: board.Link, address: str, program: board.Stock) -> None:
        self.radio, self.stock = Radio(network, address), program
        self.link = hub.links.open(self.radio, MICRO_ROS_UDP)
        hub.spawn(hub.links.serve(self.link), name=f"link of {address}")
        self.taken = program.taken  # since it was switched on: time, and linear velocity
        self.lives = [program]
        self._is_off = asyncio.Event()

    async def run(self) -> None:
        """Run the board's program, and the next one after each `reboot`, until cancelled."""
        while True:
            self._is_off.clear()
            device = Device(self.stock, self.radio.send_to_host, board.Datagrams())
            self.radio.on_sent = device.receive
            async with meanwhile(device.run()):
                await self._is_off.wait()
            self.radio.on_sent = lambda _: None
            await asyncio.sleep(BOOT_S)

    def reboot(self, program: board.Stock) -> None:
        """Switch it off and on. It is at rest then."""
        self.stock, self.taken = program, program.taken
        self.lives.append(program)
        self._is_off.set()

    @property
    def is_moving(self) -> bool:
        """Whether the last velocity that it took is not zero."""
        return bool(self.taken) and self.taken[-1][1] != 0.0
