"""Runs a simulated robot over UDP: datagrams with what its UART had sent, as a passthrough would send them."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable

from hostlink.sim.faults import Fault, FaultyLine
from hostlink.sim.robot import SimulatedRobot

GREETING_S = 1.0  # a host knows nothing of a device that has sent nothing
LINE_POLL_S = 0.004  # how often what has left the UART is passed on: as an ESP8266's loop does
RETRY_S = 0.5


async def talk_over_udp(
    robot: SimulatedRobot,
    host: str,
    port: int,
    *,
    fault: Fault,
    local_host: str | None = None,
    log: Callable[[str], None] = lambda _: None,
) -> None:
    """Talk from a socket of its own until the host has been silent for so long that the robot is not configured."""
    now_s = asyncio.get_running_loop().time
    device, line = robot.device, FaultyLine(fault)
    was_configured, greets_at_s = False, now_s()
    async with _socket(robot, host, port, local_host) as transport:
        while device.is_configured or not was_configured:
            if device.is_configured and not was_configured:
                was_configured = True
                log(f"{robot.name}: {host}:{port} has answered")
            elif not device.is_configured and now_s() >= greets_at_s:
                greets_at_s = now_s() + GREETING_S
                device.request_time(now_s())
            data = line.pass_on(device.to_host.pop(now_s()))
            if data:
                transport.sendto(data)
            await asyncio.sleep(LINE_POLL_S)
    log(f"{robot.name}: {host}:{port} does not answer any more")


@contextlib.asynccontextmanager
async def _socket(
    robot: SimulatedRobot, host: str, port: int, local_host: str | None
) -> AsyncIterator[asyncio.DatagramTransport]:
    local = None if local_host is None else (local_host, 0)
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: _FromHost(robot), remote_addr=(host, port), local_addr=local
    )
    try:
        yield transport
    finally:
        robot.device.from_host.cut()
        robot.device.to_host.cut()
        transport.close()


class _FromHost(asyncio.DatagramProtocol):
    """What comes goes to the robot's UART; an ICMP error says no more than silence."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot = robot

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:  # noqa: ARG002 - asyncio's signature
        self._robot.device.from_host.send(data, asyncio.get_running_loop().time())
