"""Errors that hostlink raises on purpose, with their numbers as attributes."""

import itertools
import os
import shlex
import sys
from collections.abc import Hashable, Iterable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, Self, TypeVar

Kept = TypeVar("Kept", bound=BaseException)

DEBIAN_PACKAGE: Final = Path("/usr/lib/hostlink")  # its virtual environment, which has no pip

MAX_FIELD_NAME: Final = 64  # characters that are compared: a client may send any


def system_text(error: OSError) -> str:
    """Return the system's text of an error, without the words that asyncio adds."""
    import socket  # noqa: PLC0415 - most commands need no network to fail

    # getaddrinfo has its own error numbers; Python 3.13 has only a text for an address of no interface.
    if isinstance(error, socket.gaierror) or error.errno is None:
        return error.strerror or str(error)
    return os.strerror(error.errno)


def size(count: float) -> str:
    """Text of a number of bytes: 320 B, 9.6 kB, 1.2 MB."""
    for unit in ("B", "kB", "MB"):
        if count < 1000:  # noqa: PLR2004 - orders of magnitude
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} GB"


class HostlinkError(Exception):
    """Base class: a request cannot be fulfilled. The text names the next step.

    `kind` is the public name of the error: the class name, unless a class overrides it.
    """

    kind: str = "HostlinkError"

    def __init_subclass__(cls) -> None:
        """Set `kind` to the class name."""
        super().__init_subclass__()
        cls.kind = cls.__name__


class ConfigError(HostlinkError):
    """A setting is wrong. Raised once, at the start."""

    def __init__(self, where: str, problem: str) -> None:
        super().__init__(f"{where}: {problem}")
        self.where, self.problem = where, problem


def requirements_of(extra: str) -> list[str]:
    """Return what an extra of hostlink installs, as pip takes it. Empty if this installation has no such extra."""
    from importlib.metadata import PackageNotFoundError, requires  # noqa: PLC0415 - 20 ms, only for an error

    try:
        lines = [line.partition(";") for line in requires("hostlink") or ()]
    except PackageNotFoundError:  # the sources, without an installation
        return []
    return [name.strip() for name, _, marker in lines if f"extra == '{extra}'" in marker.replace('"', "'")]


class LibraryMissing(ConfigError):
    """A feature needs a library that only an extra of hostlink installs, or that this installation lacks."""

    def __init__(self, where: str, library: str, extra: str) -> None:
        """Build the advice: the command that installs what the extra has, into this environment.

        The extra is empty for a library that every installation of hostlink should have.
        It does not name hostlink: hostlink is in no package index, so a package of that name may be malicious.
        """
        self.library, self.extra = library, extra
        if Path(sys.prefix) == DEBIAN_PACKAGE:
            advice = (
                "the Debian package does not have it; install the wheel with pip"
                if extra
                else "run  sudo apt install --reinstall hostlink"
            )
        else:
            wanted = requirements_of(extra) or [library]
            advice = f"run  {shlex.join([sys.executable, '-m', 'pip', 'install', *wanted])}"
        of_extra = f", of the extra {extra!r}" if extra else ", which is not installed"
        super().__init__(where, f"needs {library}{of_extra}: {advice}")


class UnknownTopic(HostlinkError):
    """There is no topic, service or robot of that name."""

    def __init__(self, what: str, name: str, known: Iterable[str] = (), *, why: str = "") -> None:
        """Build the text with the reason, or with some of the known names: devices may announce any number of them."""
        self.what, self.name, self.known = what, name, tuple(itertools.islice(known, 64))
        hint = f": {why}" if why else f"; known: {', '.join(sorted(self.known)[:8])}" if self.known else ""
        super().__init__(f"no {what} named {name}{hint}")


class WrongType(HostlinkError):
    """Two sides use different types under one name."""

    def __init__(self, name: str, wanted: str, got: str) -> None:
        super().__init__(f"{name}: wanted {wanted}, got {got}")
        self.name, self.wanted, self.got = name, wanted, got


class BadPayload(HostlinkError):
    """Bytes that are not a message of the announced type."""

    def __init__(self, type_name: str, problem: str) -> None:
        super().__init__(f"{type_name}: {problem}")
        self.type_name, self.problem = type_name, problem


class FrameTooLarge(HostlinkError):
    """A frame is larger than the device's buffer, or than its line allows while a stop may be needed."""

    def __init__(self, topic: str, frame_bytes: int, limit_bytes: int, *, when: str = "") -> None:
        super().__init__(f"{topic}: frame of {frame_bytes} bytes, the device takes {limit_bytes}{when and f' {when}'}")
        self.topic, self.frame_bytes, self.limit_bytes = topic, frame_bytes, limit_bytes


