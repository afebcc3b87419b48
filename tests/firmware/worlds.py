"""The Due's whole program in a world that a test draws: its board, a shield, two motors, a caster, a floor."""

import ctypes
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from functools import cache

import numpy as np
from hypothesis import strategies as st

from hostlink.core.protocol.rosserial.control import decode_log
from hostlink.core.protocol.rosserial.frame import TOPICS_REQUEST, Frame, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.workbench.sim.firmware_module import WorldParameters, wheel
from tests.firmware.due import FLAGS, LIBRARY, OUT_BYTES, ROOT, ROSSERIAL
from tests.support.compilers import UNDEFINED, run
from tests.support.once import once

FIRMWARE = ROOT / "firmware"
WORLD = ("world", "world_parameters", "drive_train", "caster", "random_numbers")
SOURCES = [
    *sorted((FIRMWARE / "due" / "src").glob("*.cpp")),
    *sorted(ROSSERIAL.glob("ros/*.cpp")),
    FIRMWARE / "due" / "src" / "board" / "due_board.cpp",
    *(FIRMWARE / "host" / f"{name}.cpp" for name in WORLD),
]
WORLD_LIBRARY = LIBRARY.parent.parent / "due_world" / "libdue_world.so"
SHIM = FIRMWARE / "host" / "due_arduino"
QUIET_S = 2.1  # the board ignores its host for the first two seconds
COMMAND_S = 0.1
LEFT, RIGHT = 0, 1
SEPARATION_M = 0.210
METRES_PER_TICK = 2 * np.pi * 0.045 / 230.4
FULL_TICKS_S = 280.0
FULL_PWM = 4095
_COLUMNS = 15
_P, _SIZE = ctypes.c_void_p, ctypes.c_size_t


def _compile() -> None:
    folder = WORLD_LIBRARY.parent
    folder.mkdir(parents=True, exist_ok=True)
    objects = []
    for source in SOURCES:
        objects.append(folder / f"{source.stem}.o")
        options = [*FLAGS, *UNDEFINED, "-O1", "-g", "-fPIC", "-DARDUINO_ARCH_SAM", f"-I{SHIM}", f"-I{ROSSERIAL}"]
        run(["g++", *options, "-c", source, "-o", objects[-1]])
    own = [FIRMWARE / "tests" / "due_world.cpp", SHIM / "pins.cpp"]
    options = ["-std=c++17", *UNDEFINED, "-O1", "-g", "-fPIC", "-shared", f"-I{SHIM}", f"-I{ROSSERIAL}"]
    run(["g++", *options, *own, *objects, "-o", WORLD_LIBRARY])


@cache
def library() -> ctypes.CDLL:
    """Compile the program with its board, as for the Due, and load."""
    once("due_world", _compile, WORLD_LIBRARY)
    loaded = ctypes.CDLL(str(WORLD_LIBRARY))
    signatures = {
        "world_new": (_P, ctypes.POINTER(ctypes.c_double), ctypes.c_uint32, ctypes.c_uint32),
        "world_hang": (None, _P, ctypes.c_uint32),
        "world_restarts": (ctypes.c_uint32, _P),
        "world_delete": (None, _P),
        "world_grip": (None, _P, ctypes.c_int, ctypes.c_double),
        "world_release": (None, _P, ctypes.c_int),
        "world_deafen": (None, _P, ctypes.c_int, ctypes.c_int),
        "world_stick": (None, _P, ctypes.c_int, ctypes.c_int),
        "world_feed": (None, _P, ctypes.c_char_p, _SIZE),
        "world_run": (_SIZE, _P, ctypes.c_uint32, ctypes.POINTER(ctypes.c_double), _SIZE),
        "world_sent": (_SIZE, _P, ctypes.c_char_p, _SIZE),
        "world_writes": (_SIZE, _P, ctypes.POINTER(ctypes.c_uint16), _SIZE),
        "world_pin": (ctypes.c_int, _P, ctypes.c_uint32),
        "world_resolution_bits": (ctypes.c_int, _P),
    }
    for name, (result, *arguments) in signatures.items():
        function = getattr(loaded, name)
        function.restype, function.argtypes = result, arguments
    return loaded


