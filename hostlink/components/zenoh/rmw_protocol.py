"""The protocol of rmw_zenoh: names, keys, qualities of service, signatures, tokens, and the graph that they form. Pure.

The formats are those of docs/ros2-zenoh-wire.md#on-the-wire. Declarations of other programs are untrusted text:
unreadable text gives None, never an exception.
"""

import re
import struct
from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, NamedTuple

import xxhash

from hostlink.components.graphs.ros2_qos import Qos
from hostlink.core.messages.ros2_names import from_dds_type, is_ros2_name, to_dds_type
from hostlink.core.robot.admission import LEASE_S, Freshness
from hostlink.core.runtime.units import NS_PER_S

DEFAULT_DEPTH: Final = 42
DEPTH_MAX: Final = 1_000_000
_BEST_EFFORT, _TRANSIENT_LOCAL, _KEEP_ALL = "2", "1", "2"  # the numbers of rmw/types.h
_QOS: Final = re.compile(r"([0-9]*):([0-9]*):([0-9]*),?([0-9]{0,9})[0-9]*:[^:]*:[^:]*:")
_INFINITE: Final = ":,:,:,,"  # deadline, lifespan, liveliness: automatic

GID_BYTES: Final = 16
_LAYOUT: Final = struct.Struct("<qqB16s")

SPACE: Final = "@ros2_lv"
TOKEN_CHARS_MAX: Final = 2048  # names of 255 characters, a type and a hash
OWN_ENCLAVE: Final = "/hostlink"  # of every hostlink's nodes: hosts know each other's robots by the fleet, not by ROS 2

_NODE_PARTS: Final = 9
_ENDPOINT_PARTS: Final = 13  # one more where a type has buffers; it is passed over

LATCHED: Final = Qos(is_latched=True, depth=1)

MAX_TOKENS: Final = 8192
MAX_TOKENS_OF_SESSION: Final = 2048  # of one process; a node of ROS 2 has ten or more


# -- names ------------------------------------------------------------------------------------------------------------


def is_hidden(name: str) -> bool:
    """Whether a part of it begins with an underscore, as those of actions do; the tools of ROS 2 do not list it."""
    return "/_" in name


def mangle(name: str) -> str:
    """One part of a key for a name with slashes; Zenoh splits keys at them. Nothing and "/" become "%"."""
    return name.replace("/", "%") or "%"


def demangle(part: str) -> str:
    """Return the name that `mangle` has changed."""
    return part.replace("%", "/")


def data_key(domain: int, name: str, type_name: str, type_hash: str) -> str:
    """The key on which the messages of a topic, or the requests of a service, are sent.

    Raises:
        ValueError: `type_name` is not a type name of ROS 2.
    """
    return f"{domain}/{name.strip('/')}/{to_dds_type(type_name)}/{type_hash}"


# -- quality of service -----------------------------------------------------------------------------------------------


def encode_qos(qos: Qos) -> str:
    """Return the text in a token."""
    reliability = "" if qos.is_reliable else _BEST_EFFORT
    durability = _TRANSIENT_LOCAL if qos.is_latched else ""
    kind = _KEEP_ALL if qos.depth is None else ""
    depth = "" if qos.depth in (None, DEFAULT_DEPTH) else qos.depth
    return f"{reliability}:{durability}:{kind},{depth}{_INFINITE}"


def decode_qos(text: str) -> Qos | None:
    """Decode the text in a token; None if it is malformed."""
    found = _QOS.match(text)
    if found is None:
        return None
    reliability, durability, kind, depth = found.groups()
    return Qos(
        is_reliable=reliability != _BEST_EFFORT,
        is_latched=durability == _TRANSIENT_LOCAL,
        depth=None if kind == _KEEP_ALL else min(int(depth or 0), DEPTH_MAX) or DEFAULT_DEPTH,
    )


# -- signatures -------------------------------------------------------------------------------------------------------


class Attachment(NamedTuple):
    """`gid` names the endpoint that sent it; an answer repeats number and gid of its request."""

    sequence_number: int
    source_ns: int  # wall time of the sender
    gid: bytes

    def encode(self) -> bytes:
        """Return the 33 bytes."""
        return _LAYOUT.pack(self.sequence_number, self.source_ns, GID_BYTES, self.gid)

    @classmethod
    def decode(cls, data: bytes) -> "Attachment | None":
        """Decode an attachment; None if it is malformed, as that of rmw_zenoh before April 2025."""
        if len(data) != _LAYOUT.size:
            return None
        sequence_number, source_ns, gid_bytes, gid = _LAYOUT.unpack(data)
        return cls(sequence_number, source_ns, gid) if gid_bytes == GID_BYTES else None


# -- tokens -----------------------------------------------------------------------------------------------------------


