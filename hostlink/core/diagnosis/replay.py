"""Diagnosis of a recording. Pure."""

import dataclasses
from collections.abc import Callable, Iterable

import msgspec

from hostlink.core.diagnosis.finding import Finding, words
from hostlink.core.diagnosis.link_monitor import SAMPLE_INTERVAL_S, LinkMonitor
from hostlink.core.diagnosis.rules import diagnose
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.events import MessageReceived, TopicsRequested
from hostlink.core.protocol.session import DeviceProtocol
from hostlink.core.runtime.capture_file import Read


class Replay:
    """Diagnosis of one connection of a recording. Times are those of the recording."""

    def __init__(self, protocol: DeviceProtocol, catalog: Catalog, *, now_s: float) -> None:
        self.opened_at_s = self.ended_at_s = now_s
        self._protocol, self._catalog = protocol, catalog
        self._requests_in = protocol.host_reader()
        self._found: dict[str, Finding] = {}
        self._announced: bytes | None = None  # topics announced before the device's first recorded byte
        self._begin(now_s)

    def _begin(self, now_s: float) -> None:
        self.begun_at_s = now_s  # later than opened_at_s if the beginning of the recording is lost
        self.session = self._protocol.session(self._catalog)
        self._monitor = LinkMonitor(self.session, now_s=now_s)
        self._received_at_s = self._sampled_at_s = now_s
        self._requests = 0
        self.session.open(now_s=now_s)

    def add(self, read: Read) -> None:
        """Add one line of the recording."""
        if read.event == "topics":
            self._announced = bytes.fromhex(read.hex)
        elif self._announced is None:
            self._add(read)
        elif read.dir == "device" and read.hex:  # before this line it is unknown whether the device was silent
            announced, self._announced = self._announced, None
            self._begin(read.t)
            self._add(msgspec.structs.replace(read, hex=announced.hex() + read.hex))

    def _add(self, read: Read) -> None:
        while read.t >= self._sampled_at_s + SAMPLE_INTERVAL_S:
            self._sample(self._sampled_at_s + SAMPLE_INTERVAL_S)
        self.ended_at_s = read.t
        if read.dir == "device" and read.hex:
            self._received_at_s = read.t
            for event in self.session.receive(bytes.fromhex(read.hex), now_s=read.t):
                if not isinstance(event, (MessageReceived, TopicsRequested)):
                    self._monitor.observe(event, read.t)
        elif read.hex:
            for _ in range(self._requests_in(bytes.fromhex(read.hex))):
                self._requests += 1  # requests of the recorded host, not of this session
                self._monitor.observe(TopicsRequested("recorded"), read.t)

    def findings(self) -> list[Finding]:
        """Return every fault that was detected at any time, the likeliest cause first."""
        self._sample(self.ended_at_s)
        return [self._found[code] for code in words() if code in self._found]

    def _sample(self, now_s: float) -> None:
        self._sampled_at_s = now_s
        for event in self.session.tick(now_s=now_s):
            if not isinstance(event, TopicsRequested) or event.reason == "no_time_requests":
                self._monitor.observe(event, now_s)
        self._monitor.sample(now_s)
        evidence = self._monitor.evidence(now_s, silent_s=now_s - self._received_at_s)
        self._found |= {each.code: each for each in diagnose(dataclasses.replace(evidence, requests=self._requests))}


def replay(
    reads: Iterable[Read], find_protocol: Callable[[str], DeviceProtocol], catalog: Catalog
) -> dict[int, Replay]:
    """Replay a recording. Return its connections by number. `find_protocol` returns the one of a name in it.

    Raises:
        HostlinkError: as from `find_protocol`.
    """
    connections: dict[int, Replay] = {}
    for read in reads:
        if read.conn not in connections:
            connections[read.conn] = Replay(find_protocol(read.protocol), catalog, now_s=read.t)
        connections[read.conn].add(read)
    return connections