def _run(*command: object) -> None:
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@dataclass(frozen=True)
class Trace:
    """The recorded drive, one row every ten milliseconds: an array for each column."""

    t_s: np.ndarray
    left: np.ndarray  # true speeds of the wheels, ticks/s
    right: np.ndarray
    left_set: np.ndarray  # their set-points
    right_set: np.ndarray
    x_m: np.ndarray  # the true pose
    y_m: np.ndarray
    theta_rad: np.ndarray
    odom_x_m: np.ndarray  # the firmware's pose
    odom_y_m: np.ndarray
    odom_theta_rad: np.ndarray
    left_drive: np.ndarray  # the duty of its motor, with the sign of the direction; 0 while it brakes
    right_drive: np.ndarray
    left_rolled: np.ndarray  # true distance of the wheels, in ticks of their encoders
    right_rolled: np.ndarray

    def since(self, row: int) -> "Trace":
        """Rows from this one on."""
        return Trace(*(getattr(self, item.name)[row:] for item in fields(self)))

    def rolled(self) -> tuple[np.ndarray, np.ndarray]:
        """Distance of the wheels by the odometry, in ticks."""
        theta_rad = np.unwrap(self.odom_theta_rad)
        turned_rad = np.diff(theta_rad, prepend=theta_rad[0])
        heading_rad = theta_rad - turned_rad / 2
        x_m, y_m = np.diff(self.odom_x_m, prepend=0.0), np.diff(self.odom_y_m, prepend=0.0)
        step_m = x_m * np.cos(heading_rad) + y_m * np.sin(heading_rad)
        step_m[0] = 0.0
        forward, turning = np.cumsum(step_m), np.cumsum(turned_rad) * SEPARATION_M / 2
        return (forward - turning) / METRES_PER_TICK, (forward + turning) / METRES_PER_TICK