class TokenKind(StrEnum):
    """Kind of a token."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVER = "SS"
    CLIENT = "SC"


@dataclass(frozen=True, slots=True)
class NodeToken:
    """A node: `session` is Zenoh's id of the process, `number` the node's in it."""

    domain: int
    session: str
    number: int
    namespace: str
    name: str
    enclave: str = ""

    @property
    def full_name(self) -> str:
        """Name of the node with its namespace, as "/robot_0/driver"."""
        return f"{self.namespace.rstrip('/')}/{self.name}"

    @property
    def is_hostlink(self) -> bool:
        """Whether it is a node of hostlink's, of this host or another."""
        return self.enclave == OWN_ENCLAVE

    def encode(self) -> str:
        """Return the token's key."""
        return self.key(TokenKind.NODE, self.number)

    def key(self, kind: TokenKind, number: int) -> str:
        """The parts that a node's token and those of its endpoints share."""
        parts = (SPACE, self.domain, self.session, self.number, number, kind.value)
        return "/".join([*map(str, parts), *map(mangle, (self.enclave, self.namespace, self.name))])


@dataclass(frozen=True, slots=True)
class EndpointToken:
    """A publisher, a subscription, or one end of a service; `number` is its own in its process."""

    kind: TokenKind
    node: NodeToken
    number: int
    name: str  # of the topic or service
    type_name: str  # "std_msgs/msg/String"
    type_hash: str
    qos: Qos

    def encode(self) -> str:
        """Return the key.

        Raises:
            ValueError: the type name is not one of ROS 2.
        """
        parts = (mangle(self.name), to_dds_type(self.type_name), self.type_hash, encode_qos(self.qos))
        return "/".join((self.node.key(self.kind, self.number), *parts))


def parse_token(text: str) -> NodeToken | EndpointToken | None:
    """Parse a token; None for a malformed one, or one that ROS 2 would not declare."""
    parts = text.split("/") if len(text) <= TOKEN_CHARS_MAX else []
    if len(parts) < _NODE_PARTS or parts[0] != SPACE or not all(parts):
        return None
    numbers = [_number(part) for part in (parts[1], parts[3], parts[4])]
    kind = next((kind for kind in TokenKind if kind.value == parts[5]), None)
    domain, node_number, number = numbers
    if domain is None or node_number is None or number is None or kind is None:
        return None
    enclave, namespace, name = (demangle(part) for part in parts[6:9])
    node = NodeToken(domain, parts[2], node_number, namespace, name, "" if enclave == "/" else enclave)
    if not is_ros2_name(node.full_name):
        return None
    return node if kind is TokenKind.NODE else _parse_endpoint(kind, node, number, parts)


def gid_of(token: str) -> bytes:
    """The 16 bytes by which an endpoint signs what it sends: rmw_zenoh makes them of its token."""
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")


def _parse_endpoint(kind: TokenKind, node: NodeToken, number: int, parts: list[str]) -> EndpointToken | None:
    if len(parts) < _ENDPOINT_PARTS:
        return None
    name, type_name, qos = demangle(parts[9]), from_dds_type(parts[10]), decode_qos(parts[12])
    if not is_ros2_name(name) or type_name is None or qos is None:
        return None
    return EndpointToken(kind, node, number, name, type_name, parts[11], qos)


def _number(text: str) -> int | None:
    return int(text) if text.isascii() and text.isdigit() and len(text) <= 20 else None  # noqa: PLR2004 - a uint64's digits


Subject = tuple[str, str]  # of messages: the topic, and its type


@dataclass(slots=True)
class RemotePublisher:
    """A publisher and its token; `drawn_gid`: by which it signs, if not by that of its token."""

    token: EndpointToken
    key: str
    gid: bytes
    drawn_gid: bytes | None = None
    has_signed: bool = False  # by the gid of its token

    @property
    def subject(self) -> Subject:
        return self.token.name, self.token.type_name


@dataclass(frozen=True, slots=True)
class Removed:
    """A token that is gone. `unsure`: publishers who drew their gids, any of whom may be the one that is gone."""

    token: NodeToken | EndpointToken
    publisher: RemotePublisher | None = None
    unsure: tuple[RemotePublisher, ...] = ()


