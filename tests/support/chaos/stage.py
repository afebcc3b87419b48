"""Stage: what every hostile action needs: where the daemon is, room for connections, and whom to report to."""

import contextlib
import random
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

from hostlink.core.protocol.rosserial.frame import TOPICS_REQUEST
from tests.support.chaos.connection import Connection, DatagramConnection, Room, leaving
from tests.support.chaos.names import VERIFIED_ADDRESSES, hostile_address
from tests.support.chaos.requests import draw_handshake
from tests.support.xrce_board import Datagrams, Lengths

DEVICE, SOCKET, IDLE, STUCK, UPLOAD, TLS = "device", "socket", "idle", "stuck", "upload", "tls"
ROOM = {
    DEVICE: 150,
    SOCKET: 60,
    IDLE: 1300,
    STUCK: 4,
    UPLOAD: 100,
    TLS: 32,
}  # the daemon has 256 connections of devices, 1024 descriptors
UDP_SHARE = 0.3  # of the devices, where the daemon receives datagrams
BOARD_UDP_SHARE = 0.7  # of the micro-ROS boards
VERIFIED_SHARE = 0.7  # of those that use UDP
REQUEST_TIMEOUT_S = 0.7
HANDSHAKE_WAIT_S = 2.0
Report = Callable[[dict[str, Any]], None]
Dial = Callable[..., Awaitable[Connection]]


@dataclass
class Stage:
    """One daemon; its generator has one of it."""

    tcp: tuple[str, int]
    api: tuple[str, int]
    report: Report
    udp: tuple[str, int] | None = None
    micro_ros: tuple[str, int] = ("", 0)  # of TCP, and of UDP where the daemon receives datagrams
    fleet: tuple[str, int] | None = None
    wrong_certificate: tuple[str, str] = ("", "")  # and its key: of another authority than the fleet's
    room: Room = field(default_factory=lambda: Room(**ROOM))

    @contextlib.asynccontextmanager
    async def device(
        self, dice: random.Random, way: str = "fin", *, is_verified: bool = False
    ) -> AsyncIterator[Connection]:
        """A device's connection, over TCP or UDP; ConnectionError when there is no room.

        `is_verified`: its address is one that the daemon trusts. To others it sends no more datagrams than they sent.
        """
        is_udp = self.udp is not None and dice.random() < UDP_SHARE
        to, dial = (self.udp or self.tcp, DatagramConnection.dial) if is_udp else (self.tcp, Connection.dial)
        source = dice.choice(VERIFIED_ADDRESSES) if is_udp and is_verified else hostile_address(dice)
        async with self._connected(to, source, DEVICE, way, dial=dial) as connection:
            yield connection

    @contextlib.asynccontextmanager
    async def board(self, dice: random.Random, way: str = "fin") -> AsyncIterator[tuple[Connection, Datagrams]]:
        """A micro-ROS board's connection, over TCP or UDP, and how its messages are framed there."""
        is_udp = self.udp is not None and dice.random() < BOARD_UDP_SHARE
        dial = DatagramConnection.dial if is_udp else Connection.dial
        is_verified = is_udp and dice.random() < VERIFIED_SHARE
        source = dice.choice(VERIFIED_ADDRESSES) if is_verified else hostile_address(dice)
        async with self._connected(self.micro_ros, source, DEVICE, way, dial=dial) as connection:
            yield connection, Datagrams() if is_udp else Lengths()

    @contextlib.asynccontextmanager
    async def program(
        self, dice: random.Random, way: str = "fin", *, kind: str = SOCKET, receive_bytes: int = 0
    ) -> AsyncIterator[Connection]:
        """A program's connection."""
        async with self._connected(self.api, hostile_address(dice), kind, way, receive_bytes) as connection:
            yield connection

    @contextlib.asynccontextmanager
    async def websocket(
        self,
        dice: random.Random,
        way: str = "fin",
        *,
        kind: str = SOCKET,
        receive_bytes: int = 0,
        handshake: Callable[[random.Random], bytes] = draw_handshake,
    ) -> AsyncIterator[Connection]:
        """A program's connection that has become a WebSocket, if the daemon agrees."""
        async with self.program(dice, way, kind=kind, receive_bytes=receive_bytes) as connection:
            await connection.send(handshake(dice))
            await connection.receive_until(b"\r\n\r\n", HANDSHAKE_WAIT_S)
            yield connection

    @contextlib.asynccontextmanager
    async def _connected(
        self,
        to: tuple[str, int],
        source: str,
        kind: str,
        way: str,
        receive_bytes: int = 0,
        dial: Dial = Connection.dial,
    ) -> AsyncIterator[Connection]:
        if not self.room.reserve(kind, 1):
            raise ConnectionError(f"no room for another {kind}")
        try:
            connection = await dial(to, source, kind, receive_bytes=receive_bytes)
        except BaseException:
            self.room.give_back(kind, 1)
            raise
        with leaving(connection, self.room, way):
            yield connection


async def introduce(connection: Connection, introduction: bytes) -> None:
    """Wait to be asked, though not for long, and announce."""
    await connection.receive_until(TOPICS_REQUEST, REQUEST_TIMEOUT_S)
    await connection.send(introduction)
