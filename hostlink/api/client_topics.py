"""ClientTopics: what one client of rosbridge advertises; several ids may share a topic."""

from collections import defaultdict

from hostlink.api.request import Request
from hostlink.errors import BadRequest
from hostlink.hub.participant import MAX_ADVERTISED, Participant
from hostlink.hub.topic_graph import resolve


class ClientTopics:
    """The ids of advertised topics; a topic is taken back with its last id."""

    def __init__(self, participant: Participant) -> None:
        self._participant = participant
        self._ids: defaultdict[str, set[object]] = defaultdict(set)
        self._latched: set[str] = set()

    def advertise(self, request: Request) -> None:
        """Note a topic.

        Raises:
            BadRequest: nobody knows its type, or there are too many.
            WrongType: the topic is in use with another type.
        """
        name, is_latched = resolve(request.text("topic")), request.is_set("latch")
        type_name = request.text("type")
        if sum(map(len, self._ids.values())) >= MAX_ADVERTISED:
            raise BadRequest(f"more than {MAX_ADVERTISED} topics advertised")
        self._participant.advertise(name, type_name, is_latched=is_latched)
        self._ids[name].add(request.id)
        if is_latched:
            self._latched.add(name)

    def publish(self, request: Request) -> None:
        """A `publish` that names the type advertises its topic, unless that is done; errors as `advertise`."""
        name = resolve(request.text("topic"))
        is_known = name in self._latched or (name in self._ids and not request.is_set("latch"))
        if not is_known and request.fields.get("type"):
            self.advertise(request)

    def unadvertise(self, request: Request) -> None:
        """Take back one id, or without an id the whole topic; one that is not there is no error."""
        name = resolve(request.text("topic"))
        ids = self._ids.get(name, set())
        ids.discard(request.id)
        if ids and request.id is not None:
            return
        self._ids.pop(name, None)
        self._latched.discard(name)
        self._participant.unadvertise(name)
