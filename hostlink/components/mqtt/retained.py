"""Retained messages that the broker should have, and those that it must lose. Pure."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import Final

from hostlink.components.mqtt.discovery import OFFLINE, ONLINE, config_topic, encode_config
from hostlink.components.mqtt.payloads import encode_state
from hostlink.components.mqtt.settings import MqttSettings
from hostlink.components.mqtt.topics import Topics
from hostlink.core.host import RobotState

MAX_EARLIER: Final = 4096  # robots of earlier runs: as many as hostlink knows


@dataclass(frozen=True, slots=True)
class Publication:
    """One retained message; an empty payload removes the one that the broker has."""

    topic: str
    payload: bytes


@dataclass
class Retained:
    """Messages that this run has published, and the robots of earlier runs whose messages the broker still has.

    A robot that hostlink forgets loses its messages at once. A robot of an earlier run becomes `offline` at once, and
    loses them when it has not returned within `forget_after_s`: a restart of hostlink must not remove a device of Home
    Assistant.
    """

    settings: MqttSettings
    topics: Topics
    excess: int = 0
    _published: dict[str, dict[str, bytes]] = field(default_factory=dict)
    _configs: dict[str, tuple[str | None, bytes]] = field(default_factory=dict)
    _earlier: dict[str, float] = field(default_factory=dict)  # robot: when it was found
    _found: list[str] = field(default_factory=list)

    def find(self, robot: str, payload: bytes, *, is_kept: bool, now_s: float) -> None:
        """Note an availability that another program has published: an earlier run, if the broker has kept it.

        A message of ours that another daemon with this prefix has replaced is published again.
        """
        if robot in self._published:
            if self._published[robot].get(self.topics.availability(robot)) != payload:
                self._published[robot].clear()
            return
        if not is_kept:
            self._earlier.pop(robot, None)
            return
        if robot in self._earlier or not payload:
            return
        if len(self._earlier) >= MAX_EARLIER:
            self.excess += 1
            return
        self._earlier[robot] = now_s
        self._found.append(robot)

    def update(self, robot: RobotState) -> Iterator[Publication]:
        """Yield what has changed of a robot since the last call."""
        self._earlier.pop(robot.name, None)
        known = self._published.setdefault(robot.name, {})
        for topic, payload in self._messages(robot):
            if known.get(topic) != payload:
                known[topic] = payload
                yield Publication(topic, payload)

    def remove_others(self, present: Collection[str], *, now_s: float) -> Iterator[Publication]:
        """Yield what removes the messages of robots that hostlink has forgotten."""
        for name in self._published.keys() - present:
            del self._published[name]
            self._configs.pop(name, None)
            yield from self._removal(name)
        yield from self._update_earlier(now_s)

    def _update_earlier(self, now_s: float) -> Iterator[Publication]:
        found, self._found = self._found, []
        for name in found:
            if name in self._earlier:
                yield Publication(self.topics.availability(name), OFFLINE.encode())
        for name, found_s in list(self._earlier.items()):
            if now_s - found_s >= self.settings.forget_after_s:
                del self._earlier[name]
                yield from self._removal(name)

    def _messages(self, robot: RobotState) -> Iterator[tuple[str, bytes]]:
        yield self._config_topic(robot.name), self._config(robot)
        yield self.topics.state(robot.name), encode_state(robot)
        availability = OFFLINE if robot.link is None else ONLINE
        yield self.topics.availability(robot.name), availability.encode()

    def _removal(self, robot: str) -> Iterator[Publication]:
        yield Publication(self._config_topic(robot), b"")
        yield Publication(self.topics.state(robot), b"")
        yield Publication(self.topics.availability(robot), b"")

    def _config(self, robot: RobotState) -> bytes:
        """Return the discovery message. Empty without discovery: it removes the one of an earlier run."""
        if not self.settings.discovery or robot.is_played:
            return b""
        firmware, config = self._configs.get(robot.name, (None, b""))
        if not config or firmware != robot.firmware:
            config = encode_config(self.topics, robot.name, robot.firmware, may_unlock=self.settings.unlock)
            self._configs[robot.name] = robot.firmware, config
        return config

    def _config_topic(self, robot: str) -> str:
        return config_topic(self.settings.discovery_prefix, self.topics, robot)
