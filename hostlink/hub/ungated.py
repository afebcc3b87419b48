"""UngatedVelocities: what drives a device that is no robot here, or a second velocity topic of one. It has a lease.

A board that takes a Twist and tells no pose is common: it has no gate, so no limits, holders or priorities. But what
was commanded to it holds for LEASE_S, as every velocity: whoever vanishes, it hears zero.
"""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass

from hostlink.errors import HostlinkError
from hostlink.hub.isolation import Isolation
from hostlink.link.link import Link
from hostlink.protocol.control import TopicInfo
from hostlink.protocol.frame import Id
from hostlink.robot.directory import VELOCITY_TYPE
from hostlink.robot.velocity_gate import LEASE_S, ZEROS


def is_velocity(info: TopicInfo) -> bool:
    """Whether a device is driven by this topic, as far as type and name tell: a Twist may mean other things."""
    leaf = info.name.rpartition("/")[2].lower()
    return info.kind is Id.SUBSCRIBER and info.type == VELOCITY_TYPE and "vel" in leaf


@dataclass(slots=True)
class _Driven:
    link: Link
    deadline_s: float
    zeros: int = ZEROS  # that are owed after it


class UngatedVelocities:
    """Who is driven without a gate, and until when; bounded by the topics of the live links."""

    def __init__(
        self, zero: bytes, isolation: Isolation, *, check: Callable[[Link], None], on_active: Callable[[], None]
    ) -> None:
        """`check` raises when nobody may drive what this link has; `on_active`: from now on `step` must be called."""
        self._zero, self._isolation = zero, isolation
        self._check, self._on_active = check, on_active
        self._driven: dict[tuple[int, str], _Driven] = {}

    @property
    def is_active(self) -> bool:
        """Whether `step` has something to do, now or later."""
        return bool(self._driven)

    def send(self, link: Link, topic: str, payload: bytes, *, now_s: float) -> None:
        """Send a velocity for the length of a lease; raises what `Session.publish` does, and what `check` does."""
        key = (link.number, topic)
        if payload != self._zero:
            self._check(link)
        link.session.publish(topic, payload, is_urgent=True)
        link.wake()
        if payload == self._zero:
            self._driven.pop(key, None)
        else:
            self._driven[key] = _Driven(link, now_s + LEASE_S)
            self._on_active()

    def stand(self, link: Link, topic: str, *, now_s: float) -> None:
        """Zero at once to a device that nobody drives here, and that may still obey what it heard elsewhere."""
        self._driven[link.number, topic] = _Driven(link, now_s)
        self.step(now_s)
        self._on_active()

    def forget(self, link: Link, topic: str) -> None:
        """The topic has a gate now."""
        self._driven.pop((link.number, topic), None)

    def stop(self, link: Link | None = None, *, now_s: float) -> None:
        """Zero at once, to all or to one device."""
        for driven in self._driven.values():
            if link is None or driven.link is link:
                driven.deadline_s = min(driven.deadline_s, now_s)
        self.step(now_s)

    def step(self, now_s: float) -> None:
        """Send the zeros that are due."""
        for key, driven in list(self._driven.items()):
            if now_s < driven.deadline_s:
                continue
            driven.zeros -= 1
            if driven.zeros <= 0:
                del self._driven[key]
            with self._isolation.around("link"):  # a crash is this link's; the clock of all gates goes on
                self._send_zero(driven.link, key[1])

    def _send_zero(self, link: Link, topic: str) -> None:
        with contextlib.suppress(HostlinkError):  # it has told other topics since
            link.session.publish(topic, self._zero, is_urgent=True)
            link.wake()
