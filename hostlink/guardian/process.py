"""The guardian's process: it holds a duplicate of each robot's connection, and stops them all when the daemon is gone.

The standard library only, and of that what is small: `socket` imports enum, which alone takes 0.6 MiB.
"""

import _socket
import os
import resource
import select
import sys
import time

from hostlink.guardian.connection import Connection
from hostlink.guardian.frames import INTERVAL_S, ZEROS
from hostlink.guardian.records import (
    DESCRIPTOR_BYTES,
    GOODBYE,
    PING,
    RECORD_BYTES,
    RELEASE,
    decode,
    encode_answer,
)

LINGER_S = 0.5  # after the last byte: a device may take all of it before its connection is closed
END_S = ZEROS * INTERVAL_S + LINGER_S
POLL_S = 0.01  # whether a serial port has sent all: the kernel sends no event
OOM_SCORE = b"-1000"  # the kernel ends others first; needs a privilege
NAME = b"guardian"  # in ps and top
_ANCILLARY_BYTES = _socket.CMSG_SPACE(DESCRIPTOR_BYTES)


def main(descriptor: int) -> None:
    """Serve the daemon at the other end of this socket until it sends its goodbye or is gone."""
    prepare()
    channel = _socket.socket(fileno=descriptor)
    connections: dict[int, Connection] = {}
    if not listen(channel, connections):
        stop(list(connections.values()))
    os._exit(0)  # closes what is guarded, without the interpreter's own shutdown


def prepare() -> None:
    """Be the last that the system ends, and in nobody's way. Signals are blocked: it was started so."""
    os.chdir("/")
    write("/proc/self/oom_score_adj", OOM_SCORE)
    write("/proc/self/comm", NAME)
    try:
        _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    except (OSError, ValueError):
        return  # systemd's sandbox forbids it; the daemon has no more descriptors itself


def write(path: str, text: bytes) -> None:
    """Where the system allows it."""
    try:
        descriptor = os.open(path, os.O_WRONLY)
    except OSError:
        return
    try:
        os.write(descriptor, text)
    except OSError:
        return
    finally:
        os.close(descriptor)


def listen(channel: _socket.socket, connections: dict[int, Connection]) -> bool:
    """Keep what the daemon passes until its end of the channel closes; whether a goodbye came before."""
    while True:
        try:
            record, ancillary, _, _ = channel.recvmsg(RECORD_BYTES, _ANCILLARY_BYTES)
        except ConnectionResetError:  # it ended with answers unread; what it sent before is still here
            continue
        if not record:
            return False
        kind, number, topic_ids, claim_bytes = decode(record)
        if kind == GOODBYE:
            return True
        if kind == PING:
            answer(channel, len(connections))
            continue
        old = connections.pop(number, None)
        if old is not None:
            old.close()
        if kind != RELEASE and ancillary:  # without a descriptor: this process has none left; the answers show it
            descriptor = int.from_bytes(ancillary[0][2][:DESCRIPTOR_BYTES], sys.byteorder)
            connections[number] = Connection(descriptor, topic_ids, claim_bytes)


def answer(channel: _socket.socket, count: int) -> None:
    """Without waiting for a daemon that does not read."""
    try:
        channel.send(encode_answer(count), _socket.MSG_DONTWAIT)
    except OSError:
        return  # the next record, or its end, decides what to do


def stop(connections: list[Connection]) -> None:
    """Write every device's stop sequence, all at the same time; one that takes nothing delays no other."""
    began_s = time.monotonic()
    events: dict[int, int] = {}
    while connections and (now_s := time.monotonic() - began_s) < END_S:
        for connection in connections:
            connection.step(events.get(connection.descriptor, 0), now_s)
        connections = [connection for connection in connections if connection.is_open]
        events = wait(connections, now_s)
    for connection in connections:
        connection.abandon()


def wait(connections: list[Connection], now_s: float) -> dict[int, int]:
    """Until something can be read or written, or is due: what happened, by descriptor."""
    poll = select.poll()
    wait_s = POLL_S
    for connection in connections:
        poll.register(connection.descriptor, connection.events(now_s))
        next_s = connection.next_s()
        if next_s is not None:
            wait_s = min(wait_s, next_s - now_s)
    return dict(poll.poll(max(0.0, wait_s) * 1000))
