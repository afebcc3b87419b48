"""Builds the ESP8266 passthrough for the PC, loads its pure part, and runs its unmodified sketch as a process."""

import ctypes
import json
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Self

from tests.support.once import once
from tests.support.precedence import GOES_FIRST

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "esp8266"
TARGETS = ("esp8266_native", "esp8266_original", "esp8266_abi")


@cache
def build() -> Path:
    """Compile the changed files; returns the folder of the results."""
    once("esp8266", _compile, BUILD / TARGETS[0])
    return BUILD


def _compile() -> None:
    source = ROOT / "firmware" / "esp8266"
    for command in (
        ["cmake", "-S", source, "-B", BUILD],
        ["cmake", "--build", BUILD, "--parallel", "2", "--target", *TARGETS],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


@cache
def library() -> ctypes.CDLL:
    """The pure part of the passthrough; firmware/tests/esp8266_abi.cpp has the functions."""
    lib = ctypes.CDLL(str(build() / "libesp8266_abi.so"))
    size, time, pointer, octets = ctypes.c_size_t, ctypes.c_uint32, ctypes.c_void_p, ctypes.c_char_p
    signatures = {
        "assembler_new": (pointer, time, time),
        "assembler_delete": (None, pointer),
        "assembler_restart": (None, pointer, time),
        "assembler_put": (size, pointer, octets, size, time),
        "assembler_size": (size, pointer),
        "assembler_capacity": (size,),
        "assembler_ready": (size, pointer, size, time),
        "assembler_take": (None, pointer, octets, size),
        "assembler_drop_oldest": (size, pointer),
        "sha256": (None, octets, size, size, octets),
        "hmac_sha256": (None, octets, size, octets, size, octets),
        "bridge_new": (pointer,),
        "bridge_set_key": (None, pointer, octets),
        "bridge_delete": (None, pointer),
        "bridge_turn": (ctypes.c_int, pointer, time),
        "bridge_from_device": (None, pointer, octets, size),
        "bridge_from_host": (None, pointer, octets, size),
        "bridge_set_room": (None, pointer, size, size),
        "bridge_set_signal": (None, pointer, ctypes.c_int),
        "bridge_lose": (None, pointer),
        "bridge_set_joined": (None, pointer, ctypes.c_int),
        "bridge_to_device": (size, pointer, octets, size),
        "bridge_to_host": (size, pointer, octets, size),
        "bridge_is_overrun": (ctypes.c_int, pointer),
        "bridge_dropped": (time, pointer),
    }
    for name, (result, *arguments) in signatures.items():
        function = getattr(lib, name)
        function.restype, function.argtypes = result, arguments
    return lib


class Assembler:
    """Python's view of FrameAssembler."""

    QUIET_MS, LONGEST_MS = 20, 500

    def __init__(self) -> None:
        self._lib = library()
        self._self = self._lib.assembler_new(self.QUIET_MS, self.LONGEST_MS)
        self.capacity = self._lib.assembler_capacity()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._lib.assembler_delete(self._self)

    def restart(self, now_ms: int) -> None:
        self._lib.assembler_restart(self._self, now_ms)

    def put(self, data: bytes, now_ms: int) -> int:
        return int(self._lib.assembler_put(self._self, data, len(data), now_ms))

    def size(self) -> int:
        return int(self._lib.assembler_size(self._self))

    def pop_ready(self, limit_bytes: int, now_ms: int) -> bytes:
        count = self._lib.assembler_ready(self._self, limit_bytes, now_ms)
        buffer = ctypes.create_string_buffer(max(1, count))
        self._lib.assembler_take(self._self, buffer, count)
        return buffer.raw[:count]


class Bridge:
    """A Passthrough between ports in memory."""

    def __init__(self, key: bytes = b"") -> None:
        self._lib = library()
        self._self = self._lib.bridge_new()
        self._key = ctypes.create_string_buffer(key)  # the bridge keeps the address
        self._lib.bridge_set_key(self._self, self._key)
        self._buffer = ctypes.create_string_buffer(1 << 16)
        self.now_ms = 0xFFFFF000

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._lib.bridge_delete(self._self)

    def turn(self, after_ms: int, *, device_room: int = 128, host_room: int = 2920) -> bool:
        """One turn of loop(); returns True with a link."""
        self.now_ms = (self.now_ms + after_ms) % 2**32
        self._lib.bridge_set_room(self._self, device_room, host_room)
        is_linked = bool(self._lib.bridge_turn(self._self, self.now_ms))
        assert not self._lib.bridge_is_overrun(self._self)
        return is_linked

    def from_device(self, data: bytes) -> None:
        self._lib.bridge_from_device(self._self, data, len(data))

    def from_host(self, data: bytes) -> None:
        self._lib.bridge_from_host(self._self, data, len(data))

    def set_signal(self, dbm: int) -> None:
        """Strength of the WiFi in dBm; 0 or more: unknown."""
        self._lib.bridge_set_signal(self._self, dbm)

    def lose(self) -> None:
        self._lib.bridge_lose(self._self)

    def to_device(self) -> bytes:
        count = self._lib.bridge_to_device(self._self, self._buffer, len(self._buffer))
        return self._buffer.raw[:count]

    def to_host(self) -> list[bytes]:
        writes = []
        while count := self._lib.bridge_to_host(self._self, self._buffer, len(self._buffer)):
            writes.append(self._buffer.raw[:count])
        return writes

    def dropped(self) -> int:
        return int(self._lib.bridge_dropped(self._self))


class Sketch:
    """A native process; its UART is a TCP port."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.uart_port = int(self._read()["port"])

    def _read(self) -> dict[str, int]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, f"the sketch ended with {self._process.wait(5)}"
        return json.loads(line)

    def command(self, text: str) -> dict[str, int]:
        """Send a command, then return the counters of the emulated hardware."""
        assert self._process.stdin is not None
        self._process.stdin.write(text + "\n")
        self._process.stdin.flush()
        return self._read()

    def signal(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def crash(self) -> tuple[int, str]:
        """Wait for its end; returns exit status and output."""
        _, errors = self._process.communicate(timeout=20)
        return self._process.returncode, errors

    def stop(self) -> None:
        """Stop the process. Sanitizers and the watchdog end it with another status."""
        self._process.terminate()
        assert self._process.wait(10) == 0


@contextmanager
def running(program: str, server_port: int, *options: str) -> Iterator[Sketch]:
    command = [*GOES_FIRST, build() / program, "--server", f"127.0.0.1:{server_port}", *options]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            yield Sketch(process)
        finally:
            process.kill()


@contextmanager
def running_sketch(server_port: int, *options: str) -> Iterator[Sketch]:
    with running("esp8266_native", server_port, *options) as sketch:
        yield sketch
        sketch.stop()
