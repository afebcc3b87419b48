"""The shared library of the C++ world and of the firmware in it: where it is, how it is loaded, and NativeWorld."""

import ctypes
import weakref
from functools import cache
from pathlib import Path

from hostlink.sim.rolling import Rolling
from hostlink.sim.world_parameters import WheelParameters, WorldParameters, names

# Built from the sources beside the package, by `make world`; an installed hostlink has neither.
LIBRARY = Path(__file__).resolve().parents[2] / "build" / "firmware" / "native" / "libfirmware_world.so"
_FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
_PARTS = ("world*", "firmware_world", "robot_in_world", "drive_train", "caster", "random_numbers", "uart_*")
VERSION = 2  # of the C interface

_P, _I, _SIZE, _D = ctypes.c_void_p, ctypes.c_int, ctypes.c_size_t, ctypes.c_double
_U32, _DOUBLES = ctypes.c_uint32, ctypes.POINTER(ctypes.c_double)
_SIGNATURES = {
    "world_parameters_count": (_SIZE,),
    "world_parameters_name": (ctypes.c_char_p, _SIZE),
    "world_parameters_defaults": (None, _DOUBLES),
    "world_parameters_read": (_U32, ctypes.c_char_p, _DOUBLES),
    "firmware_world_new": (_P, _DOUBLES, _U32, ctypes.c_char_p, _I, _I),
    "firmware_world_delete": (None, _P),
    "firmware_world_world": (_P, _P),
    "firmware_world_columns": (_SIZE,),
    "firmware_world_column": (ctypes.c_char_p, _SIZE),
    "firmware_world_send": (None, _P, ctypes.c_char_p, _SIZE),
    "firmware_world_receive": (_SIZE, _P, ctypes.c_char_p, _SIZE),
    "firmware_world_row": (None, _P, _DOUBLES),
    "firmware_world_run": (_SIZE, _P, _U32, _U32, _DOUBLES, _SIZE),
    "firmware_world_lost_bytes": (_U32, _P),
    "firmware_world_script": (_U32, ctypes.c_char_p, _DOUBLES, ctypes.POINTER(_SIZE)),
    "world_new": (_P, _DOUBLES),
    "world_delete": (None, _P),
    "world_be": (None, _P, _DOUBLES),
    "world_drive": (None, _P, ctypes.c_int16, ctypes.c_int16),
    "world_step": (None, _P, _D),
    "world_state": (None, _P, _DOUBLES),
    "world_edges": (_U32, _P, _I),
    "world_shove": (None, _P, _D, _D, _D),
    "world_grip": (None, _P, _I, _D),
    "world_release": (None, _P, _I),
    "world_deafen": (None, _P, _I, _I),
    "world_break_driver": (None, _P, _I),
}
_STATE = 10  # numbers of world_state


class WorldLibraryMissing(RuntimeError):
    """The library is not built, or of another version; the text says what to do."""


@cache
def load_library(path: Path = LIBRARY) -> ctypes.CDLL:
    """Load the library.

    Raises:
        WorldLibraryMissing: it is not built, or not from these sources.
    """
    if not path.exists():
        raise WorldLibraryMissing(f"{path} is not built: run  make world  in hostlink's sources")
    if any(source.stat().st_mtime > path.stat().st_mtime for source in _sources()):
        raise WorldLibraryMissing(f"{path} is older than its sources: run  make world")
    try:
        loaded = ctypes.CDLL(str(path))
    except OSError as error:
        raise WorldLibraryMissing(f"{path} cannot be loaded: {error}: run  make world") from None
    if not hasattr(loaded, "firmware_world_version") or loaded.firmware_world_version() != VERSION:
        raise WorldLibraryMissing(f"{path} is of another version: run  make world")
    for name, (result, *arguments) in _SIGNATURES.items():
        function = getattr(loaded, name)
        function.restype, function.argtypes = result, arguments
    known = [loaded.world_parameters_name(i).decode() for i in range(loaded.world_parameters_count())]
    if known != names():
        raise WorldLibraryMissing(f"{path} has other parameters: run  make world")
    return loaded


def _sources() -> list[Path]:
    """Of the library; none where hostlink is installed without them."""
    firmware = [path for suffix in ("h", "cpp") for path in (_FIRMWARE / "due" / "src").glob(f"*.{suffix}")]
    firmware += (_FIRMWARE / "rosserial" / "src" / "ros").iterdir()
    own = [path for name in _PARTS for path in (_FIRMWARE / "host").glob(f"{name}.*")]
    return firmware + own


