"""The Due's firmware in a world, as the board executes it: `Firmware`; with a host: `FirmwareWorld`. Pure.

Time is virtual: a minute of the robot takes milliseconds. Each object is one robot; use it from one thread only.
`follow` drives a course, and `Person` measures its end, for `hostlink calibrate --simulate`.
"""

import ctypes
import math
import struct
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hostlink.client.course import CourseFollower, Leg
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.events import Parameter
from hostlink.core.protocol.rosserial.control import (
    Log,
    decode_log,
    decode_parameter_request,
    decode_topic_info,
    encode_parameter,
    encode_time,
)
from hostlink.core.protocol.rosserial.frame import STOP_REQUEST, TOPICS_REQUEST, Frame, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.robot.kinematics import Pose, placed
from hostlink.core.robot.odometry import OdometryCorrection
from hostlink.workbench.sim.firmware_module import LINE_BYTES, MOST_ROWS, Control, Instance, WorldParameters, columns

# -- firmware ---------------------------------------------------------------------------------------------------------

COMMAND_S = 0.1  # between two velocities; the firmware stops after 0.5 s without one
CONNECT_S = 2.0  # for topics and parameters, which need half of it at 38400 baud
_ANSWER_MS = 100  # interval at which the robot's requests are answered
_FRAMES = 100_000  # the frames of an hour

READING_ERROR_M = 0.002  # standard deviation of a distance read off the tape measure
READING_ERROR_RAD = math.radians(0.5)  # standard deviation of an angle, and of the mark's direction
LONGEST_S = 1800.0  # for one course: a robot that needs longer does not move


class Retry(IntEnum):
    """Policy of the firmware for an incomplete frame, as in node.h."""

    NONE = 0
    PAPER = 1
    KEEP_STATE = 2


class Feedback(IntEnum):
    """Part of its last output that the firmware's PID subtracts from its error, as in constants.h."""

    WASHED_OUT = 0  # only changes: a steady output does not lower the speed
    PAPER = 1  # all: the integral then keeps each speed 5 % below the request


class RobotKind(StrEnum):
    """Kind of simulated robot: how quickly it follows its commands."""

    NIMBLE = "nimble"
    PAPER = "paper"


class WheelControl(NamedTuple):
    """The gains of one wheel's PID, and the speed that was commanded last."""

    kp: float
    ki: float
    kd: float
    target_ticks_s: float


@cache
def _at() -> Mapping[str, int]:
    return {name: index for index, name in enumerate(columns())}


class SimulatedWheel:
    """One wheel of a World. Side 0 is the left one."""

    def __init__(self, world: "World", side: int) -> None:
        self._world, self._side = world, side
        self._name = ("left", "right")[side]

    @property
    def edges(self) -> int:
        """Edges that the encoder has counted; wraps at 2**32."""
        return int(self._now("edges"))

    @property
    def speed_ticks_s(self) -> float:
        """Signed speed of the wheel in ticks. The encoder itself has no sign."""
        return self._now("ticks_s")

    @property
    def speed_m_s(self) -> float:
        """Signed speed at which the wheel rolls."""
        return self._now("ticks_s") * self._rad_per_tick * self._world.parameters[f"{self._name}.radius_m"]

    @property
    def rolled_ticks(self) -> float:
        """Signed exact distance that the wheel has rolled, which odometry estimates."""
        return self._now("rolled_ticks")

    @property
    def rolled_rad(self) -> float:
        """Signed angle by which the wheel has turned."""
        return self._now("rolled_ticks") * self._rad_per_tick

    @property
    def pwm(self) -> int:
        """PWM of the motor; 0 brakes."""
        return int(self._now("pwm"))

    def grip(self, ticks_s: float) -> None:
        """Turn the wheel by hand at this speed, or block it (0). The motor has no effect."""
        self._world.instance.call("grip", self._side, ticks_s)

    def release(self) -> None:
        """Release the wheel after `grip`."""
        self._world.instance.call("release", self._side)

    def break_driver(self) -> None:
        """Break the motor's driver: once driven, the motor runs at full speed and ignores its PWM."""
        self._world.instance.call("break_driver", self._side)

    def _now(self, name: str) -> float:
        return self._world.now(f"{self._name}_{name}")

    @property
    def _rad_per_tick(self) -> float:
        return math.tau / self._world.parameters[f"{self._name}.ticks_per_turn"]


