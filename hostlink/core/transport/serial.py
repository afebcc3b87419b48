"""Serial ports: finding the configured port under its current name, and the transport over it."""

import asyncio
import contextlib
import errno
import fcntl
import glob
import grp
import os
import stat
import termios
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple, Protocol

import serial
import serial_asyncio
from serial.tools import list_ports

from hostlink.core.config import SerialConfig
from hostlink.core.transport.base import READ_BYTES
from hostlink.core.transport.connection import StreamTransport
from hostlink.core.transport.port_users import is_running, users_of

# -- ports ------------------------------------------------------------------------------------------------------------

BY_ID = Path("/dev/serial/by-id")
BY_PATH = Path("/dev/serial/by-path")

DTR_PULSE_S = 0.1  # the boards' capacitor needs a tenth of this

TTY_BYTES = 4095  # most that Linux returns in one read of a port; the rest waits in the driver
LEAVE_CHECK_S = 0.01  # 10 ms correspond to 58 bytes at 57600 baud


def find_port(config: SerialConfig) -> str:
    """Return the path of the configured port.

    Raises:
        OSError: no port or more than one port matches; the text lists them.
    """
    if config.usb_serial is not None:
        return choose_by_serial(config.usb_serial, _usb_ports())
    pattern = config.path or ""
    paths = sorted(glob.glob(pattern)) if glob.has_magic(pattern) else [pattern]  # noqa: PTH207 - an absolute pattern
    if len(paths) > 1:
        raise OSError(errno.EINVAL, f"{pattern}: matches {len(paths)} ports: {_listed(paths)}; name one of them")
    if not paths or not Path(paths[0]).exists():
        known = sorted(str(path) for path in BY_ID.glob("*"))
        taken = "; brltty runs here and takes USB adapters: sudo apt remove brltty" if is_running("brltty") else ""
        raise OSError(errno.ENOENT, f"{pattern}: no such port; available: {_listed(known)}{taken}")
    _check_alias(paths[0])
    return paths[0]


class UsbPort(NamedTuple):
    """Serial port of a USB device. `place`: the socket that the device is in, such as "1-1.2"."""

    path: str
    number: str  # serial number of the device
    place: str


def _usb_ports() -> list[UsbPort]:
    ports = ((port.device, port.serial_number, port.location or "") for port in list_ports.comports())
    return [UsbPort(path, number, place.partition(":")[0]) for path, number, place in ports if number]


def choose_by_serial(wanted: str, found: Iterable[UsbPort], by_path: Path = BY_PATH) -> str:
    """Return the path of the USB device with this serial number. Of a device with two ports, the first is returned.

    Raises:
        OSError: no device has it, or more than one; then a restart would exchange their robots.
    """
    known = sorted(found, key=lambda port: (port.number, port.path))
    ports = [port for port in known if port.number == wanted]
    if not ports:
        seen = _listed(f"{port.number} ({port.path})" for port in known)
        raise OSError(errno.ENOENT, f"{wanted}: no USB device with this serial number; available: {seen}")
    if len({port.place for port in ports}) > 1:
        names = {os.path.realpath(link): str(link) for link in sorted(by_path.glob("*"))}
        places = _listed(f"{port.path} = {names.get(port.path, f'USB {port.place}')}" for port in ports)
        raise OSError(
            errno.ENOTUNIQ,
            f"{wanted}: {len(ports)} ports have this serial number; name the USB socket instead, by its path in "
            f"{by_path}: {places}",
        )
    return ports[0].path


def _check_alias(path: str) -> None:
    """Refuse a name that was made from a serial number, as in by-id, if several devices have this number."""
    if not Path(path).is_symlink():
        return
    target, ports = os.path.realpath(path), _usb_ports()
    for port in ports:
        if port.path == target and port.number in Path(path).name:
            choose_by_serial(port.number, ports)


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"


# -- serial -----------------------------------------------------------------------------------------------------------

_CFLAG = 2  # index in the result of tcgetattr
_BUSY = (errno.EBUSY, errno.EAGAIN)
_ADVICE = {
    errno.EBUSY: "another program has it open",
    errno.EAGAIN: "another program has it open",
    errno.ENOTTY: "not a serial port",
    errno.EISDIR: "not a serial port",
}


