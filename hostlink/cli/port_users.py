"""Who has a port or a file open, as far as Linux shows it to this user; empty where it does not."""

import contextlib
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path

PROC = Path("/proc")
_LISTENS = "0A"
_SOCKET = re.compile(r"socket:\[(\d+)\]")


def user_of_port(port: int) -> str:
    """The process that listens on a TCP port: "rosserial_python (pid 1234)"."""
    wanted = set(_listening_sockets(port))
    return _user(lambda target: bool((found := _SOCKET.fullmatch(target)) and found[1] in wanted))


def user_of_file(path: str) -> str:
    """The process that has a file or a serial port open."""
    real = os.path.realpath(path)
    return _user(lambda target: target == real)


def _listening_sockets(port: int) -> Iterator[str]:
    for table in ("tcp", "tcp6"):
        with contextlib.suppress(OSError):
            for line in (PROC / "net" / table).read_text().splitlines()[1:]:
                fields = line.split()
                if int(fields[1].rpartition(":")[2], 16) == port and fields[3] == _LISTENS:
                    yield fields[9]


def _user(is_it: Callable[[str], bool]) -> str:
    for process in PROC.glob("[0-9]*"):
        if int(process.name) == os.getpid():
            continue
        with contextlib.suppress(OSError):  # it has ended, or is another user's
            if any(is_it(_target(descriptor)) for descriptor in (process / "fd").iterdir()):
                return f"{(process / 'comm').read_text().strip()} (pid {process.name})"
    return ""


def _target(descriptor: Path) -> str:
    try:
        return str(descriptor.readlink())
    except OSError:
        return ""