class World:
    """The C++ World: the true position of a robot, and the disturbances of its wheels and floor."""

    def __init__(self, parameters: WorldParameters, instance: Instance) -> None:
        self.instance = instance
        self.left, self.right = self.wheels = SimulatedWheel(self, 0), SimulatedWheel(self, 1)
        self.parameters = parameters
        self._row = (ctypes.c_double * len(columns())).from_address(instance.address("row"))
        self._control = Control.from_address(instance.address("control"))
        self._turn_motors = instance.function("turn_motors")

    def now(self, name: str) -> float:
        """Return the current value of a column."""
        return float(self._row[_at()[name]])

    @property
    def row(self) -> dict[str, float]:
        """Current values by column."""
        return dict(zip(columns(), self._row, strict=True))

    @property
    def x_m(self) -> float:
        """True x coordinate."""
        return self.now("x_m")

    @property
    def y_m(self) -> float:
        """True y coordinate."""
        return self.now("y_m")

    @property
    def theta_rad(self) -> float:
        """True heading, not wrapped."""
        return self.now("theta_rad")

    @property
    def pose(self) -> Pose:
        """True pose; theta is not wrapped."""
        return Pose(*map(self.now, ("x_m", "y_m", "theta_rad")))

    @property
    def odometry(self) -> Pose:
        """Pose that the firmware has estimated."""
        return Pose(*map(self.now, ("odometry_x_m", "odometry_y_m", "odometry_theta_rad")))

    @property
    def rolled_m(self) -> float:
        """Distance that the centre of the robot has moved, forwards and backwards."""
        return self.now("rolled_m")

    def change(self, parameters: WorldParameters) -> None:
        """Replace the parameters of the world. Pose and edges stay.

        Raises:
            ValueError: a number has no such name, or is out of its range.
        """
        self.put(parameters)
        self.instance.call("change_world")

    def put(self, parameters: WorldParameters) -> None:
        """Write the numbers to the module's memory."""
        self.parameters = parameters
        values = parameters.checked_values()
        ctypes.memmove(
            self.instance.address("parameter_numbers"), struct.pack(f"<{len(values)}d", *values), 8 * len(values)
        )

    def turn_motors(self, left_pwm: int, right_pwm: int, step_s: float, steps: int) -> None:
        """Drive the motors without the firmware: PWM from -4095 to 4095; 0 brakes."""
        control = self._control
        control.left_pwm, control.right_pwm, control.step_s, control.steps = left_pwm, right_pwm, step_s, steps
        self._turn_motors(self.instance.store)

    def shove(self, forward_m: float, sideways_m: float, turned_rad: float) -> None:
        """Push the robot over the floor without turning its wheels."""
        self.instance.call("shove", forward_m, sideways_m, turned_rad)


class Firmware:
    """Firmware on a switched-on robot. `run` advances the time; `world` has the true state."""

    def __init__(
        self,
        parameters: WorldParameters | None = None,
        *,
        name: str = "robot_0",
        baud: int = 0,
        retry: Retry = Retry.KEEP_STATE,
        feedback: Feedback = Feedback.WASHED_OUT,
        kind: RobotKind = RobotKind.PAPER,
    ) -> None:
        """Switch a robot on. `baud` 0: bytes are transmitted at once; 38400 is the paper's rate.

        Raises:
            ConfigError: wasmtime is not installed, or has no library for this machine.
            ValueError: a number of the world has no such name, or is out of its range.
        """
        self._instance = Instance()
        self.world = World(WorldParameters() if parameters is None else parameters, self._instance)
        self.world.put(self.world.parameters)
        self._instance.write_text(f"/{name}/".encode())
        self._instance.call("power_on", baud, retry, feedback, int(kind is RobotKind.NIMBLE))
        self._run = self._instance.function("run")
        self._control = Control.from_address(self._instance.address("control"))
        self._from_host, self._to_host, self._rows, self._controls = map(
            self._instance.address, ("from_host", "to_host", "rows", "wheel_controls")
        )
        self._pending = bytearray()  # bytes from the host that do not fit into the module's buffer

    def send(self, data: bytes) -> None:
        """Queue bytes for the robot. `run` transmits them."""
        self._pending += data

    def run(self, ms: int, every_ms: int = 0) -> bytes:
        """Advance the time by at most MOST_ROWS ms. Return the bytes that the host received.

        `every_ms`: interval of the rows in `rows`; 0: no rows.
        """
        control = self._control
        if self._pending:
            size = min(len(self._pending), LINE_BYTES - control.from_host_size)
            ctypes.memmove(self._from_host + control.from_host_size, bytes(self._pending[:size]), size)
            control.from_host_size += size
            del self._pending[:size]
        control.ms, control.every_ms = ms, every_ms
        self._run(self._instance.store)
        return ctypes.string_at(self._to_host, control.to_host_size)

    @property
    def rows(self) -> NDArray[np.float64]:
        """Rows of the last `run`; the columns are `columns()`."""
        size = min(self._control.rows, MOST_ROWS) * len(columns())
        values = (ctypes.c_double * size).from_address(self._rows)
        return np.array(values, dtype=np.float64).reshape(-1, len(columns()))

    @property
    def is_configured(self) -> bool:
        """Whether the firmware is connected to a host."""
        return bool(self._control.is_configured)

    @property
    def quiet_ms(self) -> int:
        """Time in which the firmware sends nothing unless it receives bytes; 0 while bytes are on the line."""
        return 0 if self._pending else int(self._control.quiet_ms)

    @property
    def lost_bytes(self) -> int:
        """Number of bytes from the host that the UART dropped because its buffer was full."""
        return int(self._control.lost_bytes)

    @property
    def controls(self) -> tuple[WheelControl, WheelControl]:
        """Controls of the left and the right wheel."""
        values = list((ctypes.c_double * 8).from_address(self._controls))
        return WheelControl(*values[:4]), WheelControl(*values[4:])

    def reboot(self) -> None:
        """Switch the board off and on. The world stays."""
        self._pending.clear()
        self._instance.call("reboot")

    def cut(self) -> None:
        """Drop the bytes on the line in both directions."""
        self._pending.clear()
        self._instance.call("cut")

    def set_clock(self, rate: float) -> None:
        """Set the rate of the board's clock: its seconds per second."""
        self._instance.call("set_clock", round(rate * 1000))

    def run_script(self, text: str) -> int:
        """Run a script of firmware/host/world_script.h on a new robot. Return 0, or the number of the invalid line."""
        self._instance.write_text(text.encode())
        return int(self._instance.call("run_script"))


