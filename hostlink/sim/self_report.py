"""What the robot knows of itself, as numbers: its battery and what is wrong. Pure; the twin of the firmware's."""

import math
from enum import IntEnum

SHOWN_S = 10.0
BATTERY_LOW_V = 10.5  # three cells of a LiPo at 3.5 V, six of lead at 1.75 V
RECOVERED_V = 0.3  # above the limit
LOW_TURNS = 50  # five seconds: a motor that starts costs a volt
SMOOTHING = 0.1  # of the newest tenth of a second


class Error(IntEnum):
    """The numbers of docs/robot.md#what-the-robot-knows-of-itself that a simulated robot can have."""

    LEFT_STALLED = 11
    RIGHT_STALLED = 12
    LEFT_RUNAWAY = 21
    RIGHT_RUNAWAY = 22
    NO_COMMAND = 31
    NO_NUMBER = 33
    REFUSED = 34
    BATTERY_LOW = 51


class Errors:
    """The errors of the last ten seconds, each once."""

    def __init__(self) -> None:
        self._at_s: dict[Error, float] = {}
        self._shown: list[int] = []

    def raise_(self, error: Error, now_s: float) -> None:
        """It is so now."""
        self._at_s[error] = now_s

    def numbers(self, now_s: float) -> list[int]:
        """Ascending; what is older is forgotten."""
        self._at_s = {error: at_s for error, at_s in self._at_s.items() if now_s - at_s < SHOWN_S}
        return sorted(self._at_s)

    def has_changed(self, numbers: list[int]) -> bool:
        """Whether these are others than at the last call."""
        has = numbers != self._shown
        self._shown = numbers
        return has


class Battery:
    """Smoothed over a second; low is what stays below the limit for five."""

    def __init__(self) -> None:
        self.volts = math.nan
        self.low_v = BATTERY_LOW_V
        self._low_turns = 0

    @property
    def is_low(self) -> bool:
        return self._low_turns == LOW_TURNS

    def add(self, volts: float) -> bool:
        """Ten times a second; returns whether it has become low."""
        was_low = self.is_low
        self.volts = volts if math.isnan(self.volts) else self.volts + SMOOTHING * (volts - self.volts)
        if self.volts < self.low_v + (RECOVERED_V if was_low else 0.0):
            self._low_turns = min(self._low_turns + 1, LOW_TURNS)
        else:
            self._low_turns = 0
        return self.is_low and not was_low
