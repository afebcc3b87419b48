"""FirmwareWorld: the Due's real firmware in a world, in virtual time: a minute of the robot takes milliseconds. Pure.

It is the host's end of the robot's UART, too: it requests the topics, answers time and parameters, and drives. One
object is one robot; use it from one thread, and as many of them as you like.
"""

import ctypes
import struct
import weakref
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hostlink.protocol.control import (
    Log,
    Parameter,
    TopicInfo,
    decode_log,
    decode_parameter_request,
    decode_topic_info,
    encode_parameter,
    encode_time,
)
from hostlink.protocol.frame import STOP_REQUEST, TOPICS_REQUEST, Frame, Id, encode
from hostlink.protocol.stream import FrameStream
from hostlink.robot.kinematics import Pose
from hostlink.sim.controller import Feedback
from hostlink.sim.world_library import NativeWorld, array_of, load_library
from hostlink.sim.world_parameters import WorldParameters

COMMAND_S = 0.1  # between two velocities; the firmware stops after 0.5 s without one
CONNECT_S = 2.0  # for topics and parameters: at 38400 baud they need half of it
_ANSWER_MS = 100  # how often the robot's questions are answered
_RECEIVE_BYTES = 1 << 16
_FRAMES = 100_000  # an hour of them


class Retry(IntEnum):
    """What the firmware does with a frame that has not come whole; the policies of node_handle.h."""

    NONE = 0
    PAPER = 1
    KEEP_STATE = 2


@cache
def columns() -> tuple[str, ...]:
    """The names of what a Trace has, in the order of its rows.

    Raises:
        WorldLibraryMissing: the library is not built, or not from these sources.
    """
    library = load_library()
    return tuple(library.firmware_world_column(i).decode() for i in range(library.firmware_world_columns()))


@dataclass(frozen=True, slots=True)
class Trace:
    """What was, a row each sample; `trace["x_m"]` is a column. The columns are `columns()`:

    t_s; x_m, y_m, theta_rad: the truth (theta not wrapped); odometry_x_m, ...: what the firmware believes;
    left_ticks_s: the true speed; left_measured_ticks_s: what the PID uses; left_set_ticks_s: its set-point;
    left_pwm: what the motor is given (0: brakes); left_edges; left_rolled_ticks: signed, the truth;
    left_fault: a WheelFault of wheel.h; the same right; rolled_m: by the middle, forwards and backwards; battery_v;
    caster_rad.
    """

    rows: NDArray[np.float64]

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """A column."""
        return self.rows[:, columns().index(name)]

    def __len__(self) -> int:
        """How many samples it has."""
        return len(self.rows)


