"""Objects that a client creates: participants, topics, readers, writers, services. By binary, XML and reference."""

import re
from collections.abc import Callable, Iterator
from html import unescape
from typing import Final, NamedTuple

from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.xrce.names import NO_TYPE, name_of_reference, service_names, topic_names
from hostlink.core.protocol.xrce.wire import (
    REPLACE,
    REUSE,
    STRING_BYTES_MAX,
    BadField,
    Fields,
    ObjectKind,
    Representation,
    Status,
    Submessage,
    fields_of,
)

NO_OBJECT: Final = 0
OBJECTS_FOR_EACH_ENDPOINT: Final = 4  # topic, publisher, writer; and a participant
_PARENTS: Final[dict[int, int]] = {
    ObjectKind.TOPIC: ObjectKind.PARTICIPANT,
    ObjectKind.PUBLISHER: ObjectKind.PARTICIPANT,
    ObjectKind.SUBSCRIBER: ObjectKind.PARTICIPANT,
    ObjectKind.DATAWRITER: ObjectKind.PUBLISHER,
    ObjectKind.DATAREADER: ObjectKind.SUBSCRIBER,
    ObjectKind.REQUESTER: ObjectKind.PARTICIPANT,
    ObjectKind.REPLIER: ObjectKind.PARTICIPANT,
}
ENDPOINTS: Final[dict[int, tuple[EndpointKind, ...]]] = {
    ObjectKind.DATAWRITER: (EndpointKind.PUBLISHER,),
    ObjectKind.DATAREADER: (EndpointKind.SUBSCRIBER,),
    ObjectKind.REQUESTER: (EndpointKind.SERVICE_CLIENT_PUBLISHER, EndpointKind.SERVICE_CLIENT_SUBSCRIBER),
    ObjectKind.REPLIER: (EndpointKind.SERVICE_SERVER_PUBLISHER, EndpointKind.SERVICE_SERVER_SUBSCRIBER),
}


class XrceObject(NamedTuple):
    """One object of a client. `payload` is its CREATE without the request id.

    `name` is that of the topic or service, or of a participant's node. A reader and a writer in binary form have the id
    of their topic, and its name and type: those of the last topic with this id.
    """

    id: int
    kind: int
    representation: int
    parent: int
    topic: int
    name: str
    type: str
    is_reliable: bool
    payload: bytes


class _Described(NamedTuple):
    name: str = ""
    type: str = ""
    topic: int = NO_OBJECT
    is_reliable: bool = True


def kind_of(object_id: int) -> int:
    """Return the kind of an object."""
    return object_id & 0xF


def decode_object(submessage: Submessage) -> XrceObject | None:
    """Decode a CREATE; None when it is damaged."""
    fields = fields_of(submessage)
    try:
        fields.take(2)  # the request
        object_id, kind, representation = fields.id(), fields.u8(), fields.u8()
        if kind != kind_of(object_id) or kind not in _DECODERS:
            return None
        content = fields.octets(STRING_BYTES_MAX)
        parent = NO_OBJECT
        if kind in _PARENTS:
            parent = fields.id()
        else:
            fields.u16()  # domain of a participant
        described = _describe(kind, representation, content)
    except BadField:
        return None
    if described is None:
        return None
    name, type_, topic, is_reliable = described
    return XrceObject(object_id, kind, representation, parent, topic, name, type_, is_reliable, submessage.payload[2:])


def _describe(kind: int, representation: int, content: bytes) -> _Described | None:
    if representation == Representation.BINARY:
        return _DECODERS[kind](Fields(content))
    text = content.partition(b"\0")[0].decode(errors="replace")
    if representation == Representation.XML:
        return _read_xml(kind, text)
    if representation == Representation.REFERENCE:
        return _Described() if kind == ObjectKind.PARTICIPANT else _Described(name_of_reference(text), NO_TYPE)
    return None


# -- binary -----------------------------------------------------------------------------------------------------------

_IS_RELIABLE: Final = 0x01


def _optional(fields: Fields) -> str:
    return fields.string() if fields.flag() else ""