def array_of(parameters: WorldParameters) -> ctypes.Array[ctypes.c_double]:
    """The parameters as the C interface reads them."""
    values = parameters.values()
    return (ctypes.c_double * len(values))(*values)


class NativeWheel(Rolling):
    """One wheel of a NativeWorld, with the names of DriveTrain."""

    def __init__(self, world: "NativeWorld", side: int) -> None:
        self._world = world
        self._side = side

    @property
    def wheel(self) -> WheelParameters:
        """Its numbers."""
        return self._world.parameters.right if self._side else self._world.parameters.left

    @property
    def edges(self) -> int:
        """What its encoder has counted."""
        return int(self._world.library.world_edges(self._world.handle, self._side))

    @property
    def speed_rad_s(self) -> float:
        """How fast it turns, signed."""
        return self._world.state[6 + 2 * self._side]

    @property
    def rolled_rad(self) -> float:
        """How far it has turned, signed."""
        return self._world.state[7 + 2 * self._side]

    def grip(self, ticks_s: float) -> None:
        """Somebody turns the wheel by hand, at this speed, or blocks it (0), whatever the motor does."""
        self._world.library.world_grip(self._world.handle, self._side, ticks_s)

    def release(self) -> None:
        """The hand lets it go."""
        self._world.library.world_release(self._world.handle, self._side)

    def deafen(self, *, is_so: bool = True) -> None:
        """Its encoder is dead."""
        self._world.library.world_deafen(self._world.handle, self._side, is_so)

    def break_driver(self) -> None:
        """The motor runs on at full speed once it was driven, whatever it is given then."""
        self._world.library.world_break_driver(self._world.handle, self._side)


class NativeWorld:
    """The C++ World, with the names of hostlink.sim.world.World."""

    def __init__(
        self, parameters: WorldParameters | None = None, *, handle: int | None = None, owner: object = None
    ) -> None:
        """`handle`: of a world that is a part of its `owner`, which deletes it.

        Raises:
            WorldLibraryMissing: the library is not built, or not from these sources.
        """
        self.library = load_library()
        self.parameters = WorldParameters() if parameters is None else parameters
        if handle is None:
            handle = self.library.world_new(array_of(self.parameters))
            weakref.finalize(self, self.library.world_delete, handle)
        self.handle = handle
        self._owner = owner  # lives as long as this
        self.left = NativeWheel(self, 0)
        self.right = NativeWheel(self, 1)

    def be(self, parameters: WorldParameters) -> None:
        """Another world from now on; pose and edges stay."""
        self.parameters = parameters
        self.library.world_be(self.handle, array_of(parameters))

    @property
    def state(self) -> list[float]:
        """x, y, theta, rolled, battery, caster; then speed and way of each wheel."""
        values = (ctypes.c_double * _STATE)()
        self.library.world_state(self.handle, values)
        return list(values)

    @property
    def x_m(self) -> float:
        """Where the robot truly is."""
        return self.state[0]

    @property
    def y_m(self) -> float:
        """Where the robot truly is."""
        return self.state[1]

    @property
    def theta_rad(self) -> float:
        """Which way it truly points; whole turns stay in it."""
        return self.state[2]

    @property
    def rolled_m(self) -> float:
        """How far its middle has moved, forwards and backwards."""
        return self.state[3]

    @property
    def battery_v(self) -> float:
        """At the motors, now."""
        return self.state[4]

    @property
    def caster_rad(self) -> float:
        """Where the caster's wheel rolls to, in the robot's frame; 0: forwards."""
        return self.state[5]

    def drive(self, left_pwm: int, right_pwm: int) -> None:
        """What the motors are given until the next call: -4095..4095, 0 brakes."""
        self.library.world_drive(self.handle, left_pwm, right_pwm)

    def step(self, dt_s: float) -> None:
        """Let time pass."""
        self.library.world_step(self.handle, dt_s)

    def shove(self, forward_m: float, sideways_m: float, turned_rad: float) -> None:
        """The robot is pushed over the floor: neither wheel nor encoder notices."""
        self.library.world_shove(self.handle, forward_m, sideways_m, turned_rad)
