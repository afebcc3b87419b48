"""Builds the Due's firmware for the PC and loads it, with a board whose inputs are all set by a test."""

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import IntEnum
from functools import cache
from pathlib import Path

from hostlink.core.protocol.rosserial.frame import Frame
from hostlink.core.protocol.rosserial.stream import FrameStream
from tests.support.compilers import CORE, UNDEFINED, run
from tests.support.once import once

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "firmware" / "due" / "src"
ROSSERIAL = ROOT / "firmware" / "rosserial" / "src"
LIBRARY = ROOT / "build" / "due_abi" / "libdue_abi.so"
FLAGS = [*CORE, "-ffp-contract=off"]  # the digits of a Cortex-M3 without an FPU, on every machine
OUT_BYTES = 65536

_U8P, _F, _P, _SIZE = ctypes.c_char_p, ctypes.c_float, ctypes.c_void_p, ctypes.c_size_t
_SIGNATURES = {
    "node_new": (_P, ctypes.c_int),
    "node_delete": (None, _P),
    "node_feed": (None, _P, _U8P, _SIZE),
    "node_room": (None, _P, _SIZE),
    "node_spin": (ctypes.c_uint32, _P, ctypes.c_uint64),
    "node_sent": (_SIZE, _P, _U8P, _SIZE),
    "node_heard": (_SIZE, _P, _U8P, _SIZE),
    "node_configured": (ctypes.c_int, _P),
    "node_publish": (ctypes.c_int, _P, _U8P, _SIZE),
    "node_log": (None, _P, ctypes.c_uint8, _U8P),
    "node_ask": (None, _P, _U8P),
    "node_parameter": (_SIZE, _P, ctypes.POINTER(_F), _SIZE),
    "node_dropped_from_host": (ctypes.c_uint32, _P),
    "node_dropped_to_host": (ctypes.c_uint32, _P),
    "node_refused": (ctypes.c_uint32, _P),
    "robot_new": (_P, ctypes.c_int),
    "robot_delete": (None, _P),
    "robot_feed": (None, _P, _U8P, _SIZE),
    "robot_loop": (None, _P, ctypes.c_uint64, ctypes.c_uint32, ctypes.c_uint32),
    "robot_battery": (None, _P, _F),
    "battery_input_v": (_F, ctypes.c_uint32, _F),
    "robot_sent": (_SIZE, _P, _U8P, _SIZE),
    "robot_left_pwm": (ctypes.c_int, _P),
    "robot_right_pwm": (ctypes.c_int, _P),
    "robot_pose": (None, _P, ctypes.POINTER(ctypes.c_double)),
    "errors_new": (_P,),
    "errors_delete": (None, _P),
    "errors_raise": (None, _P, ctypes.c_int, ctypes.c_uint32),
    "errors_list": (_SIZE, _P, ctypes.POINTER(ctypes.c_uint8), ctypes.c_uint32),
    "jerk_new": (_P,),
    "jerk_delete": (None, _P),
    "jerk_aim": (None, _P, _F),
    "jerk_step": (_F, _P, _F),
    "pid_new": (_P, _F, _F, _F, _F),
    "pid_delete": (None, _P),
    "pid_step": (_F, _P, _F, _F, _F),
    "wheel_new": (_P, ctypes.c_int),
    "wheel_delete": (None, _P),
    "wheel_aim": (None, _P, _F),
    "wheel_step": (_F, _P, ctypes.c_uint32, _F),
    "wheel_pwm": (ctypes.c_int, _P),
    "wheel_speed": (_F, _P),
    "wheel_set_point": (_F, _P),
    "pwm_of": (ctypes.c_int, _F),
    "drive_new": (_P, _F, _F, _F, _F, _F),
    "drive_delete": (None, _P),
    "drive_wheel_speeds": (None, _P, _F, _F, ctypes.POINTER(_F)),
    "drive_integrate": (None, _P, ctypes.POINTER(ctypes.c_double), _F, _F),
    "from_float64": (_F, _U8P),
    "to_float64": (None, _U8P, _F),
}


class Retry(IntEnum):
    """The policies of NodeHandle, by their numbers in ros/node.h."""

    NONE = 0
    PAPER = 1
    KEEP_STATE = 2


@cache
def library() -> ctypes.CDLL:
    """Compile with every warning and undefined behaviour as an error, and load."""
    once("due_abi", _compile, LIBRARY)
    loaded = ctypes.CDLL(str(LIBRARY))
    for name, (result, *arguments) in _SIGNATURES.items():
        function = getattr(loaded, name)
        function.restype, function.argtypes = result, arguments
    return loaded


