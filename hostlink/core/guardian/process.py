"""The guardian's process: holds a duplicate of each robot's connection, and stops the robots without the daemon.

It imports only small parts of the standard library: `socket` imports enum, which alone takes 0.6 MiB.
"""

import _socket
import os
import resource
import select
import sys
import time

from hostlink.core.guardian.connection import ANSWERING_S, GuardedConnection
from hostlink.core.guardian.frames import ZEROS
from hostlink.core.guardian.records import (
    BEAT,
    DESCRIPTOR_BYTES,
    GOODBYE,
    MAX_RECORD_BYTES,
    PING,
    RELEASE,
    decode,
    decode_beat,
    encode_answer,
)
from hostlink.core.runtime.remains import SALVAGE, of_process, remove_empty
from hostlink.core.runtime.stop_frames import INTERVAL_S

HANG_S = 1.0  # after the last beat while a robot is driven; the daemon sends one every 0.2 s
HOLD_POLL_S = 0.01  # while a device does not read
LINGER_S = 0.5  # after the last byte: a device may read all of it before its connection is closed
END_S = max(ZEROS * INTERVAL_S + LINGER_S, ANSWERING_S)
POLL_S = 0.01  # interval of the check whether a serial port has sent everything: the kernel sends no event
OOM_SCORE = b"-1000"  # the kernel kills other processes first; needs a privilege
NAME = b"guardian"  # shown by ps and top
_ANCILLARY_BYTES = _socket.CMSG_SPACE(DESCRIPTOR_BYTES)
_CLOEXEC = _socket.MSG_CMSG_CLOEXEC


def main(descriptor: int) -> None:
    """Serve the daemon on this socket until its goodbye or its end."""
    prepare()
    daemon = os.getppid()
    channel = _socket.socket(fileno=descriptor)
    connections: dict[int, GuardedConnection] = {}
    is_driven = listen(channel, connections)
    if is_driven is not None:
        stop(list(connections.values()))
        channel.close()
        save_remains(daemon, is_driven=is_driven)
    os._exit(0)  # closes the connections without the interpreter's shutdown


def save_remains(daemon: int, *, is_driven: bool) -> None:
    """Start a process that writes incidents from the daemon's data in memory. Signals stay blocked in it.

    Under a service manager the next start of the daemon does this. The manager would wait for this process to end.
    """
    if not is_driven:
        remove_empty(daemon)
    if "NOTIFY_SOCKET" in os.environ or not of_process(daemon):
        return
    command = [sys.executable, "-c", SALVAGE, sys.argv[1], str(daemon)]
    try:
        os.posix_spawn(sys.executable, command, os.environ)
    except OSError:
        return  # the next start of the daemon does it


def prepare() -> None:
    """Lower the priority for the OOM killer and raise the descriptor limit. Signals are blocked by the starter."""
    os.chdir("/")
    write("/proc/self/oom_score_adj", OOM_SCORE)
    write("/proc/self/comm", NAME)
    try:
        _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    except (OSError, ValueError):
        return  # systemd's sandbox forbids it; the daemon has no more descriptors itself


def write(path: str, text: bytes) -> None:
    """Write a file of /proc, if the system allows it."""
    try:
        with open(path, "wb", buffering=0) as file:  # noqa: PTH123 - pathlib is a large import
            file.write(text)
    except OSError:
        return


def listen(channel: _socket.socket, connections: dict[int, GuardedConnection]) -> bool | None:
    """Guard connections until the channel closes. Return whether robots were driven then; None after a goodbye.

    While robots are driven and no beat arrives for HANG_S, they are sent zeros. The daemon may recover afterwards.
    """
    poll = select.poll()
    poll.register(channel.fileno(), select.POLLIN)
    driven: list[int] = []  # empty: no beat is expected
    held: list[GuardedConnection] = []  # connections that are sent zeros
    is_driven, beat_s, stopped = False, 0.0, 0
    while True:
        now_s = time.monotonic()
        if driven and now_s >= beat_s + HANG_S and not poll.poll(0):  # received records are read first
            held = [connections[number] for number in driven if number in connections]
            for connection in held:
                connection.begin_hold()
            stopped += len(held)
            driven = []
        held, wait_s = hold(held, now_s - beat_s - HANG_S)
        if driven:
            wait_s = beat_s + HANG_S - now_s
        if wait_s is not None and not poll.poll(max(0.0, wait_s) * 1000):
            continue
        try:
            record, ancillary, _, _ = channel.recvmsg(MAX_RECORD_BYTES, _ANCILLARY_BYTES, _CLOEXEC)
        except ConnectionResetError:  # the daemon ended with unread answers; its records are still readable
            continue
        if not record:
            return is_driven
        if record[:1] == BEAT:
            numbers = decode_beat(record)
            driven, held, beat_s = list(connections if numbers is None else numbers), [], time.monotonic()
            is_driven = bool(driven)
            continue
        kind, number, stop_frames = decode(record)
        if kind == GOODBYE:
            return None
        if kind == PING:
            answer(channel, len(connections), stopped)
            continue
        old = connections.pop(number, None)
        if old is not None:
            old.close()
        if kind != RELEASE and ancillary:  # without a descriptor: this process has none left, which the answers show
            descriptor = int.from_bytes(ancillary[0][2][:DESCRIPTOR_BYTES], sys.byteorder)
            connections[number] = GuardedConnection(descriptor, stop_frames)


def hold(connections: list[GuardedConnection], now_s: float) -> tuple[list[GuardedConnection], float | None]:
    """Write the zeros that are due `now_s` after the hang began. Return the unfinished connections and the wait.

    A write of a few frames is one system call, so no bytes of a recovering daemon are between them.
    """
    owed, next_s = [], END_S
    if now_s < END_S:
        for connection in connections:
            due_s = connection.hold(now_s) if connection.is_open else None
            if due_s is not None:
                owed.append(connection)
                next_s = min(next_s, due_s)
    return owed, max(HOLD_POLL_S, next_s - now_s) if owed else None


def answer(channel: _socket.socket, count: int, stopped: int) -> None:
    """Answer a ping. Do not wait for a daemon that does not read."""
    try:
        channel.send(encode_answer(count, stopped), _socket.MSG_DONTWAIT)
    except OSError:
        return  # the next record or the end of the channel decides


def stop(connections: list[GuardedConnection]) -> None:
    """Write every device's stop sequence in parallel. A device that does not read delays no other."""
    began_s = time.monotonic()
    events: dict[int, int] = {}
    while connections and (now_s := time.monotonic() - began_s) < END_S:
        for connection in connections:
            connection.step(events.get(connection.descriptor, 0), now_s)
        connections = [connection for connection in connections if connection.is_open]
        events = wait(connections, now_s)
    for connection in connections:
        connection.abandon()


def wait(connections: list[GuardedConnection], now_s: float) -> dict[int, int]:
    """Wait until a connection is ready or due. Return the events by descriptor."""
    poll = select.poll()
    wait_s = POLL_S
    for connection in connections:
        poll.register(connection.descriptor, connection.events(now_s))
        next_s = connection.next_s()
        if next_s is not None:
            wait_s = min(wait_s, next_s - now_s)
    return dict(poll.poll(max(0.0, wait_s) * 1000))
