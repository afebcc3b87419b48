"""Every error that hostlink raises on purpose, with its numbers as attributes."""

import itertools
import shlex
from collections.abc import Iterable
from typing import Self


class HostlinkError(Exception):
    """Base of all: a caller requested what cannot be done. The text names the next step."""


class ConfigError(HostlinkError):
    """A setting is wrong; raised once, at the start."""

    def __init__(self, where: str, problem: str) -> None:
        super().__init__(f"{where}: {problem}")
        self.where, self.problem = where, problem


class UnknownTopic(HostlinkError):
    """No topic, service or robot of that name."""

    def __init__(self, kind: str, name: str, known: Iterable[str] = ()) -> None:
        """The text names some of those that are known: devices may announce any number of them."""
        self.kind, self.name, self.known = kind, name, tuple(itertools.islice(known, 64))
        hint = f"; known: {', '.join(sorted(self.known)[:8])}" if self.known else ""
        super().__init__(f"no {kind} named {name}{hint}")


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


class RecordingBusy(HostlinkError):
    """The name is in use, the file is being written, or too many recordings are under way."""


class RobotHeld(HostlinkError):
    """Somebody with a higher priority drives the robot, or it is locked."""

    def __init__(self, robot: str, owner: str | None, *, lock_reason: str | None = None) -> None:
        why = (
            f"{owner} drives it with a higher priority"
            if lock_reason is None
            else f"locked: {lock_reason}; to drive it again: hostlink unlock {shlex.quote(robot)}"
        )
        super().__init__(f"{robot}: {why}")
        self.robot, self.owner, self.lock_reason = robot, owner, lock_reason
