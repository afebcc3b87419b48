"""SimulatedRobot: the firmware on a board of its own, in real time. Pure: time comes in."""

import math

from hostlink.robot.kinematics import Pose
from hostlink.sim.firmware_world import Firmware, RobotKind, SimulatedWheel, WheelControl, World
from hostlink.sim.world_parameters import WorldParameters

BAUD = 38400  # the paper's
PASS_MS = 1000  # so many milliseconds at once, where it was not asked for longer


class SimulatedRobot:
    """Call `advance` as often as bytes shall leave its UART; each time the firmware runs until then.

    Between two calls `quiet_s` may pass where nothing is sent to it.
    """

    def __init__(
        self,
        name: str,
        *,
        world: WorldParameters | None = None,
        kind: RobotKind = RobotKind.PAPER,
        baud: int = BAUD,
        clock_rate: float = 1.0,
    ) -> None:
        """`baud` 0: bytes are through at once. `clock_rate`: seconds that its clock counts in one.

        Raises:
            ConfigError: wasmtime is not installed, or has no library for this machine.
            ValueError: a number of the world has no such name, or is out of its range.
        """
        self.name = name
        self.firmware = Firmware(world, name=name, baud=baud, kind=kind)
        self.firmware.set_clock(clock_rate)
        self._began_s: float | None = None
        self._passed_ms = 0

    @property
    def world(self) -> World:
        """Where it truly is, and what happens to it."""
        return self.firmware.world

    @property
    def wheels(self) -> tuple[SimulatedWheel, SimulatedWheel]:
        """Left and right."""
        return self.world.left, self.world.right

    @property
    def speed_m_s(self) -> float:
        """How fast the robot truly moves forward."""
        return (self.world.left.speed_m_s + self.world.right.speed_m_s) / 2

    @property
    def pose(self) -> Pose:
        """Where it believes that it is."""
        return self.world.odometry

    @property
    def controls(self) -> tuple[WheelControl, WheelControl]:
        """Of its wheels, left and right."""
        return self.firmware.controls

    @property
    def is_configured(self) -> bool:
        """Whether it has a host."""
        return self.firmware.is_configured

    @property
    def quiet_s(self) -> float:
        """For how long nothing will leave its UART, unless it receives something; 0: bytes are on the line."""
        return self.firmware.quiet_ms / 1000

    def receive(self, data: bytes) -> None:
        """Put bytes on the line to it, at the time of the last `advance`."""
        self.firmware.send(data)

    def advance(self, now_s: float) -> bytes:
        """Let the firmware run until now; returns what has left its UART since the last call."""
        if self._began_s is None:
            self._began_s = now_s
        due_ms = math.floor((now_s - self._began_s) * 1000) - self._passed_ms
        sent = b""
        while due_ms > 0:
            ms = min(due_ms, PASS_MS)
            sent += self.firmware.run(ms)
            self._passed_ms += ms
            due_ms -= ms
        return sent
