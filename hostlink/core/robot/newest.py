"""Velocities of one source that wait on their way to a gate: which of them still matter. Pure."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from hostlink.core.robot.velocity import ZERO, Twist
from hostlink.errors import BadPayload

Velocity = TypeVar("Velocity")

TWIST_BYTES = len(ZERO.encode())


def newest(waiting: Sequence[Velocity], is_zero: Callable[[Velocity], bool]) -> list[Velocity]:
    """Return the newest velocity, after the newest zero before it. `waiting` is ordered by age, the oldest first.

    A zero is never skipped: it stops the robot, and lets its source drive again. The others are superseded.
    """
    for zero in reversed(waiting[:-1]):
        if is_zero(zero):
            return [zero, waiting[-1]]
    return list(waiting[-1:])


def is_zero_twist(payload: bytes) -> bool:
    """Whether a serialised Twist, or the Twist at the end of a TwistStamped, is zero; in ROS 1 and ROS 2 alike."""
    try:
        return Twist.decode(payload[-TWIST_BYTES:]).is_zero
    except BadPayload:
        return False
