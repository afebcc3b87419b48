"""Other programs that have a serial port or a socket open, as Linux's /proc names them."""

import contextlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

PROC = Path("/proc")
_PARENT, _TERMINAL = 1, 4  # fields of /proc/PID/stat behind the name
_PSEUDO_TERMINALS = range(136, 144)  # major numbers; each mount of devpts has its own


@dataclass(frozen=True, slots=True)
class PortUsers:
    """Programs at one port. `has_login`: the port is the terminal of one of them, or the kernel's console."""

    names: tuple[str, ...] = ()  # "cat (pid 1234)"
    has_login: bool = False


def users_of(path: str, proc: Path = PROC) -> PortUsers:
    """Return the programs at a serial port, except this process and its children: the guardian has a duplicate.

    Of another user's program only its terminal is visible; of a hidden one (hidepid, ProtectProc) nothing.
    """
    real = Path(os.path.realpath(path))
    has_login = real.name in _consoles(proc)
    names = ["the kernel's console"] if has_login else []
    try:
        port = real.stat()
    except OSError:  # the port was removed
        return PortUsers(tuple(names), has_login)
    terminal, is_pseudo = _terminal_number(port.st_rdev), os.major(port.st_rdev) in _PSEUDO_TERMINALS
    own, wanted = os.getpid(), str(real)
    for process in proc.glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError, IndexError):  # the process has ended
            name, fields = _status(process)
            if own in (int(process.name), int(fields[_PARENT])):
                continue
            if is_pseudo and _has_other_terminals(process, port.st_dev):
                continue
            is_login = int(fields[_TERMINAL]) == terminal != 0
            if is_login or _has_open(process, wanted.__eq__):
                names.append(f"{name} (pid {process.name})")
                has_login |= is_login
    return PortUsers(tuple(names), has_login)


def find_user(is_wanted: Callable[[str], bool]) -> str:
    """Return another process with an open descriptor whose target is wanted: "screen (pid 1234)"; empty if unknown."""
    for process in PROC.glob("[0-9]*"):
        with contextlib.suppress(OSError, IndexError):  # the process has ended
            if int(process.name) != os.getpid() and _has_open(process, is_wanted):
                return f"{_status(process)[0]} (pid {process.name})"
    return ""


def is_running(name: str, proc: Path = PROC) -> bool:
    """Whether a visible process has this name."""
    for process in proc.glob("[0-9]*"):
        with contextlib.suppress(OSError, IndexError):  # the process has ended
            if _status(process)[0] == name:
                return True
    return False


def _status(process: Path) -> tuple[str, list[str]]:
    """Return the name of a process and the fields of its status behind the name, which may contain anything."""
    before, _, after = (process / "stat").read_text(errors="replace").rpartition(")")
    return before.partition("(")[2], after.split()


def _has_other_terminals(process: Path, mount: int) -> bool:
    """Whether a process has another mount of the pseudo-terminals than this one: in a container or a chroot.

    False for another user's process, whose root is hidden.
    """
    try:
        return (process / "root" / "dev" / "pts").stat().st_dev != mount
    except OSError:
        return False


def _has_open(process: Path, is_wanted: Callable[[str], bool]) -> bool:
    """Whether such a descriptor is open. False for another user's process, whose descriptors are hidden."""
    with contextlib.suppress(OSError), os.scandir(process / "fd") as descriptors:
        return any(is_wanted(_target(descriptor.path)) for descriptor in descriptors)
    return False


def _target(descriptor: str) -> str:
    try:
        return os.readlink(descriptor)  # noqa: PTH115 - a Path for each descriptor costs more than the call
    except OSError:  # closed meanwhile
        return ""


def _terminal_number(device: int) -> int:
    """Encode a device number as the kernel does in /proc/PID/stat."""
    minor = os.minor(device)
    return os.major(device) << 8 | minor & 0xFF | (minor & ~0xFF) << 12


def _consoles(proc: Path) -> set[str]:
    """Return the ports to which the kernel writes its messages: the first word of each line."""
    try:
        return {line.split()[0] for line in (proc / "consoles").read_text().splitlines() if line.strip()}
    except OSError:
        return set()
