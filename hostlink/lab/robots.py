"""The robots that the laboratory drives: the project's firmware, and the paper's software, each in a world of its own.

Time is virtual; a minute of the robot takes a tenth of a second.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol

from hostlink.lab.paper_software import LEFT_GAINS, LOOP_S, RIGHT_GAINS, Mistakes, PaperWheel
from hostlink.robot.kinematics import DifferentialDrive, Pose
from hostlink.sim.firmware_world import COMMAND_S, Firmware, FirmwareWorld, SimulatedWheel, World
from hostlink.sim.world_parameters import WorldParameters

_SUBSTEPS = 4  # of the world in a turn of the paper's loop


class LabRobot(Protocol):
    """What an operator drives, and what he measures."""

    @property
    def world(self) -> World:
        """The truth."""

    @property
    def odometry(self) -> Pose:
        """What the robot believes."""

    def command(self, linear_m_s: float, angular_rad_s: float) -> None:
        """Drive like this until the next command."""

    def advance(self, seconds: float) -> None:
        """Let time pass."""


class FirmwareRobot:
    """The firmware of the Due as the board executes it. The host repeats the command, as teleop does."""

    def __init__(
        self, parameters: WorldParameters, device_parameters: Mapping[str, Sequence[float]] | None = None
    ) -> None:
        """`device_parameters`: what the host answers to the firmware's questions: `wheel_radius` and so on.

        Raises:
            ConfigError: wasmtime is not installed, or has no library for this machine.
        """
        self._robot = FirmwareWorld(parameters, device_parameters=device_parameters)
        self._robot.connect()
        self._velocity = (0.0, 0.0)

    @property
    def world(self) -> World:
        """The truth."""
        return self._robot.world

    @property
    def odometry(self) -> Pose:
        """What the firmware believes."""
        return self._robot.odometry

    def command(self, linear_m_s: float, angular_rad_s: float) -> None:
        """Drive like this until the next command."""
        self._velocity = (linear_m_s, angular_rad_s)

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        left_s = seconds
        while left_s > 0.0005:  # noqa: PLR2004 - time passes in milliseconds
            self._robot.command(*self._velocity)
            self._robot.run(min(left_s, COMMAND_S))
            left_s -= COMMAND_S


class PaperRobot:
    """The paper's software at thirty turns a second; some of its mistakes may be mended."""

    def __init__(self, parameters: WorldParameters, mistakes: Mistakes | None = None) -> None:
        made = Mistakes() if mistakes is None else mistakes
        self.world = Firmware(_never_braking(parameters) if made.never_brakes else parameters).world
        self.odometry = Pose()
        self._controllers = (PaperWheel(LEFT_GAINS, made), PaperWheel(RIGHT_GAINS, made))
        self._sign_is_the_pin_s = made.sign_by_direction_pin
        self._drive = DifferentialDrive()
        self._edges = [0, 0]
        self._rolled_rad = [0.0, 0.0]
        self._turns = 0
        self._due_s = 0.0

    def command(self, linear_m_s: float, angular_rad_s: float) -> None:
        """One message: the sketch drives like this until the next one."""
        now_s = self._turns * LOOP_S
        for wheel, speed_m_s in zip(
            self._controllers, self._drive.wheel_speeds(linear_m_s, angular_rad_s), strict=True
        ):
            wheel.aim(speed_m_s / self._drive.metres_per_tick, now_s)

    def advance(self, seconds: float) -> None:
        """Let time pass, in whole turns of the loop."""
        self._due_s += seconds
        while self._due_s >= LOOP_S / 2:
            self._due_s -= LOOP_S
            self._turn()

    def _turn(self) -> None:
        left, right = self._controllers
        self.world.turn_motors(left.pwm, right.pwm, LOOP_S / _SUBSTEPS, _SUBSTEPS)
        self._turns += 1
        metres = [
            self._step(side, wheel) * self._drive.metres_per_tick
            for side, wheel in enumerate((self.world.left, self.world.right))
        ]
        self.odometry = self._drive.integrate(self.odometry, metres[0], metres[1])

    def _step(self, side: int, wheel: SimulatedWheel) -> float:
        edges = wheel.edges
        counted, self._edges[side] = edges - self._edges[side], edges
        sign = 1 if self._sign_is_the_pin_s else self._true_sign(side, wheel)
        return self._controllers[side].step(counted, sign, self._turns * LOOP_S)

    def _true_sign(self, side: int, wheel: SimulatedWheel) -> int:
        rolled_rad = wheel.rolled_rad
        way_rad, self._rolled_rad[side] = rolled_rad - self._rolled_rad[side], rolled_rad
        return -1 if way_rad < 0.0 else 1


def _never_braking(parameters: WorldParameters) -> WorldParameters:
    coasting = {
        "left.brake_constant_s": parameters["left.coast_constant_s"],
        "right.brake_constant_s": parameters["right.coast_constant_s"],
    }
    return parameters.changed(coasting)
