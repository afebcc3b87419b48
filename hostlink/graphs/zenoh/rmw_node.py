"""RmwNode: this daemon as a node of ROS 2; makes the tokens of its endpoints, and knows its types."""

import itertools
import time
from collections import Counter
from dataclasses import dataclass, field

from hostlink.graphs.ros2_types import Ros2Types
from hostlink.graphs.zenoh.rmw_attachment import Attachment
from hostlink.graphs.zenoh.rmw_names import data_key
from hostlink.graphs.zenoh.rmw_qos import Qos
from hostlink.graphs.zenoh.rmw_token import EndpointToken, Kind, NodeToken, gid_of
from hostlink.graphs.zenoh.session import Declaration, Session
from hostlink.hub.hub import Hub

GROUP = "rmw_zenoh"  # of all participants that stand for this graph


class Endpoint:
    """One end of a topic or service in ROS 2: its token, and the gid by which it signs."""

    def __init__(self, session: Session, token: EndpointToken, key: str) -> None:
        """`key`: of its data."""
        text = token.encode()
        self.key, self.gid = key, gid_of(text)
        self._numbers = itertools.count(1)
        self._declaration: Declaration = session.declare_token(text)

    def signed(self, source_ns: int | None = None) -> tuple[int, bytes]:
        """The number of its next message or request, and the attachment with it."""
        number = next(self._numbers)
        return number, Attachment(number, time.time_ns() if source_ns is None else source_ns, self.gid).encode()

    def close(self) -> None:
        """Leave the graph."""
        self._declaration.close()


@dataclass(slots=True)
class RmwNode:
    """What every part of the bridge uses. `counts`: what was lost, by cause."""

    hub: Hub
    session: Session
    types: Ros2Types
    token: NodeToken
    counts: Counter[str] = field(default_factory=Counter)
    _numbers: "itertools.count[int]" = field(default_factory=lambda: itertools.count(1))

    def endpoint(self, kind: Kind, name: str, type_name: str, type_hash: str, qos: Qos) -> Endpoint:
        """Declare an endpoint of this node.

        Raises:
            ConfigError: the session is closed.
        """
        token = EndpointToken(kind, self.token, next(self._numbers), name, type_name, type_hash, qos)
        return Endpoint(self.session, token, data_key(self.token.domain, name, type_name, type_hash))