@dataclass(slots=True)
class RemoteGraph:
    """Tokens of one domain, without those of hostlink's own nodes. `counts`: `malformed_tokens`, `crowded_tokens`."""

    domain: int
    counts: Counter[str]
    _tokens: dict[str, NodeToken | EndpointToken] = field(default_factory=dict)
    _of_session: Counter[str] = field(default_factory=Counter)
    _by_gid: dict[bytes, RemotePublisher] = field(default_factory=dict)
    _of_subject: dict[Subject, dict[str, RemotePublisher]] = field(default_factory=dict)

    def add(self, key: str) -> NodeToken | EndpointToken | None:
        """A token has come; None: it is known, no token of this graph, or one too many."""
        if key in self._tokens:
            return None
        token = parse_token(key)
        node = token.node if isinstance(token, EndpointToken) else token
        if token is None or node is None or node.domain != self.domain:
            self.counts["malformed_tokens"] += 1
            return None
        if node.is_hostlink:
            return None
        if len(self._tokens) >= MAX_TOKENS or self._of_session[node.session] >= MAX_TOKENS_OF_SESSION:
            self.counts["crowded_tokens"] += 1
            return None
        self._tokens[key] = token
        self._of_session[node.session] += 1
        if isinstance(token, EndpointToken) and token.kind is TokenKind.PUBLISHER:
            publisher = RemotePublisher(token, key, gid_of(key))
            mistaken = self._by_gid.get(publisher.gid)
            if mistaken is not None:  # it signed before its token came, and passed for one that draws its gids
                self._free(mistaken)
            self._by_gid[publisher.gid] = publisher
            self._of_subject.setdefault(publisher.subject, {})[key] = publisher
        return token

    def remove(self, key: str) -> Removed | None:
        """A token has gone; None: it was not known."""
        token = self._tokens.pop(key, None)
        if token is None:
            return None
        session = token.node.session if isinstance(token, EndpointToken) else token.session
        self._of_session[session] -= 1
        if not self._of_session[session]:
            del self._of_session[session]
        if not isinstance(token, EndpointToken) or token.kind is not TokenKind.PUBLISHER:
            return Removed(token)
        publisher = self._by_gid[gid_of(key)]
        self._forget(publisher)
        return Removed(token, publisher, self._unbind(publisher))

    def publisher(self, gid: bytes, subject: Subject) -> RemotePublisher | None:
        """Return the publisher that signed a message of this subject; None if it is unknown."""
        found = self._by_gid.get(gid)
        if found is not None and found.subject == subject:
            if gid == found.gid and not found.has_signed:
                found.has_signed = True
                self._free(found)
            return found
        return None if found is not None else self._bind(gid, subject)

    def is_known(self, gid: bytes) -> bool:
        """Whether it is the gid of a token, or bound to one."""
        return gid in self._by_gid

    def publishers(self, subject: Subject) -> list[RemotePublisher]:
        """Return all publishers of a subject."""
        return list(self._of_subject.get(subject, {}).values())

    def _bind(self, gid: bytes, subject: Subject) -> RemotePublisher | None:
        """Bind a drawn gid to a publisher that has signed nothing."""
        for publisher in self._of_subject.get(subject, {}).values():
            if not publisher.has_signed and publisher.drawn_gid is None:
                publisher.drawn_gid = gid
                self._by_gid[gid] = publisher
                return publisher
        return None

    def _unbind(self, gone: RemotePublisher) -> tuple[RemotePublisher, ...]:
        """Return the publishers with drawn gids that may be the one that is gone, unless it signed by its token's."""
        if gone.has_signed:
            return ()
        unsure = tuple(each for each in self.publishers(gone.subject) if each.drawn_gid is not None)
        for each in unsure:
            self._free(each)
        return unsure

    def _free(self, publisher: RemotePublisher) -> None:
        if publisher.drawn_gid is not None:
            self._by_gid.pop(publisher.drawn_gid, None)
            publisher.drawn_gid = None

    def _forget(self, publisher: RemotePublisher) -> None:
        self._free(publisher)
        del self._by_gid[publisher.gid]
        of_subject = self._of_subject[publisher.subject]
        del of_subject[publisher.key]
        if not of_subject:
            del self._of_subject[publisher.subject]


class SourceClock:
    """Delay of a publisher's messages, by the wall clock of their sender.

    A clock that is set back causes no delay: a message that waits never has an earlier time. After a lease in which
    messages were lost, a message may be as old as the lost ones: its publisher was not silent.
    """

    def __init__(self) -> None:
        self._freshness = Freshness()
        self._newest = (0, 0)  # number and time of the newest message

    def late_s(self, sequence_number: int, source_ns: int, now_s: float) -> float:
        """Seconds that a message waited longer on its way than the quickest before it."""
        number, time_ns = self._newest
        gap_s = (source_ns - time_ns) / NS_PER_S if 0 < number < sequence_number - 1 else 0.0
        if sequence_number > number and source_ns < time_ns:
            self._freshness = Freshness()
        self._newest = max(self._newest, (sequence_number, source_ns))
        late_s = self._freshness.late_s(source_ns / NS_PER_S, now_s)
        return late_s if gap_s < LEASE_S else max(late_s, gap_s)
