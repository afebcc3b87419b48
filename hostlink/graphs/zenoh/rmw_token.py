"""Tokens: the keys of Zenoh's liveliness that make the graph of ROS 2, one for each node and endpoint. Pure.

A token that somebody else declares is untrusted text: one that is none is None, never an exception.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import xxhash

from hostlink.graphs.zenoh.rmw_names import demangle, from_dds_type, is_name, mangle, to_dds_type
from hostlink.graphs.zenoh.rmw_qos import Qos

SPACE: Final = "@ros2_lv"
TOKEN_CHARS_MAX: Final = 2048  # names of 255 characters, a type and a hash
OWN_ENCLAVE: Final = "/hostlink"  # of every hostlink's nodes: hosts know each other's robots by the fleet, not by ROS 2

_NODE_PARTS: Final = 9
_ENDPOINT_PARTS: Final = 13  # one more where a type has buffers; it is passed over


class Kind(StrEnum):
    """What a token stands for."""

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
        """With its namespace: "/robot_0/driver"."""
        return f"{self.namespace.rstrip('/')}/{self.name}"

    @property
    def is_hostlink(self) -> bool:
        """Whether it is a node of hostlink's, of this host or another."""
        return self.enclave == OWN_ENCLAVE

    def encode(self) -> str:
        """The key."""
        return self.key(Kind.NODE, self.number)

    def key(self, kind: Kind, number: int) -> str:
        """The parts that a node's token and those of its endpoints share."""
        parts = (SPACE, self.domain, self.session, self.number, number, kind.value)
        return "/".join([*map(str, parts), *map(mangle, (self.enclave, self.namespace, self.name))])


@dataclass(frozen=True, slots=True)
class EndpointToken:
    """A publisher, a subscription, or one end of a service; `number` is its own in its process."""

    kind: Kind
    node: NodeToken
    number: int
    name: str  # of the topic or service
    type_name: str  # "std_msgs/msg/String"
    type_hash: str
    qos: Qos

    def encode(self) -> str:
        """The key.

        Raises:
            ValueError: the type name is none of ROS 2.
        """
        parts = (mangle(self.name), to_dds_type(self.type_name), self.type_hash, self.qos.encode())
        return "/".join((self.node.key(self.kind, self.number), *parts))


def parse_token(text: str) -> NodeToken | EndpointToken | None:
    """What a key stands for; None: it is no token, or one that ROS 2 would not declare."""
    parts = text.split("/") if len(text) <= TOKEN_CHARS_MAX else []
    if len(parts) < _NODE_PARTS or parts[0] != SPACE or not all(parts):
        return None
    numbers = [_number(part) for part in (parts[1], parts[3], parts[4])]
    kind = next((kind for kind in Kind if kind.value == parts[5]), None)
    domain, node_number, number = numbers
    if domain is None or node_number is None or number is None or kind is None:
        return None
    enclave, namespace, name = (demangle(part) for part in parts[6:9])
    node = NodeToken(domain, parts[2], node_number, namespace, name, "" if enclave == "/" else enclave)
    if not is_name(node.full_name):
        return None
    return node if kind is Kind.NODE else _parse_endpoint(kind, node, number, parts)


def gid_of(token: str) -> bytes:
    """The 16 bytes by which an endpoint signs what it sends: rmw_zenoh makes them of its token."""
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")


def _parse_endpoint(kind: Kind, node: NodeToken, number: int, parts: list[str]) -> EndpointToken | None:
    if len(parts) < _ENDPOINT_PARTS:
        return None
    name, type_name, qos = demangle(parts[9]), from_dds_type(parts[10]), Qos.decode(parts[12])
    if not is_name(name) or type_name is None or qos is None:
        return None
    return EndpointToken(kind, node, number, name, type_name, parts[11], qos)


def _number(text: str) -> int | None:
    return int(text) if text.isascii() and text.isdigit() and len(text) <= 20 else None  # noqa: PLR2004 - a uint64's digits
