"""Velocity gates as their tests want them."""

import dataclasses

from hostlink.robot.velocity import ZERO, Velocity
from hostlink.robot.velocity_gate import Limits, VelocityGate

FREE = Limits(max_linear_m_s=None, max_angular_rad_s=None)
GENTLE = Limits(max_linear_acceleration_m_s2=1.0, max_angular_acceleration_rad_s2=10.0)
HEAVY = dataclasses.replace(GENTLE, max_linear_deceleration_m_s2=2.0, max_angular_deceleration_rad_s2=20.0)
FORWARD = Velocity(0.3)
TURN = Velocity(0.2, angular_z_rad_s=1.0)


def gate(limits: Limits = FREE) -> VelocityGate:
    return VelocityGate("robot_0", limits)


def driven(limits: Limits = FREE, *, priority: int = 50) -> VelocityGate:
    """`ann` drives forward since 0 s, and the robot knows."""
    ours = gate(limits)
    ours.command("ann", FORWARD, priority=priority, now_s=0.0)
    ours.step(0.0)
    return ours


def outputs(ours: VelocityGate, now_s: float, count: int = 5) -> list[Velocity | None]:
    return [ours.step(now_s + number * 0.05) for number in range(count)]


STOPPED = [ZERO, ZERO, ZERO, None, None]


def moving(limits: Limits, velocity: Velocity = FORWARD) -> VelocityGate:
    """`ann` has driven at this velocity for a while, until 1.0 s."""
    ours = gate(limits)
    for tenths in range(11):
        ours.command("ann", velocity, priority=50, now_s=tenths / 10)
        ours.step(tenths / 10)
    assert ours.current == velocity
    return ours
