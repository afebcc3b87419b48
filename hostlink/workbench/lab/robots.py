"""The laboratory's robots: the project's firmware and the rebuilt software of the paper, each in its own world.

Time is virtual: a minute of the robot takes a tenth of a second. The paper's software is rebuilt from the paper and its
sketch: docs/paper-errors.md#where-the-paper-and-its-code-are-wrong. RandomNumbers are those of the operator.
"""

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

from hostlink.core.robot.kinematics import DifferentialDrive, Pose
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.workbench.motor_model import PidGains
from hostlink.workbench.sim.firmware_module import WorldParameters
from hostlink.workbench.sim.firmware_world import Firmware, FirmwareWorld, SimulatedWheel

# -- random numbers ---------------------------------------------------------------------------------------------------

_MULTIPLIER = 6364136223846793005
_MASK_64 = (1 << 64) - 1
_MASK_32 = (1 << 32) - 1

LOOP_S = 1 / 30
FULL_PWM = 4095
FULL_SPEED_TICKS_S = 280.0
DEAD_BAND_PWM = 10
LEAST_PWM = 700
FILTER = 0.1  # weight of the newest speed
S_PER_TICK_S = 0.018  # duration of a minimum-jerk curve, for each tick/s of its change

FEEDBACK = 0.05  # share of the last output that the PID subtracts from its error


class RandomNumbers:
    """Random numbers of a seed and a stream: PCG32 (O'Neill 2014, XSH-RR), normal numbers by Box and Muller."""

    def __init__(self, seed: int, stream: int) -> None:
        self._state = 0
        self._increment = ((stream << 1) | 1) & _MASK_64
        self._next()
        self._state = (self._state + seed) & _MASK_64
        self._next()

    def uniform(self) -> float:
        """Return a number in (0, 1)."""
        return (self._next() + 0.5) / 4294967296.0

    def normal(self) -> float:
        """Return a number with mean 0 and standard deviation 1."""
        radius = math.sqrt(-2.0 * math.log(self.uniform()))
        return radius * math.cos(math.tau * self.uniform())

    def _next(self) -> int:
        old = self._state
        self._state = (old * _MULTIPLIER + self._increment) & _MASK_64
        shifted = (((old >> 18) ^ old) >> 27) & _MASK_32
        turn = old >> 59
        return ((shifted >> turn) | (shifted << (-turn & 31))) & _MASK_32


# -- software of the paper --------------------------------------------------------------------------------------------

_INTEGRAL_LIMIT = 4095.0  # of the sum of errors, before Ki: too high to have an effect
_WASHOUT_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Mistakes:
    """Mistakes of the paper's software. False is the correct behaviour."""

    sign_by_direction_pin: bool = True  # else the true direction, as a two-channel encoder measures it
    drives_against: bool = True  # the PID's output may turn against the set-point; else it ends at zero
    filtered_odometry: bool = True  # integrates the filtered speed; else ticks
    rising_edges_only: bool = True  # else both edges, half a tick each
    slow_stop: bool = True  # zero is reached along a minimum-jerk curve, in 3.6 s from 200 ticks/s; else at once
    steady_feedback: bool = True  # keeps the speed 5 % low; else washed out
    wrong_derivative: bool = True  # wrong sign of the derivative
    wound_integral: bool = (
        True  # not reset, limited to 4095 before Ki; else reset at rest and held at the output's limit
    )
    single_precision_time: bool = True  # microseconds in a 32-bit float
    never_brakes: bool = True  # BRAKE stays low: PWM 0 lets the motor coast

    @classmethod
    def none(cls) -> Self:
        """Return the software without mistakes."""
        return cls(**dict.fromkeys(names(), False))

    def changed(self, name: str, *, is_made: bool) -> Self:
        """Return a copy with one mistake made or corrected."""
        return replace(self, **{name: is_made})


def names() -> list[str]:
    """Names of all mistakes."""
    return [item.name for item in fields(Mistakes)]


