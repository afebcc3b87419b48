"""The component of docs/components.md: it sends the robots' states by UDP, and takes stops."""

import asyncio
import json
from dataclasses import dataclass
from typing import ClassVar

from hostlink.core.host import Component, Host
from hostlink.errors import ConfigError, HostlinkError


@dataclass(frozen=True, kw_only=True)
class StatusSettings:
    """The table [status] of hostlink.toml."""

    host: str = "127.0.0.1"
    port: int
    interval_s: float = 1.0


class Status(Component[StatusSettings]):
    """A JSON line of each robot to an address at an interval. The datagram "stop" from there stops every robot."""

    name = "status"
    settings_type = StatusSettings
    log_events: ClassVar = {"status.stopped": "a datagram has stopped the robots"}

    def check(self) -> tuple[str, ...]:
        """Check the port."""
        if not 0 < self.settings.port <= 0xFFFF:
            raise ConfigError("status.port", f"{self.settings.port} is not a port")
        return () if self.settings.host == "127.0.0.1" else ("whoever receives at this address can stop every robot",)

    def describe(self) -> str:
        """One line for --check-config."""
        return f"states of robots to udp://{self.settings.host}:{self.settings.port}"

    async def run(self, host: Host) -> None:
        """Send, and take stops. Several that wait are one."""
        is_wanted = asyncio.Event()

        class Receiver(asyncio.DatagramProtocol):
            def datagram_received(self, data: bytes, addr: object) -> None:  # noqa: ARG002 - as asyncio calls it
                if data == b"stop":
                    is_wanted.set()
                else:
                    host.count("malformed")

        address = (self.settings.host, self.settings.port)
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(Receiver, remote_addr=address)
        try:
            host.spawn(self._send(host, transport), name="sender")
            while True:
                await is_wanted.wait()
                is_wanted.clear()
                await self._stop(host)
        finally:
            transport.close()

    async def _send(self, host: Host, transport: asyncio.DatagramTransport) -> None:
        while True:
            for robot in host.robots():
                state = {"name": robot.name, "connected": robot.link is not None, "battery_v": robot.battery_v}
                transport.sendto(json.dumps(state).encode())
                host.count("sent")
            await asyncio.sleep(self.settings.interval_s)

    async def _stop(self, host: Host) -> None:
        try:
            stopped = await host.stop(by="a datagram", wait_s=0.0)
        except HostlinkError as error:  # of one robot; all others are stopped
            host.report(f"a stop has failed: {error}")
            return
        host.report("")
        host.log.info("status.stopped", robots=len(stopped.robots), unreached=stopped.unreached)
