"""Refusals: velocities that did not fit a robot's device."""

import asyncio
from dataclasses import dataclass

import structlog

from hostlink.errors import HostlinkError

log = structlog.get_logger()

LOG_INTERVAL_S = 10.0  # for what is refused again and again: a driver repeats his command ten times a second


@dataclass(slots=True)
class Refusals:
    """Velocities that did not fit a robot's device."""

    count: int = 0
    cause: str | None = None  # of the last velocity; None: it was sent
    log_at_s: float = float("-inf")
    logged: int = 0

    def add(self, robot: str, error: HostlinkError) -> None:
        """Log the first, then one in LOG_INTERVAL_S with the number of those since."""
        self.count += 1
        self.cause = str(error)
        now_s = asyncio.get_running_loop().time()
        if now_s >= self.log_at_s:
            log.warning("robot.unreachable", robot=robot, cause=self.cause, count=self.count - self.logged)
            self.log_at_s, self.logged = now_s + LOG_INTERVAL_S, self.count
