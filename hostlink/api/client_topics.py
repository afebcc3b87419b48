"""ClientTopics: what one client of rosbridge advertises; several ids may share a topic."""

from collections import defaultdict

from hostlink.api.request import Request
from hostlink.errors import BadRequest
from hostlink.hub.topic_graph import TopicGraph, resolve
from hostlink.messages.catalog import Catalog

MAX_ADVERTISED = 256  # ids of all topics together
MAX_LATCHED = 16  # topics; each keeps a message


class ClientTopics:
    """Advertised topics and their ids; a topic is taken back with its last id."""

    def __init__(self, client: str, topics: TopicGraph, catalog: Catalog) -> None:
        self._client, self._topics, self._catalog = client, topics, catalog
        self._ids: defaultdict[str, set[object]] = defaultdict(set)
        self._latched: set[str] = set()

    @property
    def names(self) -> list[str]:
        """The topics."""
        return list(self._ids)

    def advertise(self, request: Request) -> None:
        """Note a topic; BadRequest for a type that nobody knows, WrongType for one that is not the topic's."""
        name, type_name, is_latched = resolve(request.text("topic")), request.text("type"), request.is_set("latch")
        if self._catalog.message(type_name) is None:
            raise BadRequest(f"unknown type {type_name}; put its .msg into a folder named in message_folders")
        if sum(map(len, self._ids.values())) >= MAX_ADVERTISED:
            raise BadRequest(f"more than {MAX_ADVERTISED} topics advertised")
        if is_latched and len({*self._latched, name}) > MAX_LATCHED:
            raise BadRequest(f"more than {MAX_LATCHED} latched topics")
        self._topics.advertise(name, self._client, type_name=type_name, is_latched=is_latched)
        self._ids[name].add(request.id)
        if is_latched:
            self._latched.add(name)

    def publish(self, request: Request) -> None:
        """A `publish` that names the type advertises its topic, unless that is done."""
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
        self._topics.unadvertise(name, self._client)