def _participant(fields: Fields) -> _Described:
    _optional(fields)  # domain
    return _Described(name=_optional(fields))


def _topic(fields: Fields) -> _Described:
    name, reference, type_ = fields.string(), _optional(fields), _optional(fields)
    return _Described(*topic_names(name, type_ or reference))


def _group(fields: Fields) -> _Described:  # noqa: ARG001 - its name and qualities change nothing here
    return _Described()


def _endpoint(fields: Fields) -> _Described:
    topic = fields.id()
    return _Described(topic=topic, is_reliable=not fields.flag() or bool(fields.u16() & _IS_RELIABLE))


def _service(fields: Fields) -> _Described:
    service, request_type = fields.string(), fields.string()
    fields.string()  # type of the responses
    return _Described(*service_names(service, _optional(fields), request_type))


_DECODERS: Final[dict[int, Callable[[Fields], _Described]]] = {
    ObjectKind.PARTICIPANT: _participant,
    ObjectKind.TOPIC: _topic,
    ObjectKind.PUBLISHER: _group,
    ObjectKind.SUBSCRIBER: _group,
    ObjectKind.DATAWRITER: _endpoint,
    ObjectKind.DATAREADER: _endpoint,
    ObjectKind.REQUESTER: _service,
    ObjectKind.REPLIER: _service,
}

# -- XML --------------------------------------------------------------------------------------------------------------

_NAME = re.compile(r"<name>([^<]*)</name>")  # each pattern takes linear time
_TYPE = re.compile(r"<dataType>([^<]*)</dataType>")
_REQUEST_TOPIC = re.compile(r"<request_topic_name>([^<]*)</request_topic_name>")
_ATTRIBUTE = re.compile(r'\b(service_name|request_type)\s*=\s*"([^"]*)"')
_BEST_EFFORT = re.compile(r"<reliability>\s*<kind>\s*BEST_EFFORT")


def _read_xml(kind: int, text: str) -> _Described:
    """Read what matters here. Clients write their XML from one of few templates."""
    if kind in {ObjectKind.REQUESTER, ObjectKind.REPLIER}:
        attributes = {found[1]: unescape(found[2]) for found in _ATTRIBUTE.finditer(text)}
        service, request_type = attributes.get("service_name", ""), attributes.get("request_type", "")
        return _Described(*service_names(service, _first(_REQUEST_TOPIC, text), request_type))
    name = _first(_NAME, text)
    if kind == ObjectKind.PARTICIPANT:
        return _Described(name)
    if kind in {ObjectKind.PUBLISHER, ObjectKind.SUBSCRIBER}:
        return _Described()
    name, type_ = topic_names(name, _first(_TYPE, text))
    return _Described(name, type_, is_reliable=_BEST_EFFORT.search(text) is None)


def _first(pattern: re.Pattern[str], text: str) -> str:
    found = pattern.search(text)
    return "" if found is None else unescape(found[1]).strip()


# -- the objects of one client ----------------------------------------------------------------------------------------