@dataclass(frozen=True, slots=True)
class Trace:
    """Samples of a drive, one row each; `trace["x_m"]` is a column. The columns are `columns()`:

    t_s; x_m, y_m, theta_rad: the true pose (theta not wrapped); odometry_x_m, ...: the firmware's estimate;
    left_ticks_s: the true speed; left_measured_ticks_s: the PID's input; left_set_ticks_s: its set-point; left_pwm: the
    motor's PWM (0: brakes); left_edges; left_rolled_ticks: the true signed distance; left_fault: a WheelFault of
    wheel.h; each also for the right wheel; rolled_m: by the centre, forwards and backwards; battery_v; caster_rad.
    """

    rows: NDArray[np.float64]

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Return a column by its name."""
        return self.rows[:, columns().index(name)]

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.rows)


class FirmwareWorld:
    """Firmware with a simulated host. `connect` first, then `drive` and `run`; read `world` and `trace`."""

    def __init__(
        self,
        parameters: WorldParameters | None = None,
        *,
        name: str = "robot_0",
        baud: int = 0,
        retry: Retry = Retry.KEEP_STATE,
        feedback: Feedback = Feedback.WASHED_OUT,
        kind: RobotKind = RobotKind.PAPER,
        device_parameters: Mapping[str, Sequence[float]] | None = None,
    ) -> None:
        """Switch a robot on. `baud` 0: bytes are transmitted at once; 38400 is the paper's rate.

        `device_parameters`: answers to the firmware's parameter requests, such as "wheel_radius".

        Raises:
            ConfigError: wasmtime is not installed, or has no library for this machine.
            ValueError: a number of the world has no such name, or is out of its range.
        """
        self.name = name
        self.device_parameters = dict(device_parameters or {})
        self.topics: dict[str, int] = {}  # ids by name without the robot's name
        self.frames: deque[Frame] = deque(maxlen=_FRAMES)  # the newest frames that were not requests
        self.firmware = Firmware(parameters, name=name, baud=baud, retry=retry, feedback=feedback, kind=kind)
        self.world = self.firmware.world
        self._stream = FrameStream()
        self._traces: list[NDArray[np.float64]] = []

    # -- state --------------------------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """Time since the robot was switched on."""
        return self.world.now("t_s")

    @property
    def trace(self) -> Trace:
        """All samples since the start or the last `forget`."""
        return Trace(np.concatenate(self._traces) if self._traces else np.zeros((0, len(columns()))))

    @property
    def logs(self) -> list[Log]:
        """Log lines of the firmware."""
        found = [decode_log(frame.payload) for frame in self.frames if frame.topic_id == Id.LOG]
        return [log for log in found if log is not None]

    def forget(self) -> None:
        """Drop the samples and frames that were recorded so far."""
        self._traces.clear()
        self.frames.clear()

    # -- host --------------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Negotiate the topics and answer the parameters."""
        self.send(TOPICS_REQUEST)
        self.run(CONNECT_S)

    def disconnect(self) -> None:
        """Send the stop request that hostlink sends when it ends."""
        self.send(STOP_REQUEST)

    def send(self, data: bytes) -> None:
        """Put bytes on the line to the robot."""
        self.firmware.send(data)

    def publish(self, topic: str, payload: bytes) -> None:
        """Send a message to a topic of the robot. `topic` is its name without the robot's name.

        Raises:
            KeyError: the firmware does not have the topic, or is not connected.
        """
        self.send(encode(self.topics[topic], payload))

    def command(self, linear_m_s: float, angular_rad_s: float) -> None:
        """Send one velocity.

        Raises:
            KeyError: the firmware is not connected.
        """
        self.publish("velocity_commands", struct.pack("<6d", linear_m_s, 0, 0, 0, 0, angular_rad_s))

    def drive(self, linear_m_s: float, angular_rad_s: float, seconds: float, *, sample_s: float = 0.0) -> None:
        """Command a velocity ten times a second for `seconds`. Without a zero afterwards, the watchdog stops the robot.

        Raises:
            KeyError: the firmware is not connected.
        """
        left_ms = round(seconds * 1000)
        while left_ms > 0:
            self.command(linear_m_s, angular_rad_s)
            now_ms = min(left_ms, round(COMMAND_S * 1000))
            self.run(now_ms / 1000, sample_s=sample_s)
            left_ms -= now_ms

    def run(self, seconds: float, *, sample_s: float = 0.0) -> None:
        """Advance the time in whole milliseconds. `sample_s`: interval of the rows of `trace`; 0: no rows."""
        left_ms, sample_ms = round(seconds * 1000), round(sample_s * 1000)
        while left_ms > 0:
            now_ms = min(left_ms, _ANSWER_MS)
            self._pass(now_ms, sample_ms)
            left_ms -= now_ms

    def _pass(self, ms: int, sample_ms: int) -> None:
        data = self.firmware.run(ms, sample_ms)
        if sample_ms:
            self._traces.append(self.firmware.rows)
        for item in self._stream.feed(data):
            if isinstance(item, Frame):
                self._receive(item)

    def _receive(self, frame: Frame) -> None:
        match frame.topic_id:
            case Id.TIME:
                self.send(encode(Id.TIME, encode_time(round(self.now_s * 1e9))))
            case Id.PARAMETER:
                full = decode_parameter_request(frame.payload) or ""
                values = self.device_parameters.get(full.removeprefix(f"/{self.name}/"), ())
                self.send(encode(Id.PARAMETER, encode_parameter(Parameter(floats=tuple(map(float, values))))))
            case Id.PUBLISHER | Id.SUBSCRIBER:
                self._learn(decode_topic_info(EndpointKind(frame.topic_id), frame.payload))
            case _:
                self.frames.append(frame)

    def _learn(self, info: DeviceEndpoint | None) -> None:
        if info is not None:
            self.topics[info.name.removeprefix(f"/{self.name}/")] = info.id


