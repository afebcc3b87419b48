"""Which serial port a configuration means today: a port that comes back under another name is found again."""

import asyncio
import contextlib
import errno
import fcntl
import glob
import os
import termios
from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

import serial
import serial_asyncio
from serial.tools import list_ports

from hostlink.config import SerialConfig
from hostlink.transport.base import READ_BYTES
from hostlink.transport.connection import Connection
from hostlink.transport.tcp import StreamTransport

# -- ports ------------------------------------------------------------------------------------------------------------

BY_ID = Path("/dev/serial/by-id")


def find_port(config: SerialConfig) -> str:
    """The path to open.

    Raises:
        OSError: there is none, or more than one; its text names the ports that there are.
    """
    if config.usb_serial is not None:
        found = {port.device: port.serial_number for port in list_ports.comports() if port.serial_number}
        return choose_by_serial(config.usb_serial, found)
    pattern = config.path or ""
    paths = sorted(glob.glob(pattern)) if glob.has_magic(pattern) else [pattern]  # noqa: PTH207 - an absolute pattern
    if len(paths) > 1:
        raise OSError(errno.EINVAL, f"{pattern}: fits {len(paths)} ports: {_listed(paths)}; say which")
    if not paths or not Path(paths[0]).exists():
        known = sorted(str(path) for path in BY_ID.glob("*"))
        raise OSError(errno.ENOENT, f"{pattern}: no such port; there are: {_listed(known)}")
    return paths[0]


def choose_by_serial(wanted: str, found: dict[str, str]) -> str:
    """`found`: path -> serial number of its USB device. A device with two ports: its first."""
    paths = sorted(path for path, number in found.items() if number == wanted)
    if not paths:
        known = _listed(sorted(f"{number} ({path})" for path, number in found.items()))
        raise OSError(errno.ENOENT, f"{wanted}: no USB device with this serial number; there are: {known}")
    return paths[0]


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"


# -- serial -----------------------------------------------------------------------------------------------------------

DTR_PULSE_S = 0.1  # the boards' capacitor needs a tenth of it
_CFLAG = 2  # its place in what tcgetattr gives
LEAVE_CHECK_S = 0.01  # 10 ms are 58 bytes at 57600 baud
_ADVICE = {
    errno.EACCES: "no permission: add this user to the group dialout, then log in again",
    errno.EBUSY: "another program has it open",
    errno.EAGAIN: "another program has it open",
    errno.ENOTTY: "not a serial port",
    errno.EISDIR: "not a serial port",
}


async def open_serial(config: SerialConfig) -> "SerialTransport":
    """Find the port and open it, for this program alone.

    Raises:
        OSError: it cannot be opened; its text advises what to do.
    """
    loop = asyncio.get_running_loop()
    opening = loop.run_in_executor(None, _open, config)
    try:
        port, path = await asyncio.shield(opening)
    except asyncio.CancelledError:
        opening.add_done_callback(_close_opened)
        raise
    with contextlib.ExitStack() as undo:
        undo.callback(port.close)
        if config.on_open == "reset":
            await pulse(port)
        transport = await _streams(port, path, config.name)
        undo.pop_all()
    return transport


async def _streams(port: "_Port", path: str, address: str) -> "SerialTransport":
    loop = asyncio.get_running_loop()
    transport, connection = await serial_asyncio.connection_for_serial(loop, Connection, port)
    connection.transport = transport  # asyncio sets it only in the loop's next turn
    return SerialTransport(port, connection, peer=path, address=address)


def _open(config: SerialConfig) -> tuple["_Port", str]:
    path = find_port(config)
    try:
        port = serial.Serial(path, baudrate=config.bauds[0], exclusive=True)
        _keep_dtr(port.fileno())
    except (OSError, termios.error) as error:  # pyserial lets the second through
        number = _error_number(error)
        raise OSError(number or errno.EIO, f"{path}: {_explain(number, error)}") from error
    except (ValueError, OverflowError) as error:
        raise OSError(errno.EINVAL, f"{path}: {config.bauds[0]} baud: {error}") from error
    return _Port(port), path


def _close_opened(opening: "asyncio.Future[tuple[_Port, str]]") -> None:
    """Nobody waits for the port any more that a thread has opened."""
    if not opening.cancelled() and opening.exception() is None:
        opening.result()[0].close()


def _keep_dtr(descriptor: int) -> None:
    """Closing the port leaves its DTR line on, so that opening it the next time is no reset."""
    settings = termios.tcgetattr(descriptor)
    settings[_CFLAG] &= ~termios.HUPCL
    termios.tcsetattr(descriptor, termios.TCSANOW, settings)