async def open_serial(config: SerialConfig) -> "SerialTransport":
    """Find the port and open it exclusively.

    Raises:
        OSError: the port cannot be opened; the text says what to do.
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
    made = SerialTransport(port, peer=path, address=address)
    transport, _ = await serial_asyncio.connection_for_serial(loop, lambda: made, port)
    made.connection_made(transport)  # asyncio calls it only in the next turn of the loop
    return made


def _open(config: SerialConfig) -> tuple["_Port", str]:
    path = find_port(config)
    try:
        port = serial.Serial(baudrate=config.bauds[0], exclusive=True)
        port.port, port.dtr, port.rts = path, config.dtr, config.rts  # set before opening: a level may reset the board
        port.open()
        _keep_dtr(port.fileno())
    except (OSError, termios.error) as error:  # pyserial does not convert termios.error
        number = _error_number(error)
        raise OSError(number or errno.EIO, f"{path}: {_explain(path, number, error)}") from error
    except (ValueError, OverflowError) as error:
        raise OSError(errno.EINVAL, f"{path}: {config.bauds[0]} baud: {error}") from error
    return _Port(port), path


def _close_opened(opening: "asyncio.Future[tuple[_Port, str]]") -> None:
    """Close a port that a thread opened after the caller was cancelled."""
    if not opening.cancelled() and opening.exception() is None:
        opening.result()[0].close()


def _keep_dtr(descriptor: int) -> None:
    """Keep the DTR line on when the port is closed, so that the next open does not reset the board."""
    settings = termios.tcgetattr(descriptor)
    settings[_CFLAG] &= ~termios.HUPCL
    termios.tcsetattr(descriptor, termios.TCSANOW, settings)


class DtrLine(Protocol):
    """Port with a DTR line, which resets its board."""

    def set_dtr(self, *, is_on: bool) -> None: ...


async def pulse(port: DtrLine) -> None:
    """Release DTR and set it again, which resets most boards. Ignore a port without DTR."""
    with contextlib.suppress(OSError):
        port.set_dtr(is_on=False)
        await asyncio.sleep(DTR_PULSE_S)
        port.set_dtr(is_on=True)


class SerialTransport(StreamTransport):
    """Stream over a `_Port`, which reports write errors and unsent bytes."""

    __slots__ = ("_port",)

    kind = "serial"
    full_read_bytes = TTY_BYTES

    def __init__(self, port: "_Port", *, peer: str, address: str) -> None:
        super().__init__(peer=peer, address=address)
        self._port = port

    @property
    def baud(self) -> int:
        """The baud rate of the port."""
        return self._port.baud

    def set_baud(self, baud: int) -> None:
        """Change the baud rate. The port stays open, because reopening may reset the board."""
        self._port.set_baud(baud)

    def write(self, data: bytes) -> bool:
        """Pass data to the kernel. False also after a failure; `drain` raises its error."""
        return super().write(data) and self._port.write_error is None

    async def drain(self) -> None:
        """Wait until the kernel has accepted the written data."""
        await super().drain()
        if self._port.write_error is not None:
            raise self._port.write_error

    @property
    def lines(self) -> tuple[bool, bool]:
        """Levels of DTR and RTS."""
        return self._port.lines()

    @property
    def lost_reads(self) -> int:
        """Number of reads for which another program was faster."""
        return self._port.lost_reads

    def keep_settings(self) -> bool:
        """Set the port again as it was, if another program changed it. Return whether one did."""
        return self._port.is_open and self._port.keep_settings()

    def _open_descriptor(self) -> int | None:
        return self._port.fileno() if self._port.is_open else None

    async def _leave(self) -> None:
        await super().drain()
        while self._port.is_open and self._port.waiting_bytes():  # noqa: ASYNC110 - the kernel sends no event
            await asyncio.sleep(LEAVE_CHECK_S)

    def _abort(self) -> None:
        if self._port.is_open:  # pyserial-asyncio fails to abort a closed port
            super()._abort()


class _Port:
    """Replacement of pyserial's I/O for pyserial-asyncio, so that one port cannot block the daemon.

    pyserial's `flush` waits without bound for a device that reads nothing, its `write` spins while the kernel's buffer
    is full, and its `read` uses select(), which fails from descriptor 1024 on.
    """

    def __init__(self, port: serial.Serial) -> None:
        self.write_error: OSError | None = None
        self.timeout = self.write_timeout = 0  # pyserial-asyncio sets them
        self.lost_reads = 0  # another program read what this one was woken for
        self._port = port
        self._settings = termios.tcgetattr(port.fileno())

    @property
    def is_open(self) -> bool:
        return bool(self._port.is_open)

    def fileno(self) -> int:
        return int(self._port.fileno())

    @property
    def baud(self) -> int:
        return int(self._port.baudrate)

    def set_baud(self, baud: int) -> None:
        try:
            self._port.baudrate = baud
            _keep_dtr(self.fileno())
            self._settings = termios.tcgetattr(self.fileno())
        except termios.error as error:  # termios.error is not an OSError
            raise OSError(*error.args) from error

    def set_dtr(self, *, is_on: bool) -> None:
        self._port.dtr = is_on

    def lines(self) -> tuple[bool, bool]:
        """Return the levels of DTR and RTS as they were set."""
        return bool(self._port.dtr), bool(self._port.rts)

    def waiting_bytes(self) -> int:
        """Number of bytes that the kernel has not sent to the device yet."""
        return int(self._port.out_waiting)

    def read(self, _size: int) -> bytes:
        """Read what is available; b"" if another program was faster.

        pyserial-asyncio calls it only when bytes are available or the port was removed.
        """
        try:
            data = os.read(self.fileno(), READ_BYTES)
            if not data:
                fcntl.ioctl(self.fileno(), termios.FIONREAD, bytes(4))  # fails for a removed port only
        except BlockingIOError:
            data = b""
        except OSError as error:
            raise serial.SerialException(error.errno, f"{self._port.name}: {error.strerror}") from error
        self.lost_reads += not data
        return data

    def keep_settings(self) -> bool:
        """Set the port again as it was, if another program changed it. Return whether one did."""
        try:
            if termios.tcgetattr(self.fileno()) == self._settings:
                return False
            self.set_baud(self._port.baudrate)  # pyserial sets everything again
        except (OSError, termios.error):  # the port was removed; the link ends by its own error
            return False
        return True

    def write(self, data: bytes) -> int:
        """Write to the kernel and return the number of accepted bytes.

        An error is kept for `drain`, because asyncio would log a traceback if it were raised here.
        """
        try:
            return os.write(self.fileno(), data)
        except BlockingIOError:
            return 0
        except OSError as error:
            self.write_error = error
            return len(data)

    def flush(self) -> None:
        """Discard unsent bytes before closing, because close() would wait for them."""
        with contextlib.suppress(OSError):  # a removed port has no unsent bytes
            if self.waiting_bytes():
                self._port.reset_output_buffer()

    def close(self) -> None:
        """Unlock and close the port. A duplicate in another process would otherwise keep pyserial's lock."""
        if self.is_open:
            with contextlib.suppress(OSError):  # a removed port needs no unlocking
                fcntl.flock(self.fileno(), fcntl.LOCK_UN)
        self._port.close()


def _error_number(error: Exception) -> int | None:
    """Return the error number of an OSError or a termios.error; pyserial wraps the latter in a text."""
    if isinstance(error.__context__, termios.error):
        error = error.__context__
    number = error.args[0] if error.args else None
    return number if isinstance(number, int) else None


def _explain(path: str, number: int | None, error: Exception) -> str:
    if number is None:
        return str(error)
    if number == errno.EACCES:
        return explain_permission(Path(path).stat())
    text = _ADVICE.get(number, os.strerror(number))
    users = ", ".join(users_of(path).names) if number in _BUSY else ""
    return f"{text}: {users}" if users else text


def explain_permission(found: os.stat_result) -> str:
    """Name the group of the port, which differs between systems: dialout, uucp, plugdev, tty."""
    try:
        group = grp.getgrgid(found.st_gid).gr_name
    except KeyError:
        group = str(found.st_gid)
    if group == "root" or not found.st_mode & stat.S_IRGRP or not found.st_mode & stat.S_IWGRP:
        return f"no permission, and none for its group {group}: install the udev rule (hostlink serve --example udev)"
    return f"no permission: sudo usermod -aG {group} $USER, then log in again"
