"""TopicTable: endpoints that one device announced, by `TopicInfo.key`. Each negotiation replaces the one before it."""

from collections import Counter
from collections.abc import Container

from hostlink.core.protocol.endpoint import IS_TO_DEVICE, DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.frame import FIRST_TOPIC_ID

MAX_MISSED = 3  # negotiations: two more topic requests
MAX_TOPICS = 256  # ten times what rosserial's own library allows by default


class TopicTable:
    """Endpoints of the last complete negotiation, and those that the current one has announced so far.

    A negotiation that lacks an endpoint, and gives no id or name another meaning, has most likely lost a TopicInfo. The
    missing endpoint is kept until MAX_MISSED negotiations in a row lack it. Otherwise a robot whose velocity topic was
    lost could not be stopped, and one whose odometry was lost would stop.

    Keys are those of `TopicInfo.key`, because ids are per direction: a frame's id is the key of what the device sends.

    `fixed_bytes` is a live view for the FrameStream: key -> the only payload size that its type can have. `excess`
    counts the endpoints of the current negotiation that exceed `max_topics` and were not added.
    """

    __slots__ = (
        "_announced", "_complete", "_missed", "_missed_before", "_redefined", "by_key", "by_name", "excess",
        "fixed_bytes", "max_topics",
    )  # fmt: skip

    def __init__(self, max_topics: int = MAX_TOPICS) -> None:
        self.by_key: dict[int, DeviceEndpoint] = {}  # announced so far, and those of the negotiation before
        self.fixed_bytes: dict[int, int] = {}
        self.max_topics = max_topics
        self.excess = 0
        self.by_name: dict[tuple[str, int], DeviceEndpoint] = {}  # the same endpoints, by name and kind
        self._announced: dict[int, DeviceEndpoint] = {}  # by the current negotiation
        self._complete: dict[int, DeviceEndpoint] = {}  # result of the negotiation before it
        self._redefined: dict[int, None] = {}  # keys to which the current negotiation gave another meaning
        self._missed: Counter[int] = Counter()  # negotiations in a row that lacked the key
        self._missed_before = self._missed  # without the current negotiation, which may be finished in several parts

    def begin(self) -> None:
        """Begin a negotiation, in which the device announces all of its endpoints again."""
        self.excess = 0
        self._announced, self._complete, self._missed_before = {}, dict(self.by_key), self._missed
        self._redefined.clear()

    def has_announced(self, key: int) -> bool:
        """Whether the last negotiation announced this key."""
        return key in self._announced

    @property
    def is_partial(self) -> bool:
        """Whether the current negotiation has announced fewer endpoints than the one before, and contradicted none."""
        return not self._redefined and len(self._announced) < len(self._complete)

    @property
    def is_altered(self) -> bool:
        """Whether the current negotiation gave a key another meaning than the one before: a new program, or damage."""
        return any(self._complete.get(key, info) != info for key, info in self._announced.items())

    def add(self, info: DeviceEndpoint, fixed_bytes: int | None) -> None:
        """Add one TopicInfo of the current negotiation. Call it only if there `is_room`."""
        key = info.key
        before = self.by_key.get(key)
        if before is not None and self.by_name.get((before.name, before.kind)) == before:
            del self.by_name[before.name, before.kind]
        self._announced[key] = self.by_key[key] = info
        known = self.by_name.get((info.name, info.kind))
        complete = self._complete.get(key, info if known is None or known == info else known)
        if complete == info:
            self._redefined.pop(key, None)
        else:
            self._redefined[key] = None
        if known is None or self._announced.get(known.key) != known:  # first endpoint gets the name
            self.by_name[info.name, info.kind] = info
        if fixed_bytes is None:
            self.fixed_bytes.pop(key, None)
        else:
            self.fixed_bytes[key] = fixed_bytes

    def is_room(self, key: int) -> bool:
        """Whether one more TopicInfo of the current negotiation can be added."""
        return self.has_announced(key) or len(self._announced) < self.max_topics

    def finish(self, *, refused: Container[int] = ()) -> None:
        """End the negotiation.

        Remove endpoints that it lacks, unless they are kept for now; `refused` ones are not kept.
        """
        is_room = len(self._complete.keys() | self._announced.keys()) <= self.max_topics
        lacked = self._complete.keys() - self._announced.keys() if is_room and not self._redefined else ()
        self._missed = Counter({each: self._missed_before[each] + 1 for each in lacked if each not in refused})
        kept = {each: self._complete[each] for each in self.missing}
        for gone in self.by_key.keys() - self._announced.keys() - kept.keys():
            self.fixed_bytes.pop(gone, None)
        self.by_key = kept | self._announced
        self.by_name = {(info.name, info.kind): info for info in reversed(self.by_key.values())}

    @property
    def missing(self) -> tuple[int, ...]:
        """Keys that the last negotiation lacked and that are kept for now."""
        return tuple(each for each, count in self._missed.items() if count < MAX_MISSED)

    def response_to(self, request: DeviceEndpoint) -> DeviceEndpoint | None:
        """Return the endpoint that receives the responses to requests of this endpoint.

        A device may have several clients of one service. It numbers their request and response endpoints in the same
        order.
        """
        mine = [info for info in self.all() if info.name == request.name]
        requests = [info.id for info in mine if info.kind is EndpointKind.SERVICE_CLIENT_PUBLISHER]
        responses = [info for info in mine if info.kind is EndpointKind.SERVICE_CLIENT_SUBSCRIBER]
        place = requests.index(request.id) if request.id in requests else len(responses)
        return responses[place] if place < len(responses) else None

    def all(self) -> tuple[DeviceEndpoint, ...]:
        """Return every endpoint, ordered by id."""
        return tuple(sorted(self.by_key.values(), key=lambda info: (info.id, not info.is_to_device)))

    def gap(self) -> int | None:
        """Return the lowest missing id, which means that a TopicInfo was lost; None if no id is missing.

        A device numbers what it receives from 100, and what it sends from a higher number that depends on its build,
        both without gaps. A loss of the first endpoint that it sends on cannot be noticed here.
        """
        to_device = [info.id for info in self._announced.values() if info.kind in IS_TO_DEVICE]
        from_device = [info.id for info in self._announced.values() if info.kind not in IS_TO_DEVICE]
        missing = _missing(to_device, FIRST_TOPIC_ID)
        return missing if missing is not None else _missing(from_device, min(from_device, default=0))

    def largest_from_device_bytes(self) -> int:
        """Size of the largest buffer from which the device sends; 0 when none is known."""
        return max((info.buffer_bytes for info in self.by_key.values() if info.kind not in IS_TO_DEVICE), default=0)


def _missing(ids: list[int], first: int) -> int | None:
    known = set(ids)
    return next((topic_id for topic_id in range(first, max(known, default=first)) if topic_id not in known), None)
