"""GuardedWorld: a virtual micro-ROS board whose host is killed or hangs, with the guardian's code in virtual time."""

from typing import Any

from hostlink.core.guardian.frames import StopWriter
from hostlink.core.guardian.process import END_S
from hostlink.core.protocol.xrce.acknowledging import Acknowledger
from hostlink.core.runtime.stop_frames import StopFrames
from tests.support.xrce_board import World

PART_BYTES = 1024


class GuardedWorld(World):
    """World of which the guardian has a duplicate of the connection, as `GuardedConnection` has it."""

    def __init__(self, *given: Any, **named: Any) -> None:
        self._writer: StopWriter | None = None
        self._acknowledger: Acknowledger | None = None
        self._killed_s = 0.0
        self._unread: list[bytes] = []  # while the host hangs
        self._is_hung = False
        super().__init__(*given, **named)

    def stop_frames(self, topic: str = "/cmd_vel", payload: bytes = bytes(48)) -> StopFrames:
        """Return what the hub gives the guardian for this topic."""
        endpoint = self.session.endpoint_of(topic, payload)
        return self.session.stop_frames(self.session.zero_frames(endpoint, payload))

    def kill(self, stop: StopFrames, *, noticed_s: float = 0.002) -> None:
        """End the host in the middle of anything. The guardian notices that after a while."""
        self.is_host_there = False
        self._killed_s = self.now_s

        def begin() -> None:
            module, _, framing = stop.acknowledger.partition(":")
            assert module == Acknowledger.__module__
            self._acknowledger = Acknowledger(framing)
            self._guard(StopWriter(stop, part_bytes=PART_BYTES))
            unread, self._unread = self._unread, []
            for each in unread:
                self._to_host(each)

        self.at(self.now_s + noticed_s, begin)

    def hang(self, stop: StopFrames, seconds: float, *, hang_s: float = 1.0) -> None:
        """Stop the host for a time: what arrives waits. The guardian writes zeros, and answers what waits."""
        self.is_host_there, self._is_hung = False, True

        def begin() -> None:
            if self._is_hung:
                self._acknowledger = Acknowledger(stop.acknowledger.partition(":")[2])
                writer = StopWriter(stop, has_end=False, part_bytes=PART_BYTES)
                self._guard(writer)
                for each in self._unread:  # which stay for the host
                    self._answer(each)
                self.at(self.now_s + END_S, lambda: self._forget(writer))

        def end() -> None:
            self.is_host_there, self._is_hung, self._writer = True, False, None
            unread, self._unread = self._unread, []
            for each in unread:
                self._to_host(each)

        self.at(self.now_s + hang_s, begin)
        self.at(self.now_s + seconds, end)

    def _guard(self, writer: StopWriter) -> None:
        self._writer = writer

        def step() -> None:
            if self._writer is writer:
                self._write()
                next_s = writer.next_s()
                if next_s is not None:
                    self.at(self._killed_s + next_s, step)

        self._killed_s = self.now_s
        step()

    def _write(self) -> None:
        writer = self._writer
        while writer is not None and (data := writer.pop_due(self.now_s - self._killed_s + 1e-9)):
            writer.written(len(data))
            for at_s in self.link.arrivals(self.now_s, to_board=True):
                self.at(at_s, lambda data=data: self._to_board(data))  # type: ignore[misc]

    def _to_host(self, message: bytes) -> None:
        if self.is_host_there:
            super()._to_host(message)
            return
        if self._is_hung or self._writer is None:
            self._unread.append(message)
        self._answer(message)

    def _answer(self, message: bytes) -> None:
        if self._writer is not None and self._acknowledger is not None:
            self._writer.answer(self._acknowledger.receive(message))
            self._write()

    def _forget(self, writer: StopWriter) -> None:
        if self._writer is writer:
            self._writer = None
