"""Notifier: the daemon's messages to systemd, which started it as a service."""

import asyncio
import os
import socket
from collections.abc import Callable, Mapping

import structlog

log = structlog.get_logger()

STATUS_INTERVAL_S = 10.0  # without a watchdog
_US_PER_S = 1_000_000


class Notifier:
    """Client of systemd's notify socket. Does nothing when NOTIFY_SOCKET is unset."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._interval_s = STATUS_INTERVAL_S
        microseconds = environment.get("WATCHDOG_USEC", "")
        is_for_us = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        if is_for_us and microseconds.isdecimal() and int(microseconds):
            self._interval_s = int(microseconds) / _US_PER_S / 2  # as sd_watchdog_enabled(3) advises

    def notify(self, *assignments: str) -> None:
        """Send `NAME=value` lines. A socket that cannot be written is logged and does not stop the daemon."""
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK) as channel:
            try:
                channel.sendto("\n".join(assignments).encode(), self._address)
            except OSError as error:
                log.debug("systemd.notify_failed", reason=error.strerror)

    async def beat(self, status: Callable[[], str]) -> None:
        """Feed systemd's watchdog and report the status, until cancelled."""
        while self._address:
            self.notify("WATCHDOG=1", f"STATUS={status()}")
            await asyncio.sleep(self._interval_s)
