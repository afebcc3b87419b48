"""The module firmware.wasm: the Due's firmware in its world, compiled by `make world`.

It is firmware/host/firmware_module.cpp; wasmtime executes it. Each instance is one robot with a memory of its own: use
it from one thread, and as many of them as you like.
"""

import atexit
import ctypes
import platform
import weakref
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from hostlink.errors import ConfigError, LibraryMissing

if TYPE_CHECKING:
    import wasmtime

MODULE = Path(__file__).with_name("firmware.wasm")
TEXT_BYTES = LINE_BYTES = 1 << 16  # of its buffers
MOST_ROWS = 1 << 13
MACHINES = ("x86_64", "AMD64", "aarch64", "arm64")  # for which wasmtime has a library


class ParameterRange(NamedTuple):
    """Of a number of a world."""

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
    """The module with a memory of its own, which never grows: an address in it holds as long as the instance."""

    def __init__(self) -> None:
        import wasmtime  # noqa: PLC0415 - an extra, which `_compiled` reports where it is missing

        engine, module = _compiled()
        self.store = wasmtime.Store(engine)
        weakref.finalize(self, self.store.close)  # at the interpreter's end, too: later its own way fails
        self._exports = wasmtime.Instance(self.store, module, []).exports(self.store)
        self.call("_initialize")
        memory = self._exports["memory"]
        assert isinstance(memory, wasmtime.Memory)  # noqa: S101 - for the type
        self._base = ctypes.addressof(memory.data_ptr(self.store).contents)

    def function(self, name: str) -> "wasmtime.Func":
        """What the module exports."""
        return self._exports[name]  # type: ignore[return-value]

    def call(self, name: str, *arguments: float) -> int | float:
        """Call a function; 0 of one that returns nothing."""
        return self.function(name)(self.store, *arguments) or 0

    def address(self, name: str) -> int:
        """Of a buffer, by the function that returns it."""
        return self._base + int(self.call(name))

    def read_text(self, name: str, index: int) -> str:
        """What a function returns as char*."""
        return ctypes.string_at(self._base + int(self.call(name, index))).decode()

    def write_text(self, text: bytes) -> None:
        """Put it into the module's text().

        Raises:
            ValueError: it is longer than TEXT_BYTES.
        """
        if len(text) >= TEXT_BYTES:
            raise ValueError(f"a text of {len(text)} bytes, the firmware takes {TEXT_BYTES - 1}")
        ctypes.memmove(self.address("text"), text + b"\0", len(text) + 1)

    def read_parameters(self, text: str) -> tuple[int, list[float]]:
        """Of lines name=value: 0 or the number of the line that is wrong, and all numbers of the world."""
        self.write_text(text.encode())
        wrong, count = int(self.call("read_parameters")), int(self.call("parameter_count"))
        return wrong, list((ctypes.c_double * count).from_address(self.address("parameter_numbers")))


def require_wasmtime(command: str) -> None:
    """Refuse before anything is started.

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
    """Compile the module: 0.1 s.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    require_wasmtime("a simulated robot")
    import wasmtime  # noqa: PLC0415 - as there

    config = wasmtime.Config()
    # A tenth slower than with signal handlers and four GiB of addresses for each robot; and without threads a process
    # may fork.
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
    """The names of a row's numbers.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    module = Instance()
    return tuple(module.read_text("column", index) for index in range(int(module.call("column_count"))))


@cache
def bounds() -> Mapping[str, ParameterRange]:
    """Of each number of a world: its default and range, in their order.

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
    """Of lines name=value: 0 or the number of the line that is wrong, and all numbers by name.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
        ValueError: it is too long.
    """
    wrong, values = _reader().read_parameters(text)
    return wrong, dict(zip(bounds(), values, strict=True))