# -- courses ----------------------------------------------------------------------------------------------------------


class Person:
    """Simulated person with a tape measure. The reading errors depend on the seed alone."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)

    def measure(self, end: Pose) -> Pose:
        """Measure the position of `end` from a mark."""
        marked = placed(Pose(theta_rad=READING_ERROR_RAD * float(self._random.normal())), end)
        x_m, y_m = (marked[axis] + READING_ERROR_M * float(self._random.normal()) for axis in (0, 1))
        return Pose(x_m, y_m, end.theta_rad + READING_ERROR_RAD * float(self._random.normal()))


def follow(
    robot: FirmwareWorld,
    legs: Sequence[Leg],
    correction: OdometryCorrection | None = None,
) -> tuple[tuple[Pose, ...], Pose]:
    """Drive a course by odometry. Return the path by odometry, and the true end relative to the start.

    Raises:
        TimeoutError: the robot does not reach the end.
    """
    follower, start, path, shown = CourseFollower(legs), robot.world.pose, [robot.world.odometry], Pose()
    correction = OdometryCorrection() if correction is None else correction
    now_s = 0.0
    while not follower.is_done:
        if now_s > LONGEST_S or follower.is_stuck:
            raise TimeoutError(
                f"the simulated robot does not reach its goal: {follower.legs_left} legs are left after {now_s:.0f} s"
            )
        robot.drive(*follower.update(shown, now_s), COMMAND_S)
        shown = correction.advance(shown, path[-1], robot.world.odometry)
        path.append(robot.world.odometry)
        now_s += COMMAND_S
    return tuple(path), _from(start, robot.world.pose)


def _from(start: Pose, end: Pose) -> Pose:
    """Return `end` in the frame of `start`; theta is not wrapped."""
    cos, sin = math.cos(start.theta_rad), math.sin(start.theta_rad)
    dx_m, dy_m = end.x_m - start.x_m, end.y_m - start.y_m
    return Pose(dx_m * cos + dy_m * sin, dy_m * cos - dx_m * sin, end.theta_rad - start.theta_rad)