class ObjectTable:
    """Objects of one client by id, up to a bound."""

    __slots__ = ("_created", "_max_endpoints", "_types", "by_id", "refused")

    def __init__(self, max_endpoints: int) -> None:
        self.by_id: dict[int, XrceObject] = {}
        self.refused = 0  # objects above the bound
        self._max_endpoints = max_endpoints
        self._types: dict[str, str] | None = None  # by the name of a topic or service; None: not known since a change
        self._created: set[int] = set()  # ids of what was created since the client began

    def begin_anew(self) -> None:
        """Note that the client has begun anew: none of the objects is known to be of its program."""
        self._created.clear()

    def create(self, new: XrceObject, flags: int) -> int:
        """Create an object as the flags REUSE and REPLACE permit. Return the Status."""
        before = self.by_id.get(new.id)
        if before is not None:
            if flags & REUSE and self.has(new):
                self._created.add(new.id)
                return Status.MATCHED
            if not flags & REPLACE:
                return Status.MISMATCH if flags & REUSE else Status.ALREADY_EXISTS
        if new.kind in _PARENTS and (new.parent not in self.by_id or kind_of(new.parent) != _PARENTS[new.kind]):
            return Status.UNKNOWN_REFERENCE
        if new.topic != NO_OBJECT:
            topic = self.by_id.get(new.topic)
            if topic is None or topic.kind != ObjectKind.TOPIC:
                return Status.UNKNOWN_REFERENCE
            new = new._replace(name=topic.name, type=topic.type, representation=topic.representation)
        if before is None and not self._has_room(new.kind):
            self.refused += 1
            return Status.RESOURCES
        self._types = None
        followers = (
            [each for each in self.by_id.values() if each.topic == new.id] if new.kind == ObjectKind.TOPIC else ()
        )
        if before is None:
            for each in followers:  # a topic is before them, so that they can be created again in this order
                del self.by_id[each.id]
        self.by_id[new.id] = new
        self._created.add(new.id)
        for each in followers:
            self.by_id[each.id] = each._replace(name=new.name, type=new.type, representation=new.representation)
        return Status.OK

    def has(self, new: XrceObject) -> bool:
        """Whether there is exactly this object."""
        before = self.by_id.get(new.id)
        return before is not None and before.payload == new.payload

    def _has_room(self, kind: int) -> bool:
        if kind in ENDPOINTS:
            return sum(1 for _ in self.endpoints()) < self._max_endpoints
        return len(self.by_id) < OBJECTS_FOR_EACH_ENDPOINT * self._max_endpoints

    def delete(self, object_id: int) -> int:
        """Delete an object and those below it. Return the Status."""
        if object_id not in self.by_id:
            return Status.UNKNOWN_REFERENCE
        self._types = None
        gone = {object_id}
        while gone:
            for each in gone:
                self.by_id.pop(each, None)
                self._created.discard(each)
            gone = {each.id for each in self.by_id.values() if each.parent in gone}
        return Status.OK

    def name_and_type(self, endpoint: XrceObject) -> tuple[str, str]:
        """Return the names of an endpoint's topic or service and of its type. A reference tells no type."""
        if endpoint.type != NO_TYPE:
            return endpoint.name, endpoint.type
        if self._types is None:
            typed = [each for each in self.by_id.values() if each.type != NO_TYPE]
            self._types = {each.name: each.type for each in reversed(typed)}  # the first of a name counts
        return endpoint.name, self._types.get(endpoint.name, NO_TYPE)

    def endpoints(self) -> Iterator[XrceObject]:
        """Return readers, writers, requesters and repliers, in the order of their creation."""
        return (each for each in self.by_id.values() if each.kind in ENDPOINTS)

    def current_endpoints(self) -> list[XrceObject]:
        """Return the endpoints without those of a program before that have another one of their name now."""
        created = {(each.kind, each.name) for each in self.endpoints() if each.id in self._created}
        return [each for each in self.endpoints() if each.id in self._created or (each.kind, each.name) not in created]

    def with_parents(self, object_id: int) -> list[XrceObject]:
        """Return an object and those that it needs, the outermost first."""
        found: list[XrceObject] = []
        each = self.by_id.get(object_id)
        while each is not None and each not in found:
            found.insert(0, each)
            if each.topic in self.by_id:
                found.insert(0, self.by_id[each.topic])
            each = self.by_id.get(each.parent)
        participants = [one for one in self.by_id.values() if one.kind == ObjectKind.PARTICIPANT]
        return [*(one for one in participants if one not in found), *found]

    @property
    def kept_bytes(self) -> int:
        """Size of all objects as the client described them."""
        return sum(len(each.payload) for each in self.by_id.values())

    @property
    def has_reliable_writer(self) -> bool:
        """Whether something is published with acknowledgements."""
        return any(each.is_reliable for each in self.by_id.values() if each.kind == ObjectKind.DATAWRITER)

    @property
    def node(self) -> str:
        """Name of the first node, with its namespace if it has one; empty if it is unknown."""
        nodes = (each.name for each in self.by_id.values() if each.kind == ObjectKind.PARTICIPANT and each.name)
        return next(nodes, "")
