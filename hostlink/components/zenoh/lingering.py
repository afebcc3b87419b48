"""Sockets of Zenoh: SO_LINGER is turned off, so that the end of one link does not delay the others.

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

SWEEP_INTERVAL_S = 0.5  # a link to a host that vanished is closed after a lease of Zenoh, which is longer
_DESCRIPTORS = "/dev/fd"  # of this process
_LINGER = struct.Struct("ii")
ZENOHS = _LINGER.pack(1, 10)  # by which its sockets are known; nothing else in this process sets it
_OFF = _LINGER.pack(0, 0)
_TCP = (socket.AF_INET, socket.SOCK_STREAM, 0)  # SO_LINGER does not depend on them; else the kernel is asked for them


class _Borrowed(socket.socket):
    """Socket of a descriptor, which stays its owner's."""

    def __exit__(self, *_: object) -> None:
        self.detach()


def end_lingering() -> int:
    """Turn SO_LINGER off on each socket with Zenoh's value. Return their number; 0 where descriptors are not listed."""
    lingering = [descriptor for descriptor, linger in lingers().items() if linger == ZENOHS]
    for descriptor in lingering:
        with contextlib.suppress(OSError), _Borrowed(*_TCP, descriptor) as one:  # or closed meanwhile
            one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _OFF)
    return len(lingering)


def lingers() -> dict[int, bytes]:
    """Return SO_LINGER of each socket of this process, by descriptor."""
    found = {}
    with contextlib.suppress(OSError):
        for name in os.listdir(_DESCRIPTORS):  # noqa: PTH208 - a Path for each costs more than the rest
            descriptor = int(name)
            with contextlib.suppress(OSError), _Borrowed(*_TCP, descriptor) as one:  # a file, or closed meanwhile
                found[descriptor] = one.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.size)
    return found


def shut_down(ends: set[tuple[str, str]]) -> int:
    """Shut down the connections between these ends, own and other one, as Zenoh names them. Return their number."""
    count = 0
    places = {(own.partition("/")[2], other.partition("/")[2]) for own, other in ends}  # without tcp/ or tls/
    for descriptor in lingers():
        with (
            contextlib.suppress(OSError),
            _Borrowed(-1, socket.SOCK_STREAM, 0, descriptor) as one,
        ):  # it listens, or was closed meanwhile
            if (_place(one.getsockname()), _place(one.getpeername())) in places:
                one.shutdown(socket.SHUT_RDWR)
                count += 1
    return count


def _place(address: object) -> str:
    """Return the address of a socket of TCP as in a locator of Zenoh; empty for another socket."""
    if not isinstance(address, tuple):
        return ""
    host = address[0]
    return f"[{host}]:{address[1]}" if ":" in host else f"{host}:{address[1]}"
