"""Standstill: whether a robot is stopped or moves, by its odometry. Pure: odometry and times are arguments.

A stop is confirmed by what was measured after it, and a driven robot that does not move is a warning.

| after a stop                                                        | state     |
|---------------------------------------------------------------------|-----------|
| odometry since then is still for STEADY_S, in two poses or more     | `stopped` |
| odometry since then moves                                           | `moving`  |
| no odometry since then, or one still pose alone                     | `unknown` |
"""

from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple

from hostlink.core.runtime.compiled import mypyc_attr

STILL_M_S = 0.005  # motion of a stopped robot by noise
STILL_RAD_S = 0.02
STEADY_S = 0.08  # two poses at 10 Hz, with their jitter: a robot that reverses is still in one pose
LONGEST_ANSWER_S = 0.5  # a device that was just switched on took longer for its first answer than it does later
PATIENCE_S = 1.0  # a heavy robot has begun to move by then
OLD_S = 1.0  # odometry is published ten times a second and more


NO_ODOMETRY = "it has no odometry"  # the reason of a robot that was sent its zero, and measures nothing


class StandstillState(StrEnum):
    """Result of odometry after a stop."""

    STOPPED = "stopped"
    MOVING = "moving"
    UNKNOWN = "unknown"


@mypyc_attr(allow_interpreted_subclasses=True)
class Standstill(NamedTuple):
    """Measured motion. `after_s` is when the robot was first stopped; `reason` is empty if it is stopped.

    The speeds are the newest; None: no odometry came since the stop, or it tells only whether the robot moves.
    """

    state: StandstillState
    speed_m_s: float | None = None
    turn_rad_s: float | None = None
    after_s: float | None = None
    reason: str = ""


class Speeds(NamedTuple):
    """Speeds of a robot, along its path and around its axis; None if only `is_moving` is known."""

    speed_m_s: float | None = None
    turn_rad_s: float | None = None
    is_moving: bool = True

    @property
    def are_still(self) -> bool:
        """Whether this motion is only noise."""
        if self.speed_m_s is None or self.turn_rad_s is None:
            return not self.is_moving
        return abs(self.speed_m_s) <= STILL_M_S and abs(self.turn_rad_s) <= STILL_RAD_S


def sentence(robot: str, measured: Standstill) -> str:
    """Measurement as a sentence for people."""
    if measured.state is StandstillState.STOPPED:
        speed = "" if measured.speed_m_s is None else f"{abs(measured.speed_m_s):.2f} m/s "
        return f"{robot} is stopped ({speed}after {measured.after_s or 0.0:.1f} s)"
    if measured.reason == NO_ODOMETRY:
        return f"zero sent; {robot} has no odometry, so nobody can say that it is stopped"
    if measured.state is StandstillState.UNKNOWN:
        return f"{robot}: it is not known whether it is stopped: {measured.reason}"
    if measured.speed_m_s is None:
        return f"{robot} still moves: {measured.reason}"
    speed_m_s, turn_rad_s = abs(measured.speed_m_s), abs(measured.turn_rad_s or 0.0)
    motion = f"moves at {speed_m_s:.2f} m/s" if speed_m_s > STILL_M_S else f"turns at {turn_rad_s:.2f} rad/s"
    return f"{robot} still {motion}: {measured.reason}"


class StopWatch:
    """Observes the odometry of one robot from a stop at `began_s` on.

    `answer_s` is the time that its device takes to answer. Odometry that arrives earlier may be from before the stop.
    """

    def __init__(self, began_s: float, answer_s: float = 0.0) -> None:
        self._began_s = began_s
        self._newest: Speeds | None = None
        self._newest_s = began_s + min(answer_s, LONGEST_ANSWER_S)
        self._still_since_s: float | None = None

    def observe(self, speeds: Speeds, received_s: float) -> None:
        """The newest odometry, and when it was received; the same one again is nothing new."""
        if received_s <= self._newest_s:
            return
        self._newest, self._newest_s = speeds, received_s
        if not speeds.are_still:
            self._still_since_s = None
        elif self._still_since_s is None:
            self._still_since_s = received_s

    @property
    def is_standing(self) -> bool:
        """Whether it has stood for long enough."""
        return self._still_since_s is not None and self._newest_s >= self._still_since_s + STEADY_S

    def result(self, why_moving: Callable[[], str], why_unknown: Callable[[], str]) -> Standstill:
        """Result of the measurement. The reasons are from the robot's other state."""
        if self._newest is None:
            return Standstill(StandstillState.UNKNOWN, reason=why_unknown())
        if self._still_since_s is None:
            return Standstill(StandstillState.MOVING, *self._newest[:2], reason=why_moving())
        if not self.is_standing:
            reason = "too little odometry has come since the stop"
            return Standstill(StandstillState.UNKNOWN, *self._newest[:2], reason=reason)
        return Standstill(StandstillState.STOPPED, *self._newest[:2], after_s=self._still_since_s - self._began_s)


class DriveWatch:
    """Observes a robot that is driven; `warning` says why it does not move, and is empty while all is well."""

    def __init__(self) -> None:
        self.warning = ""
        self._still_since_s: float | None = None

    def observe(self, commanded: Speeds, measured: Speeds | None, now_s: float, *, age_s: float = 0.0) -> None:
        """`measured` is None before the first odometry; `age_s` is its age."""
        if commanded.are_still:
            self._still_since_s = None
            self.warning = ""
            return
        cause = _why_still(measured, age_s)
        if not cause:
            self._still_since_s = None
        elif self._still_since_s is None:
            self._still_since_s = now_s
        is_long = self._still_since_s is not None and now_s >= self._still_since_s + PATIENCE_S
        self.warning = cause if is_long else ""


def _why_still(measured: Speeds | None, age_s: float) -> str:
    if measured is None or age_s > OLD_S:
        return "it is driven and sends no odometry: is its link alive? `hostlink doctor` knows more"
    if not measured.are_still:
        return ""
    return "it is driven and its odometry does not change: motors without power, or a wheel blocked?"