def _compile() -> None:
    LIBRARY.parent.mkdir(parents=True, exist_ok=True)
    objects = []
    for source in sorted([*SOURCES.glob("*.cpp"), *ROSSERIAL.glob("ros/*.cpp")]):
        objects.append(LIBRARY.parent / f"{source.stem}.o")
        run(["g++", *FLAGS, *UNDEFINED, "-I", ROSSERIAL, "-O1", "-g", "-fPIC", "-c", source, "-o", objects[-1]])
    abi = ROOT / "firmware" / "tests" / "due_abi.cpp"
    options = ["-std=c++17", *UNDEFINED, "-I", ROSSERIAL, "-O1", "-g", "-fPIC", "-shared"]
    run(["g++", *options, abi, *objects, "-o", LIBRARY])


def _read_out(read: Callable[[int, object, int], int], handle: int) -> bytes:
    out = ctypes.create_string_buffer(OUT_BYTES)
    size = read(handle, out, OUT_BYTES)
    return out.raw[:size]


class Node:
    """A node that publishes /odometry (id 125) and takes /velocity (100, 48 bytes) and /led (101, 1 byte)."""

    def __init__(self, handle: int) -> None:
        self._handle = handle

    def feed(self, data: bytes) -> None:
        library().node_feed(self._handle, data, len(data))

    def room(self, size: int) -> None:
        library().node_room(self._handle, size)

    def spin(self, now_s: float) -> float | None:
        """Like OriginalDevice.spin: None when the turn is done, otherwise the seconds to wait."""
        wait_ms = library().node_spin(self._handle, round(now_s * 1e6))
        return wait_ms / 1000 if wait_ms else None

    def sent(self) -> bytes:
        return _read_out(library().node_sent, self._handle)

    def received(self) -> list[bytes]:
        data = _read_out(library().node_heard, self._handle)
        out_of: list[bytes] = []
        while data:
            size = int.from_bytes(data[:2], "little")
            out_of.append(data[2 : 2 + size])
            data = data[2 + size :]
        return out_of

    @property
    def is_configured(self) -> bool:
        return bool(library().node_configured(self._handle))

    def publish(self, payload: bytes) -> bool:
        """Publish a message on /odometry."""
        return bool(library().node_publish(self._handle, payload, len(payload)))

    def log(self, level: int, text: str) -> None:
        library().node_log(self._handle, level, text.encode())

    def request_parameter(self, name: str) -> None:
        library().node_ask(self._handle, name.encode())

    def parameter(self) -> list[float]:
        values = (ctypes.c_float * 16)()
        count = library().node_parameter(self._handle, values, len(values))
        return list(values)[:count]

    @property
    def dropped_from_host(self) -> int:
        return int(library().node_dropped_from_host(self._handle))

    @property
    def dropped_to_host(self) -> int:
        return int(library().node_dropped_to_host(self._handle))

    @property
    def refused(self) -> int:
        return int(library().node_refused(self._handle))


class Robot:
    """The whole firmware on a board without hardware."""

    def __init__(self, handle: int) -> None:
        self._handle = handle

    def feed(self, data: bytes) -> None:
        library().robot_feed(self._handle, data, len(data))

    def loop(self, now_s: float, left_edges: int, right_edges: int) -> None:
        library().robot_loop(self._handle, round(now_s * 1e6), left_edges % 2**32, right_edges % 2**32)

    def set_battery(self, volts: float) -> None:
        """Voltage that the board measures; NaN: not measured."""
        library().robot_battery(self._handle, volts)

    def sent(self) -> list[Frame]:
        data = _read_out(library().robot_sent, self._handle)
        return [item for item in FrameStream().feed(data) if isinstance(item, Frame)]

    @property
    def pwm(self) -> tuple[int, int]:
        return library().robot_left_pwm(self._handle), library().robot_right_pwm(self._handle)

    @property
    def pose(self) -> tuple[float, float, float]:
        values = (ctypes.c_double * 3)()
        library().robot_pose(self._handle, values)
        return values[0], values[1], values[2]


@contextmanager
def made(kind: str, *arguments: float) -> Iterator[int]:
    """A C++ object with its handle, for the length of the block."""
    handle = getattr(library(), f"{kind}_new")(*arguments)
    try:
        yield handle
    finally:
        getattr(library(), f"{kind}_delete")(handle)


@contextmanager
def node(retry: Retry = Retry.KEEP_STATE) -> Iterator[Node]:
    """A node for the length of the block."""
    with made("node", retry) as handle:
        yield Node(handle)


@contextmanager
def robot(retry: Retry = Retry.KEEP_STATE) -> Iterator[Robot]:
    """A robot for the length of the block."""
    with made("robot", retry) as handle:
        yield Robot(handle)
