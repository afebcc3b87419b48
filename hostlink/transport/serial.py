"""Devices on serial ports, through pyserial-asyncio."""

import asyncio
import errno
from pathlib import Path

import serial
import serial_asyncio

from hostlink.config import SerialConfig
from hostlink.transport.base import READ_BYTES, Transport
from hostlink.transport.stream import StreamTransport

BY_ID = Path("/dev/serial/by-id")
_ADVICE = {
    errno.EACCES: "no permission: add this user to the group dialout, then log in again",
    errno.EBUSY: "another program has it open",
    errno.EAGAIN: "another program has it open",
}


async def open_serial(config: SerialConfig) -> Transport:
    """Open the port, for this program alone; an OSError says what to do."""
    loop = asyncio.get_running_loop()
    reader = asyncio.StreamReader(limit=READ_BYTES, loop=loop)
    protocol = asyncio.StreamReaderProtocol(reader, loop=loop)
    try:
        transport, _ = await serial_asyncio.create_serial_connection(
            loop, lambda: protocol, config.path, baudrate=config.baud, exclusive=True
        )
    except serial.SerialException as error:
        raise OSError(error.errno or errno.EIO, f"{config.path}: {_explain(error)}") from error
    except ValueError as error:
        raise OSError(errno.EINVAL, f"{config.path}: {config.baud} baud: {error}") from error
    writer = asyncio.StreamWriter(transport, protocol, reader, loop)
    return StreamTransport(reader, writer, peer=config.path, address=config.path)


def _explain(error: serial.SerialException) -> str:
    if error.errno == errno.ENOENT:
        known = sorted(str(path) for path in BY_ID.glob("*"))
        return f"no such port; there are: {', '.join(known) or 'none'}"
    return _ADVICE.get(error.errno or 0, str(error))
