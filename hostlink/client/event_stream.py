"""EventStream: bytes of server-sent events in, events out. Pure; a line may be as long as the state of a fleet."""

from collections.abc import Iterator

import msgspec

from hostlink.client.views import Event


class EventStream:
    """What hostlink sends of the format: one `event` line and one `data` line of JSON; comments are skipped."""

    def __init__(self) -> None:
        self._pending = bytearray()
        self._name = ""

    def feed(self, data: bytes) -> Iterator[Event]:
        """The events that are complete with these bytes."""
        self._pending += data
        if b"\n" not in data:
            return
        *lines, self._pending = self._pending.split(b"\n")
        for line in lines:
            key, _, value = bytes(line).partition(b": ")
            if key == b"event":
                self._name = value.decode()
            elif key == b"data":
                yield Event(self._name, msgspec.json.decode(value))
