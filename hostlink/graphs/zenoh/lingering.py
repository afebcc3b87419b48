"""SO_LINGER of Zenoh's sockets, which is turned off: the end of one link must not delay the others.

Zenoh closes each TCP and TLS link with SO_LINGER of 10 s, in a thread that reads for all links. When a host vanishes,
bytes to it are unacknowledged, so that `close` waits for 10 s, and nothing is read from healthy hosts meanwhile
(eclipse-zenoh/zenoh#1101 and #2718). No setting of Zenoh changes that. Without SO_LINGER the kernel sends what is left
in the background.
"""

import contextlib
import os
import socket
import stat
import struct
from collections.abc import Callable
from typing import TypeVar

SWEEP_INTERVAL_S = 0.5  # a link to a host that vanished is closed after a lease of Zenoh, which is longer
_DESCRIPTORS = "/dev/fd"  # of this process
_LINGER = struct.Struct("ii")
ZENOHS = _LINGER.pack(1, 10)  # by which its sockets are known; nothing else in this process sets it
_OFF = _LINGER.pack(0, 0)
Result = TypeVar("Result")


class LingerSweep:
    """Finds new sockets of this process that Zenoh has opened, and turns SO_LINGER off."""

    def __init__(self) -> None:
        self._known: dict[int, int] = {}  # inodes of sockets that were looked at, by descriptor

    def sweep(self) -> int:
        """Turn SO_LINGER off on each new socket of Zenoh. Return their number; 0 where descriptors are not listed."""
        before, self._known = self._known, _sockets()
        new = [descriptor for descriptor, inode in self._known.items() if before.get(descriptor) != inode]
        return sum(_end_lingering(descriptor) for descriptor in new)


def stream_sockets() -> dict[int, bytes]:
    """Return SO_LINGER of each TCP socket of this process, by descriptor."""
    return {each: value for each in _sockets() if (value := _with_socket(each, _linger)) is not None}


def _sockets() -> dict[int, int]:
    """Return the inodes of this process's sockets, by descriptor."""
    found = {}
    with contextlib.suppress(OSError):
        for name in os.listdir(_DESCRIPTORS):  # noqa: PTH208 - a Path for each costs more than the rest
            with contextlib.suppress(OSError):  # it was closed meanwhile
                status = os.fstat(int(name))
                if stat.S_ISSOCK(status.st_mode):
                    found[int(name)] = status.st_ino
    return found


def _linger(one: socket.socket) -> bytes | None:
    is_tcp = one.family in (socket.AF_INET, socket.AF_INET6) and one.type == socket.SOCK_STREAM
    return one.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.size) if is_tcp else None


def _end_lingering(descriptor: int) -> bool:
    """Turn SO_LINGER off if it has Zenoh's value."""

    def end(one: socket.socket) -> bool:
        is_zenohs = _linger(one) == ZENOHS
        if is_zenohs:
            one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _OFF)
        return is_zenohs

    return _with_socket(descriptor, end) or False


def _with_socket(descriptor: int, use: Callable[[socket.socket], Result]) -> Result | None:
    """Use a descriptor as a socket; it stays its owner's. None if it was closed meanwhile."""
    try:
        borrowed = socket.socket(fileno=descriptor)
    except OSError:
        return None
    try:
        return use(borrowed)
    except OSError:
        return None
    finally:
        borrowed.detach()
