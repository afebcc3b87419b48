"""RemoteOdometry and RemoteLink: what is known here of a robot of another host."""

import dataclasses
import math
from typing import NamedTuple

from hostlink.core.robot.odometry import OdometrySnapshot, aged_rate_hz


class RemoteLink(NamedTuple):
    """Connection of a device of another host. `number` is of this daemon, `own_number` of its host."""

    number: int
    own_number: int


class RemoteOdometry:
    """Newest pose of a robot of another host."""

    def __init__(self) -> None:
        self.read_at_s = -math.inf
        self.count = 0
        self._newest: OdometrySnapshot | None = None
        self._at_s = 0.0

    def withdraw(self) -> None:
        """Drop the newest pose: the robot's host has dropped it, too."""
        self._newest = None

    def update(self, newest: OdometrySnapshot, now_s: float) -> bool:
        """Set the newest pose. Return whether it differs from the one before."""
        is_new = self._newest is None or (newest.count, newest.restarts) != (self._newest.count, self._newest.restarts)
        self._newest, self._at_s, self.count = newest, now_s, newest.count
        return is_new

    def snapshot(self, now_s: float) -> OdometrySnapshot | None:
        """Return the newest pose with its age; None before the first."""
        self.read_at_s = now_s
        if self._newest is None:
            return None
        age_s = self._newest.age_s + now_s - self._at_s
        return dataclasses.replace(self._newest, age_s=age_s, rate_hz=aged_rate_hz(self._newest.rate_hz, age_s))
