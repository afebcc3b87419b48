"""TopicTable: what one device announced, by id; one negotiation replaces the one before it."""

from collections import Counter
from collections.abc import Container

from hostlink.protocol.control import IS_TO_DEVICE, TopicInfo
from hostlink.protocol.frame import FIRST_TOPIC_ID, Id

MAX_MISSED = 3  # negotiations, so two more requests for topics
MAX_TOPICS = 256  # ten times what rosserial's own library allows by default


class TopicTable:
    """The topics of the last complete negotiation, and those that the present one has announced so far.

    One that lacks what was announced before, and gives no id or name another meaning, has most likely lost a TopicInfo
    on the way: what it lacks stays until MAX_MISSED negotiations in a row lack it. A robot whose velocity topic went
    at once could not be stopped any more; one whose odometry went would stop.

    `fixed_bytes` is a live view for the FrameStream: id -> the only payload size that its type can have. What is over
    `max_topics` is not added: `excess` counts it, in the present negotiation.
    """

    __slots__ = (
        "_announced", "_by_name", "_complete", "_missed", "_missed_before", "_others", "_topics", "excess",
        "fixed_bytes", "max_topics",
    )  # fmt: skip

    def __init__(self, max_topics: int = MAX_TOPICS) -> None:
        self.fixed_bytes: dict[int, int] = {}
        self.max_topics = max_topics
        self.excess = 0
        self._by_name: dict[tuple[str, int], TopicInfo] = {}
        self._announced: dict[int, TopicInfo] = {}  # by the present negotiation
        self._complete: dict[int, TopicInfo] = {}  # what the negotiation before it left
        self._others: set[int] = set()  # announced by the present one, with another meaning than before
        self._missed: Counter[int] = Counter()  # negotiations in a row that lacked an id
        self._missed_before = self._missed  # without the present one, which may be finished in several parts
        self._topics: dict[int, TopicInfo] = {}  # announced so far, then those of the negotiation before

    def begin(self) -> None:
        """A new negotiation: the device announces all of its topics again."""
        self.excess = 0
        self._announced, self._complete, self._missed_before = {}, dict(self._topics), self._missed
        self._others.clear()

    def has_announced(self, topic_id: int) -> bool:
        """Whether the last negotiation had this id."""
        return topic_id in self._announced

    @property
    def is_partial(self) -> bool:
        """Whether the present negotiation has announced less than was announced before, and nothing against it."""
        return not self._others and len(self._announced) < len(self._complete)

    def add(self, info: TopicInfo, fixed_bytes: int | None) -> None:
        """Add one TopicInfo of the present negotiation, for which there `is_room`."""
        before = self._topics.get(info.topic_id)
        if before is not None and self._by_name.get((before.name, before.kind)) == before:
            del self._by_name[before.name, before.kind]
        self._announced[info.topic_id] = self._topics[info.topic_id] = info
        known = self._by_name.get((info.name, info.kind))
        complete = self._complete.get(info.topic_id, info if known is None or known == info else known)
        (self._others.discard if complete == info else self._others.add)(info.topic_id)
        if known is None or self._announced.get(known.topic_id) != known:  # the first of a negotiation has the name
            self._by_name[info.name, info.kind] = info
        if fixed_bytes is None:
            self.fixed_bytes.pop(info.topic_id, None)
        else:
            self.fixed_bytes[info.topic_id] = fixed_bytes

    def is_room(self, topic_id: int) -> bool:
        """Whether one more TopicInfo of the present negotiation can be added."""
        return self.has_announced(topic_id) or len(self._announced) < self.max_topics

    def finish(self, *, refused: Container[int] = ()) -> None:
        """The device has announced all: what is not among it is gone, or lost for now; `refused` is never used."""
        is_room = len(self._complete.keys() | self._announced.keys()) <= self.max_topics
        lacked = self._complete.keys() - self._announced.keys() if is_room and not self._others else ()
        self._missed = Counter({each: self._missed_before[each] + 1 for each in lacked if each not in refused})
        kept = {each: self._complete[each] for each in self.missing}
        for gone in self._topics.keys() - self._announced.keys() - kept.keys():
            self.fixed_bytes.pop(gone, None)
        self._topics = kept | self._announced
        self._by_name = {(info.name, info.kind): info for info in reversed(self._topics.values())}

    @property
    def missing(self) -> tuple[int, ...]:
        """Ids that the last negotiation lacked, and that are kept for now."""
        return tuple(each for each, count in self._missed.items() if count < MAX_MISSED)

    def get(self, topic_id: int) -> TopicInfo | None:
        """What the device announced under this id."""
        return self._topics.get(topic_id)

    def find(self, name: str, kind: int) -> TopicInfo | None:
        """The endpoint of that name and kind."""
        return self._by_name.get((name, kind))

    def response_to(self, request: TopicInfo) -> TopicInfo | None:
        """Where responses to the requests of this endpoint go. A device may have several clients of one service; it
        numbers both ends of each in one order."""
        mine = [info for info in self.all() if info.name == request.name]
        requests = [info.topic_id for info in mine if info.kind is Id.SERVICE_CLIENT_PUBLISHER]
        responses = [info for info in mine if info.kind is Id.SERVICE_CLIENT_SUBSCRIBER]
        place = requests.index(request.topic_id) if request.topic_id in requests else len(responses)
        return responses[place] if place < len(responses) else None

    def all(self) -> tuple[TopicInfo, ...]:
        """Every endpoint, in the order of the ids."""
        return tuple(self._topics[topic_id] for topic_id in sorted(self._topics))

    def gap(self) -> int | None:
        """The lowest id that is missing, which means that a TopicInfo was lost.

        A device numbers what it receives from 100, what it sends from a higher number that depends on its build, both
        without gaps: so the first of what it sends cannot be missed here.
        """
        to_device = [info.topic_id for info in self._announced.values() if info.kind in IS_TO_DEVICE]
        from_device = [info.topic_id for info in self._announced.values() if info.kind not in IS_TO_DEVICE]
        missing = _missing(to_device, FIRST_TOPIC_ID)
        return missing if missing is not None else _missing(from_device, min(from_device, default=0))

    def largest_from_device_bytes(self) -> int:
        """The largest buffer from which the device sends; 0 when none is known."""
        return max((info.buffer_bytes for info in self._topics.values() if info.kind not in IS_TO_DEVICE), default=0)


def _missing(ids: list[int], first: int) -> int | None:
    known = set(ids)
    return next((topic_id for topic_id in range(first, max(known, default=first)) if topic_id not in known), None)