@dataclass
class World:
    """A driven robot: a command is sent ten times a second, with the time."""

    handle: int
    rows: list[np.ndarray] = field(default_factory=list)
    commanded: list[np.ndarray] = field(default_factory=list)  # one row for each row of `rows`: left and right, ticks/s
    command: tuple[float, float] = (0.0, 0.0)
    frames: list[Frame] = field(default_factory=list)
    stream: FrameStream = field(default_factory=FrameStream)

    def feed(self, data: bytes) -> None:
        library().world_feed(self.handle, data, len(data))

    def run(self, seconds: float) -> None:
        ms = round(seconds * 1000)
        out = np.zeros((ms // 10 + 1, _COLUMNS))
        count = library().world_run(self.handle, ms, out.ctypes.data_as(ctypes.POINTER(ctypes.c_double)), len(out))
        self.rows.append(out[:count])
        self.commanded.append(np.tile(wheel_speeds(*self.command), (count, 1)))
        data = ctypes.create_string_buffer(OUT_BYTES)
        size = library().world_sent(self.handle, data, OUT_BYTES)
        self.frames += [item for item in self.stream.feed(data.raw[:size]) if isinstance(item, Frame)]

    def drive(self, linear: float, angular: float, seconds: float) -> None:
        left_s, self.command = seconds, (linear, angular)
        while left_s > 1e-9:
            self.feed(encode(100, struct.pack("<6d", linear, 0, 0, 0, 0, angular)) + encode(Id.TIME, bytes(8)))
            self.run(min(COMMAND_S, left_s))
            left_s -= COMMAND_S

    def hang(self, seconds: float) -> None:
        """The program blocks for this time, like a delay() in its loop."""
        library().world_hang(self.handle, round(seconds * 1000))

    @property
    def restarts(self) -> int:
        """Number of restarts that the board's watchdog would have caused."""
        return int(library().world_restarts(self.handle))

    def grip(self, side: int, ticks_s: float) -> None:
        library().world_grip(self.handle, side, ticks_s)

    def release(self, side: int) -> None:
        library().world_release(self.handle, side)

    def deafen(self, side: int, *, is_so: bool = True) -> None:
        """Set the encoder of a wheel dead."""
        library().world_deafen(self.handle, side, is_so)

    def stick(self, side: int, *, is_so: bool = True) -> None:
        """Break the driver of a motor: it runs at full speed, independent of the pins."""
        library().world_stick(self.handle, side, is_so)

    @property
    def resolution_bits(self) -> int:
        """Resolution of the duties that the board writes."""
        return int(library().world_resolution_bits(self.handle))

    def pin(self, pin: int) -> int:
        return int(library().world_pin(self.handle, pin))

    def writes(self) -> list[tuple[int, int]]:
        """Writes to pins since the last call: (pin, level or duty)."""
        out = (ctypes.c_uint16 * 8192)()
        count = library().world_writes(self.handle, out, 4096)
        return [(out[2 * i], out[2 * i + 1]) for i in range(count)]

    @property
    def trace(self) -> Trace:
        return Trace(*np.concatenate(self.rows).T)

    @property
    def errors(self) -> list[str]:
        """Lines of the device's log that are errors."""
        logs = [decode_log(frame.payload) for frame in self.frames if frame.topic_id == Id.LOG]
        return [log.text for log in logs if log is not None and log.level == 3]


def wheel_speeds(linear: float, angular: float) -> tuple[float, float]:
    """Wheel speeds of a command, in ticks/s: both reduced if one of them cannot follow."""
    turning = angular * SEPARATION_M / 2
    left, right = (linear - turning) / METRES_PER_TICK, (linear + turning) / METRES_PER_TICK
    factor = min(1.0, FULL_TICKS_S / max(abs(left), abs(right), 1e-9))
    return left * factor, right * factor


@contextmanager
def world(parameters: WorldParameters | None = None, *, setup_s: float = 0.0, reset_type: int = 0) -> Iterator[World]:
    """A robot that has just received its topics, for the length of the block; its setup() lasts `setup_s`.

    `reset_type`: why its processor started, RSTTYP of the SAM3X; 2 is the watchdog.
    """
    numbers = (WorldParameters() if parameters is None else parameters).checked_values()
    values = (ctypes.c_double * len(numbers))(*numbers)
    handle = library().world_new(values, round(setup_s * 1000), reset_type)
    try:
        made = World(handle)
        made.run(QUIET_S)
        made.feed(TOPICS_REQUEST)
        made.run(0.2)
        yield made
    finally:
        library().world_delete(handle)


@st.composite
def worlds(draw: st.DrawFn) -> WorldParameters:
    """A drawn world for which the firmware was not tuned: two motors of one make, each with its own gain and wheel."""
    dead_zone_pwm = draw(st.floats(0.0, 800.0))
    time_constant_s = draw(st.floats(0.02, 0.2))
    has_jump = float(draw(st.booleans()))
    friction = draw(st.floats(0.0, 1.0)) * dead_zone_pwm / FULL_PWM
    coast_constant_s = draw(st.floats(max(0.05, time_constant_s), 1.0))

    full_speed_rad_s = WorldParameters()["left.full_speed_rad_s"]

    def draw_wheel(side: str) -> dict[str, float]:
        return wheel(
            side,
            full_speed_rad_s=draw(st.floats(0.9, 1.1)) * full_speed_rad_s,
            dead_zone_pwm=dead_zone_pwm,
            has_jump=has_jump,
            rise_constant_s=time_constant_s,
            coast_constant_s=coast_constant_s,
            brake_constant_s=time_constant_s,  # the same motor against the same resistance, without a voltage
            friction_rad_s=friction * full_speed_rad_s,
            radius_m=draw(st.floats(0.044, 0.046)),
            slip_noise_m=draw(st.sampled_from([0.0, 0.003])),
        )

    return WorldParameters(
        {
            "seed": draw(st.integers(0, 2**32 - 1)),
            "track_m": draw(st.floats(0.2, 0.22)),
            "caster_pwm": draw(st.sampled_from([0.0, 100.0, 300.0])),
            "caster_twist_rad": draw(st.sampled_from([0.0, 0.055])),
            "caster_random": 0.4,
            "floor_pwm": draw(st.sampled_from([0.0, 0.0, 200.0])),
            "battery_v": draw(st.floats(10.5, 13.0)),
            "battery_sag_v": draw(st.floats(0.0, 1.0)),
            **draw_wheel("left"),
            **draw_wheel("right"),
        }
    )
