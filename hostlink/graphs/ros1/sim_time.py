"""SimTime: the time of /clock for devices, while /use_sim_time is true."""

import time

from hostlink.hub.hub import Hub
from hostlink.hub.message import Message
from hostlink.hub.participant import Participant
from hostlink.messages.catalog import CLOCK, CLOCK_TYPE, decode_clock


class SimTime:
    """Subscribes to /clock as a program of the hub does, so that it comes from wherever it is published."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._participant: Participant | None = None
        self._now_ns = 0  # as every node of ROS has it before the first message

    def update(self, *, is_wanted: bool) -> None:
        """Begin or end, if that is a change."""
        if is_wanted == (self._participant is not None):
            return
        if self._participant is not None:
            self._participant.leave()
            self._participant = None
            self._hub.links.wall_ns = time.time_ns
            return
        self._now_ns = 0
        self._participant = self._hub.join("ros1 clock")
        self._participant.subscribe(CLOCK, self._receive, type_name=CLOCK_TYPE)
        self._hub.links.wall_ns = self._read_ns

    def _read_ns(self) -> int:
        return self._now_ns

    def _receive(self, message: Message) -> None:
        now_ns = decode_clock(message.payload)
        if now_ns is not None:
            self._now_ns = now_ns