class DeviceGone(HostlinkError):
    """The device disconnected before it answered, or is not connected."""

    def __init__(self, name: str, why: str = "its device is not connected") -> None:
        super().__init__(f"{name}: {why}")
        self.name, self.why = name, why


class DeviceBusy(HostlinkError):
    """A bounded queue to a device is full."""

    def __init__(self, name: str, waiting: int) -> None:
        super().__init__(f"{name}: {waiting} requests wait already; try again later")
        self.name, self.waiting = name, waiting


class ServiceFailed(HostlinkError):
    """A service reported a failure, or did not answer in time."""

    def __init__(self, service: str, reason: str) -> None:
        super().__init__(f"{service}: {reason}")
        self.service, self.reason = service, reason

    @classmethod
    def timeout(cls, service: str, timeout_s: float) -> Self:
        """Create the error of a missing answer."""
        return cls(service, f"no answer within {timeout_s:g} s")


def nearest_field(name: str, known: Iterable[str]) -> str:
    """Return the end of an error's text about an unknown field: the known one that is spelled alike, or all of them."""
    from difflib import get_close_matches  # noqa: PLC0415 - 5 ms, only for an error

    fields = list(known)
    near = get_close_matches(name[:MAX_FIELD_NAME], fields, n=1)
    return f"; did you mean `{near[0]}`?" if near else f"; its fields: {', '.join(fields) or 'none'}"


class BadRequest(HostlinkError):
    """A client's request is invalid."""


class NoRole(BadRequest):
    """The role of a client's token does not allow the request."""


class ReloadRefused(HostlinkError):
    """The configuration cannot be reloaded, or not now."""


class ComponentGone(HostlinkError):
    """A component that a request needs does not run."""

    def __init__(self, name: str) -> None:
        super().__init__(f"the {name} does not run: [components] switches it off, or `hostlink doctor` says why")
        self.name = name


class RecordingFailed(HostlinkError):
    """A recording cannot be written or read."""


class UnknownFormat(RecordingFailed):
    """A recording, or one of its channels, has messages that hostlink cannot convert."""


class RecordingBusy(HostlinkError):
    """The name is in use, the file is being written, or too many recordings are running."""


class RefusalKind(StrEnum):
    """Reason of a refused velocity. Public: REST, rosbridge, client, CLI, events and metrics use these names."""

    NOT_FINITE = "not_finite"
    UNSUPPORTED = "unsupported"  # the robot's kinematics lack a component that is not zero
    LOCKED = "locked"
    NOT_CONNECTED = "not_connected"
    LATE = "late"
    DISARMED = "disarmed"
    HELD = "held"
    CROWDED = "crowded"
    ENDING = "ending"  # the daemon stops


class CommandRefused(HostlinkError):
    """A velocity was refused. `kind` is the rule; `holder` is the source that holds the lease, if any.

    `by` is the holder, who locked the robot, or what disarmed the source; None: unknown.
    """

    kind: RefusalKind

    def __init__(
        self, robot: str, kind: RefusalKind, reason: str, *, holder: Hashable = None, by: str | None = None
    ) -> None:
        super().__init__(reason)
        self.robot, self.kind, self.reason, self.holder = robot, kind, reason, holder
        self.by = str(holder) if by is None and holder is not None else by


class Refused(HostlinkError):
    """The daemon has refused a request of the client. `kind` is the daemon's, and `answer` all that it said by REST."""

    def __init__(self, kind: str, reason: str, answer: Mapping[str, Any] | None = None) -> None:
        super().__init__(reason)
        self.kind, self.reason, self.answer = kind, reason, answer or {}


class StopFailed(Refused):
    """A stop or a lock of all did not reach every robot. `stopped`: what became of each, as the call returns it."""

    stopped: Any = None


class NothingArrived(HostlinkError):
    """A reader of the client has waited for a message in vain."""

    def __init__(self, topic: str, timeout_s: float) -> None:
        super().__init__(f"{topic}: no message arrived for {timeout_s:g} s; `hostlink topics` shows who publishes it")
        self.topic, self.timeout_s = topic, timeout_s


def without_frames(error: Kept) -> Kept:
    """Forget where an error was raised and why. The frames have what keeps the error: a reference cycle."""
    error.__traceback__ = error.__cause__ = error.__context__ = None
    return error
