"""How much of what was written to a connection has not arrived: a state that is put behind it only grows old."""

import asyncio
import fcntl
import math
import sys
import termios

MOST_BYTES = 4096  # less is there at once, or waits for an acknowledgement that its receiver delays
CHECK_S = 0.02


def unread_bytes(transport: asyncio.WriteTransport) -> int:
    """In the process, in the kernel, and on the line; elsewhere than on Linux the process alone.

    Raises:
        OSError: the connection is closed: its socket has no number any more.
    """
    if transport.is_closing():
        raise ConnectionResetError
    count = transport.get_write_buffer_size()
    if sys.platform == "linux":
        queued = fcntl.ioctl(transport.get_extra_info("socket").fileno(), termios.TIOCOUTQ, bytes(4))
        count += int.from_bytes(queued, sys.byteorder)
    return count


async def until_read(transport: asyncio.WriteTransport | None, timeout_s: float) -> None:
    """Wait until nearly all has arrived.

    Raises:
        TimeoutError: nothing more arrives.
        OSError: the connection is closed.
    """
    if transport is None:
        raise ConnectionResetError
    loop = asyncio.get_running_loop()
    least, since_s = math.inf, loop.time()
    while (unread := unread_bytes(transport)) > MOST_BYTES:
        if unread < least:
            least, since_s = unread, loop.time()
        elif loop.time() - since_s > timeout_s:
            raise TimeoutError
        await asyncio.sleep(CHECK_S)
