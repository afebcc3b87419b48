"""The module firmware.wasm: the Due's firmware in its world, compiled by `make world`; and the numbers of that world.

The source is firmware/host/firmware_module.cpp; wasmtime executes it. Each instance is one robot with its own memory.
Use an instance from one thread only.
"""

import atexit
import contextlib
import ctypes
import platform
import re
import weakref
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Self

from hostlink.errors import ConfigError, LibraryMissing

# -- module -----------------------------------------------------------------------------------------------------------

if TYPE_CHECKING:
    import wasmtime

MODULE = Path(__file__).with_name("firmware.wasm")
TEXT_BYTES = LINE_BYTES = 1 << 16  # size of each buffer
MOST_ROWS = 1 << 13
MACHINES = ("x86_64", "AMD64", "aarch64", "arm64")  # with a library of wasmtime


class ParameterRange(NamedTuple):
    """Default and range of one number of a world."""

    default: float
    least: float
    most: float


class Control(ctypes.Structure):
    """`Control` of firmware_module.cpp."""

    _fields_ = (
        ("step_s", ctypes.c_double),
        ("left_pwm", ctypes.c_int32),
        ("right_pwm", ctypes.c_int32),
        ("steps", ctypes.c_uint32),
        ("ms", ctypes.c_uint32),
        ("every_ms", ctypes.c_uint32),
        ("from_host_size", ctypes.c_uint32),
        ("to_host_size", ctypes.c_uint32),
        ("rows", ctypes.c_uint32),
        ("is_configured", ctypes.c_uint32),
        ("lost_bytes", ctypes.c_uint32),
        ("quiet_ms", ctypes.c_uint32),
    )


class Instance:
    """Instance of the module with its own memory, which never grows, so that addresses in it stay valid."""

    def __init__(self) -> None:
        import wasmtime  # noqa: PLC0415 - an extra, which `_compiled` reports where it is missing

        engine, module = _compiled()
        self.store = wasmtime.Store(engine)
        weakref.finalize(self, self.store.close)  # also when the interpreter ends: the store cannot be closed later
        self._exports = wasmtime.Instance(self.store, module, []).exports(self.store)
        self.call("_initialize")
        memory = self._exports["memory"]
        assert isinstance(memory, wasmtime.Memory)  # noqa: S101 - for the type
        self._base = ctypes.addressof(memory.data_ptr(self.store).contents)

    def function(self, name: str) -> "wasmtime.Func":
        """Return an exported function of the module."""
        return self._exports[name]  # type: ignore[return-value]

    def call(self, name: str, *arguments: float) -> int | float:
        """Call an exported function. Return 0 if it returns nothing."""
        return self.function(name)(self.store, *arguments) or 0

    def address(self, name: str) -> int:
        """Address of a buffer; `name` is the exported function that returns it."""
        return self._base + int(self.call(name))

    def read_text(self, name: str, index: int) -> str:
        """Read the text that an exported function returns as char*."""
        return ctypes.string_at(self._base + int(self.call(name, index))).decode()

    def write_text(self, text: bytes) -> None:
        """Write a text into the module's text().

        Raises:
            ValueError: the text is longer than TEXT_BYTES.
        """
        if len(text) >= TEXT_BYTES:
            raise ValueError(f"a text of {len(text)} bytes, the firmware takes {TEXT_BYTES - 1}")
        ctypes.memmove(self.address("text"), text + b"\0", len(text) + 1)

    def read_parameters(self, text: str) -> tuple[int, list[float]]:
        """Parse lines name=value. Return the number of the first invalid line, or 0, and all numbers of the world."""
        self.write_text(text.encode())
        wrong, count = int(self.call("read_parameters")), int(self.call("parameter_count"))
        return wrong, list((ctypes.c_double * count).from_address(self.address("parameter_numbers")))


def require_wasmtime(command: str) -> None:
    """Check that `command` can use wasmtime, before anything is started.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    try:
        import wasmtime  # noqa: F401, PLC0415 - 30 MB, for simulated robots alone
    except (ImportError, OSError, RuntimeError):  # without a library for the machine it raises the others
        if platform.machine() in MACHINES:
            raise LibraryMissing(command, "wasmtime", "sim") from None
        needs = f"needs wasmtime, which has no library for {platform.machine()}: run it on x86_64 or arm64"
        raise ConfigError(command, needs) from None


@cache
def _compiled() -> "tuple[wasmtime.Engine, wasmtime.Module]":
    """Compile the module, which takes 0.1 s.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    require_wasmtime("a simulated robot")
    import wasmtime  # noqa: PLC0415 - checked by require_wasmtime

    config = wasmtime.Config()
    # Without signal handlers and four GiB of addresses for each robot, it runs a tenth slower. Without threads, the
    # process may fork.
    config.signals_based_traps = False
    config.memory_reservation = 0
    config.memory_reservation_for_growth = 0
    config.memory_guard_size = 0
    config.parallel_compilation = False
    engine = wasmtime.Engine(config)
    module = wasmtime.Module(engine, MODULE.read_bytes())
    atexit.register(engine.close)
    atexit.register(module.close)
    return engine, module


