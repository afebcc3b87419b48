"""SO_LINGER of Zenoh's sockets, which is turned off: the end of one link must not delay the others.

Zenoh closes each TCP and TLS link with SO_LINGER of 10 s, in a thread that reads for all links. When a host vanishes,
bytes to it are unacknowledged, so that `close` waits for 10 s, and nothing is read from healthy hosts meanwhile
(eclipse-zenoh/zenoh#1101 and #2718). No setting of Zenoh changes that. Without SO_LINGER the kernel sends what is left
in the background.

Zenoh sets SO_LINGER when a connection is made, which may be long after its socket was. So all sockets are looked at
each time.
"""

import contextlib
import os
import socket
import struct
from collections.abc import Iterator

SWEEP_INTERVAL_S = 0.5  # a link to a host that vanished is closed after a lease of Zenoh, which is longer
_DESCRIPTORS = "/dev/fd"  # of this process
_LINGER = struct.Struct("ii")
ZENOHS = _LINGER.pack(1, 10)  # by which its sockets are known; nothing else in this process sets it
_OFF = _LINGER.pack(0, 0)


def end_lingering() -> int:
    """Turn SO_LINGER off on each socket with Zenoh's value. Return their number; 0 where descriptors are not listed."""
    lingering = [descriptor for descriptor, linger in lingers().items() if linger == ZENOHS]
    for descriptor in lingering:
        with _borrowed(descriptor) as one, contextlib.suppress(OSError):  # it was closed meanwhile
            one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _OFF)
    return len(lingering)


def lingers() -> dict[int, bytes]:
    """Return SO_LINGER of each socket of this process, by descriptor."""
    found = {}
    with contextlib.suppress(OSError):
        for name in os.listdir(_DESCRIPTORS):  # noqa: PTH208 - a Path for each costs more than the rest
            with contextlib.suppress(OSError), _borrowed(int(name)) as one:  # a file, or closed meanwhile
                found[int(name)] = one.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.size)
    return found


@contextlib.contextmanager
def _borrowed(descriptor: int) -> Iterator[socket.socket]:
    """Use a descriptor as a socket; it stays its owner's. The option has no family: none is asked for."""
    one = socket.socket(socket.AF_INET, socket.SOCK_STREAM, 0, descriptor)
    try:
        yield one
    finally:
        one.detach()
