"""A simulated robot and a host that fails it."""

import asyncio
import contextlib
import socket
import struct

import pytest

from hostlink.core.protocol.rosserial.frame import Id, encode
from tests.support.simulated import simulated_robot
from tests.support.waiting import TIMEOUT_S

RESET = struct.pack("ii", 1, 0)


@pytest.mark.parametrize("is_reset", [False, True])
async def test_a_robot_connects_again_and_can_be_cancelled_however_its_connection_ends(*, is_reset: bool) -> None:
    """The last connection ends in the turn of the loop in which the robot is cancelled."""
    loop = asyncio.get_running_loop()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.setblocking(False)
        async with asyncio.timeout(TIMEOUT_S), simulated_robot(listener.getsockname()):
            for _ in range(2):
                connection, _ = await loop.sock_accept(listener)
                with contextlib.closing(connection):
                    await loop.sock_sendall(connection, encode(Id.PUBLISHER, b""))
                    assert await loop.sock_recv(connection, 4096)
                    if is_reset:
                        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