class FirmwareWorld:
    """A robot that is driven; `connect` first, then `drive`, `run`, and read `pose`, `odometry`, `trace`."""

    def __init__(
        self,
        parameters: WorldParameters | None = None,
        *,
        name: str = "robot_0",
        baud: int = 0,
        retry: Retry = Retry.KEEP_STATE,
        feedback: Feedback = Feedback.WASHED_OUT,
        device_parameters: Mapping[str, Sequence[float]] | None = None,
    ) -> None:
        """`baud` 0: bytes are through at once; 38400 as the paper's. `device_parameters`: "wheel_radius" and so on.

        Raises:
            WorldLibraryMissing: the library is not built, or not from these sources.
        """
        self.parameters = WorldParameters() if parameters is None else parameters
        self.name = name
        self.device_parameters = dict(device_parameters or {})
        self.topics: dict[str, int] = {}  # name without the robot's: id
        self.frames: deque[Frame] = deque(maxlen=_FRAMES)  # what the firmware sent and was no question; the newest
        self._library = load_library()
        self._handle = self._library.firmware_world_new(
            array_of(self.parameters), baud, f"/{name}/".encode(), retry, feedback.value
        )
        weakref.finalize(self, self._library.firmware_world_delete, self._handle)
        self.world = NativeWorld(self.parameters, handle=self._library.firmware_world_world(self._handle), owner=self)
        self._stream = FrameStream()
        self._received = ctypes.create_string_buffer(_RECEIVE_BYTES)
        self._traces: list[NDArray[np.float64]] = []

    # -- where it is --------------------------------------------------------------------------------------------------

    @property
    def row(self) -> dict[str, float]:
        """What is now, by column."""
        values = (ctypes.c_double * len(columns()))()
        self._library.firmware_world_row(self._handle, values)
        return dict(zip(columns(), values, strict=True))

    @property
    def now_s(self) -> float:
        """The robot's time since its power-up."""
        return self.row["t_s"]

    @property
    def pose(self) -> Pose:
        """Where the robot truly is; theta is not wrapped."""
        return Pose(self.world.x_m, self.world.y_m, self.world.theta_rad)

    @property
    def odometry(self) -> Pose:
        """Where the firmware believes that it is."""
        row = self.row
        return Pose(row["odometry_x_m"], row["odometry_y_m"], row["odometry_theta_rad"])

    @property
    def trace(self) -> Trace:
        """All samples since the start, or since `forget`."""
        return Trace(np.concatenate(self._traces) if self._traces else np.zeros((0, len(columns()))))

    @property
    def logs(self) -> list[Log]:
        """What the firmware has logged."""
        found = [decode_log(frame.payload) for frame in self.frames if frame.topic_id == Id.LOG]
        return [log for log in found if log is not None]

    @property
    def lost_bytes(self) -> int:
        """Bytes from the host that its UART had no room for."""
        return int(self._library.firmware_world_lost_bytes(self._handle))

    def forget(self) -> None:
        """Drop the samples and frames so far."""
        self._traces.clear()
        self.frames.clear()

    # -- its host -----------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Negotiate the topics and answer the parameters."""
        self.send(TOPICS_REQUEST)
        self.run(CONNECT_S)

    def disconnect(self) -> None:
        """The host stops, as hostlink does at its end."""
        self.send(STOP_REQUEST)

    def send(self, data: bytes) -> None:
        """Put bytes on the line to the robot."""
        self._library.firmware_world_send(self._handle, data, len(data))

    def publish(self, topic: str, payload: bytes) -> None:
        """Send one message to a topic of the robot, by its name without the robot's.

        Raises:
            KeyError: the firmware has no such topic, or is not connected.
        """
        self.send(encode(self.topics[topic], payload))

    def command(self, linear_m_s: float, angular_rad_s: float) -> None:
        """Send one velocity.

        Raises:
            KeyError: the firmware is not connected.
        """
        self.publish("velocity_commands", struct.pack("<6d", linear_m_s, 0, 0, 0, 0, angular_rad_s))

    def drive(self, linear_m_s: float, angular_rad_s: float, seconds: float, *, sample_s: float = 0.0) -> None:
        """Command a velocity ten times a second for so long. Afterwards drive zero, or the watchdog stops it.

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
        """Let time pass, in whole milliseconds; each multiple of `sample_s` gives `trace` a row, 0 none."""
        left_ms, sample_ms = round(seconds * 1000), round(sample_s * 1000)
        while left_ms > 0:
            now_ms = min(left_ms, _ANSWER_MS)
            self._pass(now_ms, sample_ms)
            left_ms -= now_ms

    def _pass(self, ms: int, sample_ms: int) -> None:
        most = ms // sample_ms + 1 if sample_ms else 0
        rows = np.zeros((most, len(columns())))
        pointer = rows.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
        count = self._library.firmware_world_run(self._handle, ms, sample_ms, pointer, most)
        if count:
            self._traces.append(rows[:count])
        size = self._library.firmware_world_receive(self._handle, self._received, _RECEIVE_BYTES)
        for item in self._stream.feed(ctypes.string_at(self._received, size)):
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
                self._learn(decode_topic_info(Id(frame.topic_id), frame.payload))
            case _:
                self.frames.append(frame)

    def _learn(self, info: TopicInfo | None) -> None:
        if info is not None:
            self.topics[info.name.removeprefix(f"/{self.name}/")] = info.topic_id
