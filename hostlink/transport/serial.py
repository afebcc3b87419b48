"""Devices on serial ports: pyserial opens them, pyserial-asyncio moves the bytes."""

import asyncio
import contextlib
import errno
import os
import termios
from pathlib import Path

import serial
import serial_asyncio

from hostlink.config import SerialConfig
from hostlink.transport.base import READ_BYTES, Transport
from hostlink.transport.stream import StreamTransport

BY_ID = Path("/dev/serial/by-id")
LEAVE_CHECK_S = 0.01  # 10 ms are 58 bytes at 57600 baud
_ADVICE = {
    errno.EACCES: "no permission: add this user to the group dialout, then log in again",
    errno.EBUSY: "another program has it open",
    errno.EAGAIN: "another program has it open",
    errno.ENOTTY: "not a serial port",
    errno.EISDIR: "not a serial port",
}


async def open_serial(config: SerialConfig) -> Transport:
    """Open the port, for this program alone; an OSError says what to do."""
    try:
        port = _Port(serial.Serial(config.path, baudrate=config.baud, exclusive=True))
    except (OSError, termios.error) as error:  # pyserial lets the second through
        number = _error_number(error)
        raise OSError(number or errno.EIO, f"{config.path}: {_explain(number, error)}") from error
    except (ValueError, OverflowError) as error:
        raise OSError(errno.EINVAL, f"{config.path}: {config.baud} baud: {error}") from error
    loop = asyncio.get_running_loop()
    reader = asyncio.StreamReader(limit=READ_BYTES, loop=loop)
    protocol = asyncio.StreamReaderProtocol(reader, loop=loop)
    transport, _ = await serial_asyncio.connection_for_serial(loop, lambda: protocol, port)
    writer = asyncio.StreamWriter(transport, protocol, reader, loop)
    return SerialTransport(port, reader, writer, config.path)


class SerialTransport(StreamTransport):
    """A stream over a `_Port`, which knows what the stream does not: why a write failed, what has not left yet."""

    def __init__(self, port: "_Port", reader: asyncio.StreamReader, writer: asyncio.StreamWriter, path: str) -> None:
        super().__init__(reader, writer, peer=path, address=path)
        self._port = port

    async def send(self, data: bytes) -> None:
        """Returns when the kernel has it."""
        await super().send(data)
        if self._port.write_error is not None:
            raise self._port.write_error

    async def _leave(self) -> None:
        await self._writer.drain()
        while self._port.is_open and self._port.waiting_bytes():  # noqa: ASYNC110 - the kernel tells nobody
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
        """How much the kernel has taken. An error is kept for `send`: raised here, asyncio would log a traceback."""
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
        self._port.close()


def _error_number(error: Exception) -> int | None:
    """An OSError's own; termios.error has it as its first argument, and pyserial hides one of those in a text."""
    if isinstance(error.__context__, termios.error):
        error = error.__context__
    number = error.args[0] if error.args else None
    return number if isinstance(number, int) else None


def _explain(number: int | None, error: Exception) -> str:
    if number is None:
        return str(error)
    if number == errno.ENOENT:
        known = sorted(str(path) for path in BY_ID.glob("*"))
        return f"no such port; there are: {', '.join(known) or 'none'}"
    return _ADVICE.get(number, os.strerror(number))