LEFT_GAINS, RIGHT_GAINS = PidGains(23.0, 36.0, 0.1), PidGains(24.0, 35.0, 0.1)  # table 1 of the paper


class PaperWheel:
    """One wheel of the paper's software: set-point, filter, PID and odometry."""

    def __init__(self, gains: PidGains, mistakes: Mistakes) -> None:
        self.gains, self.mistakes = gains, mistakes
        self.pwm = 0
        self.speed_ticks_s = 0.0  # filtered
        self.set_point_ticks_s = 0.0
        self._from = self._target = 0.0
        self._begun_us = self._end_us = 0.0
        self._edges = 0  # since the start; their parity is the level of the encoder's pin
        self._integral = self._last_error = self._output = self._steady_ticks_s = 0.0

    def aim(self, ticks_s: float, now_s: float) -> None:
        """Start a new command at the measured speed, not at the set-point."""
        self._from, self._target = self.speed_ticks_s, ticks_s
        self._begun_us = self._time(now_s)
        length_s = abs(self._target - self._from) * S_PER_TICK_S
        if ticks_s == 0.0 and not self.mistakes.slow_stop:
            length_s = 0.0
        self._end_us = self._time(now_s + length_s)

    def step(self, edges: int, true_sign: int, now_s: float) -> float:
        """Run one turn of the loop. Return the ticks for odometry. `edges`: rising and falling ones."""
        ticks = self._ticks(edges) * (self._pin_sign() if self.mistakes.sign_by_direction_pin else true_sign)
        self.speed_ticks_s += FILTER * (ticks / LOOP_S - self.speed_ticks_s)
        self._step_set_point(now_s)
        self._output = self._regulate()
        self.pwm = motor_output(self._output)
        return self.speed_ticks_s * LOOP_S if self.mistakes.filtered_odometry else ticks

    def _ticks(self, edges: int) -> float:
        before = self._edges
        self._edges += edges
        if not self.mistakes.rising_edges_only:
            return edges / 2
        return float((self._edges + 1) // 2 - (before + 1) // 2)

    def _pin_sign(self) -> int:
        return -1 if self._output < 0.0 else 1

    def _time(self, time_s: float) -> float:
        microseconds = float(int(time_s * 1e6))
        if not self.mistakes.single_precision_time:
            return microseconds
        single: float = struct.unpack("f", struct.pack("f", microseconds))[0]
        return single

    def _step_set_point(self, now_s: float) -> None:
        length_us = self._end_us - self._begun_us
        share = 1.0 if length_us <= 0.0 else min((self._time(now_s) - self._begun_us) / length_us, 1.0)
        curve = 10 * share**3 - 15 * share**4 + 6 * share**5
        self.set_point_ticks_s = self._from + (self._target - self._from) * curve

    def _regulate(self) -> float:
        if self.set_point_ticks_s == 0.0 and not self.mistakes.wound_integral:
            self._integral = self._last_error = self._steady_ticks_s = 0.0
            return 0.0
        gains, mistakes = self.gains, self.mistakes
        error = self.set_point_ticks_s - self.speed_ticks_s - FEEDBACK * self._fed_back_ticks_s()
        slope = (error - self._last_error) / LOOP_S * (-1.0 if mistakes.wrong_derivative else 1.0)
        integral = max(-_INTEGRAL_LIMIT, min(_INTEGRAL_LIMIT, self._integral + error * LOOP_S))
        free = gains.kp * error + gains.ki * integral + gains.kd * slope
        low, high = self._limits()
        output = max(low, min(high, free))
        if mistakes.wound_integral or output == free or (free > 0) != (error > 0):
            self._integral = integral
        self._last_error = error
        return output

    def _limits(self) -> tuple[float, float]:
        full = float(FULL_PWM)
        if self.mistakes.drives_against:
            return -full, full
        return (0.0, full) if (self.set_point_ticks_s or self._from) >= 0.0 else (-full, 0.0)

    def _fed_back_ticks_s(self) -> float:
        last_ticks_s = self._output / FULL_PWM * FULL_SPEED_TICKS_S
        if self.mistakes.steady_feedback:
            return last_ticks_s
        quick_ticks_s = last_ticks_s - self._steady_ticks_s
        self._steady_ticks_s += quick_ticks_s * LOOP_S / (_WASHOUT_S + LOOP_S)
        return quick_ticks_s


def motor_output(wanted: float) -> int:
    """Return the signed PWM: 0 for sizes up to 10, otherwise 700 to 4095."""
    size = min(abs(wanted), FULL_PWM)
    if size <= DEAD_BAND_PWM:
        return 0
    return math.floor(max(size, LEAST_PWM) + 0.5) * (1 if wanted > 0 else -1)


# -- robots -----------------------------------------------------------------------------------------------------------

_SUBSTEPS = 4  # steps of the world in one turn of the paper's loop


class FirmwareRobot:
    """Robot with the firmware of the Due. The host repeats the command, as teleop does."""

    def __init__(
        self, parameters: WorldParameters, device_parameters: Mapping[str, Sequence[float]] | None = None
    ) -> None:
        """Connect the firmware. `device_parameters`: answers to its parameter requests, such as `wheel_radius`.

        Raises:
            ConfigError: wasmtime is not installed, or has no library for this machine.
        """
        self._robot = FirmwareWorld(parameters, device_parameters=device_parameters)
        self._robot.connect()
        self.world = self._robot.world
        self._velocity = (0.0, 0.0)

    @property
    def odometry(self) -> Pose:
        """Pose by the firmware's odometry."""
        return self.world.odometry

    def command(self, linear_m_s: float, angular_rad_s: float) -> None:
        """Drive at this velocity until the next command."""
        self._velocity = (linear_m_s, angular_rad_s)

    def advance(self, seconds: float) -> None:
        """Advance the time."""
        self._robot.drive(*self._velocity, seconds)


class PaperRobot:
    """Robot with the paper's software at thirty turns a second, with all or some of its mistakes."""

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
        """Drive at this velocity until the next command."""
        now_s = self._turns * LOOP_S
        for wheel, speed_m_s in zip(
            self._controllers,
            self._drive.wheel_speeds(PlanarVelocity(linear_m_s, 0.0, angular_rad_s)),
            strict=True,
        ):
            wheel.aim(speed_m_s / self._drive.metres_per_tick, now_s)

    def advance(self, seconds: float) -> None:
        """Advance the time in whole turns of the loop."""
        self._due_s += seconds
        while self._due_s >= LOOP_S / 2:
            self._due_s -= LOOP_S
            self._turn()

    def _turn(self) -> None:
        left, right = self._controllers
        self.world.turn_motors(left.pwm, right.pwm, LOOP_S / _SUBSTEPS, _SUBSTEPS)
        self._turns += 1
        metres = [self._step(side, wheel) * self._drive.metres_per_tick for side, wheel in enumerate(self.world.wheels)]
        self.odometry = self._drive.integrate(self.odometry, (metres[0], metres[1]))

    def _step(self, side: int, wheel: SimulatedWheel) -> float:
        edges = wheel.edges
        counted, self._edges[side] = edges - self._edges[side], edges
        sign = 1 if self._sign_is_the_pin_s else self._true_sign(side, wheel)
        return self._controllers[side].step(counted, sign, self._turns * LOOP_S)

    def _true_sign(self, side: int, wheel: SimulatedWheel) -> int:
        rolled_rad = wheel.rolled_rad
        way_rad, self._rolled_rad[side] = rolled_rad - self._rolled_rad[side], rolled_rad
        return -1 if way_rad < 0.0 else 1


LabRobot = FirmwareRobot | PaperRobot  # what the operator drives and measures


def _never_braking(parameters: WorldParameters) -> WorldParameters:
    coasting = {
        "left.brake_constant_s": parameters["left.coast_constant_s"],
        "right.brake_constant_s": parameters["right.coast_constant_s"],
    }
    return parameters.changed(coasting)
