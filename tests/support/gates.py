"""Velocity gates as their tests want them."""

import asyncio
import dataclasses
from collections.abc import Hashable

from hostlink.core.hub.any_robot import AnyRobot
from hostlink.core.robot.admission import LEASE_S, Admission, Command
from hostlink.core.robot.velocity import ZERO, PlanarVelocity
from hostlink.core.robot.velocity_gate import Limits, V, VelocityGate

FREE = Limits(max_linear_m_s=None, max_angular_rad_s=None)
GENTLE = Limits(max_linear_acceleration_m_s2=1.0, max_angular_acceleration_rad_s2=10.0)
HEAVY = dataclasses.replace(GENTLE, max_linear_deceleration_m_s2=2.0, max_angular_deceleration_rad_s2=20.0)
FORWARD = PlanarVelocity(0.3)
TURN = PlanarVelocity(0.2, yaw_rad_s=1.0)


def drive_gate(
    robot: AnyRobot,
    velocity: PlanarVelocity,
    *,
    owner: Hashable = "test",
    priority: int = 50,
    epoch: int | None = None,
) -> PlanarVelocity:
    """A command of an owner that has just come."""
    now_s = asyncio.get_running_loop().time()
    return robot.command(Command(velocity, owner, priority, now_s, epoch=epoch))


class GateOfRobot(VelocityGate[PlanarVelocity]):
    """A gate and its admission together, as `Gates` uses them."""

    def __init__(self, limits: Limits, *, lease_s: float = LEASE_S) -> None:
        super().__init__(Admission("robot_0", lease_s=lease_s), limits, ZERO)
        self.admission.connect(0.0)

    def drive(self, owner: str, velocity: PlanarVelocity, *, now_s: float, priority: int = 50) -> PlanarVelocity:
        return self.command(Command(velocity, owner, priority, now_s), now_s=now_s)

    def interrupt(self, *, now_s: float) -> None:
        self.admission.interrupt(now_s)
        self.stop(now_s=now_s)

    def withdraw(self, owner: str, *, now_s: float) -> None:
        is_driving = self.owner == owner
        self.admission.withdraw(owner)
        if is_driving:
            self.stop(now_s=now_s)

    def lock(self, reason: str, *, now_s: float) -> None:
        self.admission.lock(reason, now_s)
        self.stop_at_once()

    def connect(self, *, now_s: float) -> None:
        self.admission.connect(now_s)
        self.restart()


def gate(limits: Limits = FREE) -> GateOfRobot:
    return GateOfRobot(limits)


def driven(limits: Limits = FREE, *, priority: int = 50) -> GateOfRobot:
    """`ann` drives forward since 0 s, and the robot knows."""
    ours = gate(limits)
    ours.drive("ann", FORWARD, priority=priority, now_s=0.0)
    ours.step(0.0)
    return ours


def outputs(ours: VelocityGate[V], now_s: float, count: int = 5) -> list[V | None]:
    return [ours.step(now_s + number * 0.05) for number in range(count)]


STOPPED = [ZERO, ZERO, ZERO, None, None]


def moving(limits: Limits, velocity: PlanarVelocity = FORWARD) -> GateOfRobot:
    """`ann` has driven at this velocity for a while, until 1.0 s."""
    ours = gate(limits)
    for tenths in range(11):
        ours.drive("ann", velocity, priority=50, now_s=tenths / 10)
        ours.step(tenths / 10)
    assert ours.current == velocity
    return ours