class DtrLine(Protocol):
    """Of a port, the line that resets its board."""

    def set_dtr(self, *, is_on: bool) -> None: ...


async def pulse(port: DtrLine) -> None:
    """Release DTR and set it again: the reset of most boards. A port without that line has nothing to reset."""
    with contextlib.suppress(OSError):
        port.set_dtr(is_on=False)
        await asyncio.sleep(DTR_PULSE_S)
        port.set_dtr(is_on=True)


class SerialTransport(StreamTransport):
    """A stream over a `_Port`, which knows what the stream does not: why a write failed, what has not left yet."""

    kind = "serial"

    def __init__(self, port: "_Port", connection: Connection, *, peer: str, address: str) -> None:
        super().__init__(connection, peer=peer, address=address)
        self._port = port

    def set_baud(self, baud: int) -> None:
        """Go on at another rate; the port stays open, because opening one again may reset its board."""
        self._port.set_baud(baud)

    def write(self, data: bytes) -> bool:
        """False also when it failed: `drain` raises why."""
        return super().write(data) and self._port.write_error is None

    async def drain(self) -> None:
        """Returns when the kernel has it."""
        await super().drain()
        if self._port.write_error is not None:
            raise self._port.write_error

    def _open_descriptor(self) -> int | None:
        return self._port.fileno() if self._port.is_open else None

    async def _leave(self) -> None:
        await self._connection.drain()
        while self._port.is_open and self._port.waiting_bytes():  # noqa: ASYNC110 - the kernel sends no event
            await asyncio.sleep(LEAVE_CHECK_S)

    def _abort(self) -> None:
        if self._port.is_open:  # pyserial-asyncio fails to abort what is closed already
            super()._abort()


class _Port:
    """What pyserial-asyncio uses of a port, so that one port cannot stop the daemon.

    pyserial's own `flush` waits without bound for a device that takes nothing, its `write` spins while the kernel's
    buffer is full, and its `read` goes through select(), which fails from descriptor 1024 on.
    """

    def __init__(self, port: serial.Serial) -> None:
        self.write_error: OSError | None = None
        self.timeout = self.write_timeout = 0  # pyserial-asyncio sets them
        self._port = port

    @property
    def is_open(self) -> bool:
        return bool(self._port.is_open)

    def fileno(self) -> int:
        return int(self._port.fileno())

    def set_baud(self, baud: int) -> None:
        try:
            self._port.baudrate = baud
        except termios.error as error:  # it is no OSError
            raise OSError(*error.args) from error

    def set_dtr(self, *, is_on: bool) -> None:
        self._port.dtr = is_on

    def waiting_bytes(self) -> int:
        """What the kernel has not given to the device yet."""
        return int(self._port.out_waiting)

    def read(self, _size: int) -> bytes:
        """Called when there is something; a port that then has nothing has vanished."""
        try:
            data = os.read(self.fileno(), READ_BYTES)
        except OSError as error:
            raise serial.SerialException(error.errno, f"{self._port.name}: {error.strerror}") from error
        if not data:
            raise serial.SerialException(errno.ENODEV, f"{self._port.name}: the port has vanished")
        return data

    def write(self, data: bytes) -> int:
        """How much the kernel has taken. An error is kept for `drain`: raised here, asyncio would log a traceback."""
        try:
            return os.write(self.fileno(), data)
        except BlockingIOError:
            return 0
        except OSError as error:
            self.write_error = error
            return len(data)

    def flush(self) -> None:
        """Called before closing: what has not left by now never will, and close() would wait for it."""
        with contextlib.suppress(OSError):  # a port that has vanished holds nothing
            if self.waiting_bytes():
                self._port.reset_output_buffer()

    def close(self) -> None:
        """Another process may hold a duplicate for a moment longer, and with it pyserial's lock."""
        if self.is_open:
            with contextlib.suppress(OSError):  # a port that has vanished is locked for nobody
                fcntl.flock(self.fileno(), fcntl.LOCK_UN)
        self._port.close()


def _error_number(error: Exception) -> int | None:
    """An OSError's own; termios.error has it as its first argument, and pyserial hides one of those in a text."""
    if isinstance(error.__context__, termios.error):
        error = error.__context__
    number = error.args[0] if error.args else None
    return number if isinstance(number, int) else None


def _explain(number: int | None, error: Exception) -> str:
    return str(error) if number is None else _ADVICE.get(number, os.strerror(number))
