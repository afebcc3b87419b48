"""Rolling: what the turning of a wheel means in metres and ticks, for both worlds alike. Pure."""

import math
from typing import Protocol

from hostlink.sim.world_parameters import WheelParameters


class _Turning(Protocol):
    @property
    def wheel(self) -> WheelParameters: ...

    @property
    def speed_rad_s(self) -> float: ...

    @property
    def rolled_rad(self) -> float: ...


class Rolling:
    """Of a wheel that knows how fast and how far it turns, signed."""

    @property
    def speed_m_s(self: _Turning) -> float:
        """How fast it rolls."""
        return self.speed_rad_s * self.wheel.radius_m

    @property
    def speed_ticks_s(self: _Turning) -> float:
        """How fast its encoder counts, with the sign that the encoder has not."""
        return self.speed_rad_s * self.wheel.ticks_per_turn / math.tau

    @property
    def rolled_ticks(self: _Turning) -> float:
        """How far it has rolled, signed, exact: the truth that odometry estimates."""
        return self.rolled_rad * self.wheel.ticks_per_turn / math.tau