@cache
def columns() -> tuple[str, ...]:
    """Names of the numbers in a row.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    module = Instance()
    return tuple(module.read_text("column", index) for index in range(int(module.call("column_count"))))


@cache
def bounds() -> Mapping[str, ParameterRange]:
    """Default and range of each number of a world, in the order of the C++ struct.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    module = Instance()
    _, defaults = module.read_parameters("")
    return {
        module.read_text("parameter_name", index): ParameterRange(
            default, float(module.call("parameter_least", index)), float(module.call("parameter_most", index))
        )
        for index, default in enumerate(defaults)
    }


@cache
def _reader() -> Instance:
    return Instance()


def read_lines(text: str) -> tuple[int, dict[str, float]]:
    """Parse lines name=value. Return the number of the first invalid line, or 0, and all numbers by name.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
        ValueError: the text is too long.
    """
    wrong, values = _reader().read_parameters(text)
    return wrong, dict(zip(bounds(), values, strict=True))


# -- parameters of the world ------------------------------------------------------------------------------------------

_LINE_END = re.compile(r"\r\n|\r|\n")


class WorldParameters(Mapping[str, float]):
    """Every number of a world: `world["track_m"]`, `world["left.radius_m"]`.

    firmware/host/world_parameters.h has their names, units, defaults and sources. Names and ranges are checked when the
    numbers are first used, so that a world can be written without wasmtime.
    """

    __slots__ = ("_given",)

    def __init__(self, given: Mapping[str, float] | None = None) -> None:
        """`given`: the numbers that differ from a robot without defects."""
        self._given = {name: float(value) for name, value in (given or {}).items()}

    def changed(self, values: Mapping[str, float]) -> Self:
        """Return the world with other numbers."""
        return type(self)({**self._given, **values})

    def checked_values(self) -> list[float]:
        """All numbers, in the order of the C++ struct.

        Raises:
            ConfigError: wasmtime is not installed, or has no library for this machine.
            ValueError: a name is unknown, and the text names the nearest one; or a number is out of its range.
        """
        for name, value in self._given.items():
            complaint = _complaint(name, value)
            if complaint is not None:
                raise ValueError(complaint)
        return [self._given.get(name, known.default) for name, known in bounds().items()]

    def text(self) -> str:
        """Return the given numbers as lines `name=value`, which the boards on the PC and the emulated board read."""
        return "".join(f"{name}={value!r}\n" for name, value in self._given.items())

    def __getitem__(self, name: str) -> float:
        return self._given[name] if name in self._given else bounds()[name].default

    def __iter__(self) -> Iterator[str]:
        return iter(bounds())

    def __len__(self) -> int:
        return len(bounds())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, WorldParameters) and self._given == other._given

    def __hash__(self) -> int:
        return hash(frozenset(self._given.items()))

    def __repr__(self) -> str:
        return f"WorldParameters({self._given})"


def wheel(side: str, **numbers: float) -> dict[str, float]:
    """Return the numbers of a wheel by their full names: `wheel("left", radius_m=0.0448)`."""
    return {f"{side}.{name}": value for name, value in numbers.items()}


def read(text: str) -> WorldParameters:
    """Parse a world from lines `name=value` without spaces. Empty lines and lines that begin with # are ignored.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
        ValueError: a line has another form, an unknown name or a number out of range; the text has the line's number.
    """
    text = text.replace("\0", "\ufffd")  # a NUL would end the text in C++
    wrong, values = read_lines(text)
    if not wrong:
        return WorldParameters({name: value for name, value in values.items() if value != bounds()[name].default})
    line = _LINE_END.split(text)[wrong - 1]
    name, _, value = line.partition("=")
    reason = f"{line!r} is not of the form name=number"
    with contextlib.suppress(ValueError):
        reason = _complaint(name, float(value)) or reason
    raise ValueError(f"line {wrong}: {reason}")


def _complaint(name: str, value: float) -> str | None:
    """Return why a number is invalid; None if it is valid."""
    known = bounds()
    if name not in known:
        near = get_close_matches(name, known, n=1)
        return f"{name}: no such parameter" + (f"; meant {near[0]}?" if near else "")
    _, low, high = known[name]
    return None if low <= value <= high else f"{name}: {value:g} is not in {low:g}..{high:g}"
