"""Every error that hostlink raises on purpose, with its numbers as attributes."""

import itertools
from collections.abc import Hashable, Iterable
from enum import StrEnum
from typing import Self


class HostlinkError(Exception):
    """Base of all: a caller requested what cannot be done. The text names the next step.

    `kind` is its public name, for programs: the name of the class, unless a class says otherwise.
    """

    kind: str = "HostlinkError"

    def __init_subclass__(cls) -> None:
        """Name the class."""
        super().__init_subclass__()
        cls.kind = cls.__name__


class ConfigError(HostlinkError):
    """A setting is wrong; raised once, at the start."""

    def __init__(self, where: str, problem: str) -> None:
        super().__init__(f"{where}: {problem}")
        self.where, self.problem = where, problem


class LibraryMissing(ConfigError):
    """What was asked for needs a library that only an extra of hostlink installs."""

    def __init__(self, where: str, library: str, extra: str) -> None:
        """The text names no index: hostlink is in none, so that whoever takes its name there is a stranger."""
        self.library, self.extra = library, extra
        advice = f"run  pip install '.[{extra}]'  in a clone, or name the wheel's file for the dot"
        super().__init__(where, f"needs {library}: {advice}")


class UnknownTopic(HostlinkError):
    """No topic, service or robot of that name."""

    def __init__(self, what: str, name: str, known: Iterable[str] = ()) -> None:
        """The text names some of those that are known: devices may announce any number of them."""
        self.what, self.name, self.known = what, name, tuple(itertools.islice(known, 64))
        hint = f"; known: {', '.join(sorted(self.known)[:8])}" if self.known else ""
        super().__init__(f"no {what} named {name}{hint}")


class WrongType(HostlinkError):
    """Two sides mean different things by one name."""

    def __init__(self, name: str, wanted: str, got: str) -> None:
        super().__init__(f"{name}: wanted {wanted}, got {got}")
        self.name, self.wanted, self.got = name, wanted, got


class BadPayload(HostlinkError):
    """Bytes that are no message of the type that was announced for them."""

    def __init__(self, type_name: str, problem: str) -> None:
        super().__init__(f"{type_name}: {problem}")
        self.type_name, self.problem = type_name, problem


class FrameTooLarge(HostlinkError):
    """A frame that is larger than the device's buffer, or than its line allows while a stop may be needed."""

    def __init__(self, topic: str, frame_bytes: int, limit_bytes: int, *, when: str = "") -> None:
        super().__init__(f"{topic}: frame of {frame_bytes} bytes, the device takes {limit_bytes}{when and f' {when}'}")
        self.topic, self.frame_bytes, self.limit_bytes = topic, frame_bytes, limit_bytes


class DeviceGone(HostlinkError):
    """The device left before it answered, or is not connected."""

    def __init__(self, name: str, why: str = "its device is not connected") -> None:
        super().__init__(f"{name}: {why}")
        self.name, self.why = name, why


class DeviceBusy(HostlinkError):
    """A bounded queue towards a device is full."""

    def __init__(self, name: str, waiting: int) -> None:
        super().__init__(f"{name}: {waiting} requests wait already; try again later")
        self.name, self.waiting = name, waiting


class ServiceFailed(HostlinkError):
    """A service reports that it could not do it, or does not answer in time."""

    def __init__(self, service: str, reason: str) -> None:
        super().__init__(f"{service}: {reason}")
        self.service, self.reason = service, reason

    @classmethod
    def timeout(cls, service: str, timeout_s: float) -> Self:
        """No answer came within the deadline."""
        return cls(service, f"no answer within {timeout_s:g} s")


class BadRequest(HostlinkError):
    """A client's request that makes no sense as it is."""

    def __init__(self, problem: str) -> None:
        super().__init__(problem)
        self.problem = problem


class ReloadRefused(HostlinkError):
    """The configuration cannot be read again, or not now."""


class RecordingFailed(HostlinkError):
    """A recording cannot be written or read."""


class UnknownFormat(RecordingFailed):
    """A recording, or a channel of it, has messages that hostlink cannot convert."""


class RecordingBusy(HostlinkError):
    """The name is in use, the file is being written, or too many recordings are under way."""


class RefusalKind(StrEnum):
    """Why a velocity was refused. Public: REST, rosbridge, client, CLI, events and metrics use these names."""

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
    """A velocity was refused; `kind` says by which rule, `holder` is the source that holds the robot, if any."""

    kind: RefusalKind

    def __init__(self, robot: str, kind: RefusalKind, reason: str, *, holder: Hashable = None) -> None:
        super().__init__(reason)
        self.robot, self.kind, self.reason, self.holder = robot, kind, reason, holder


class Refused(HostlinkError):
    """The daemon has refused a request of the client; `kind` is the daemon's own."""

    def __init__(self, kind: str, reason: str) -> None:
        super().__init__(reason)
        self.kind, self.reason = kind, reason
