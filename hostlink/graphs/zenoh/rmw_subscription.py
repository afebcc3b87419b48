"""Subscription: a topic of the hub to which ROS 2 can publish."""

from dataclasses import dataclass

from hostlink.errors import BadPayload
from hostlink.graphs.ros2_types import Ros2Message
from hostlink.graphs.zenoh.rmw_attachment import GID_BYTES, Attachment
from hostlink.graphs.zenoh.rmw_node import RmwNode
from hostlink.graphs.zenoh.rmw_publishers import Publishers
from hostlink.graphs.zenoh.rmw_qos import COMMANDS, TELEMETRY, Qos
from hostlink.graphs.zenoh.rmw_token import Kind
from hostlink.graphs.zenoh.session import Sample

MAX_NESTED_BYTES = 32 * 1024  # of a message with lists of messages or texts, each of which costs time
MAX_FLAT_BYTES = 1024 * 1024
MAX_WAITING = 64  # messages of one publisher
TWIST_BYTES = 48  # at the end of a TwistStamped


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is to be subscribed, and what becomes of it: two that are equal are one subscription."""

    name: str  # of the topic in ROS 2
    type: Ros2Message
    topic: str  # in the hub
    is_velocity: bool = False
    is_stripped: bool = False  # of a TwistStamped the Twist alone is published
    has_history: bool = False  # what publishers keep for those who come later is requested

    @property
    def qos(self) -> Qos:
        """As the tools of ROS 2 show it."""
        if self.is_velocity:
            return COMMANDS
        return Qos(is_transient_local=self.has_history, depth=TELEMETRY.depth)


class Subscription:
    """`close` ends it."""

    def __init__(self, node: RmwNode, wanted: Wanted, publishers: Publishers) -> None:
        """Declare it.

        Raises:
            ConfigError: the session is closed.
        """
        self._node, self._wanted, self._publishers = node, wanted, publishers
        type_ = wanted.type
        self._endpoint = node.endpoint(Kind.SUBSCRIPTION, wanted.name, type_.name, type_.type_hash, wanted.qos)
        if wanted.is_velocity:
            publishers.join((wanted.name, type_.name))
        self._subscription = node.session.subscribe(
            self._endpoint.key,
            self._receive,
            signer_of=self._signer_of,
            max_bytes=MAX_FLAT_BYTES if type_.is_flat else MAX_NESTED_BYTES,
            max_waiting=1 if wanted.is_velocity else MAX_WAITING,
            has_history=wanted.has_history,
        )

    def close(self) -> None:
        """Subscribe no more."""
        self._endpoint.close()
        self._subscription.close()

    def _signer_of(self, attachment: bytes) -> str:
        """In a thread of Zenoh's: those who are not known share one queue."""
        gid = attachment[-GID_BYTES:]
        return gid.hex() if self._publishers.has_signed(gid) else ""

    def _receive(self, sample: Sample) -> None:
        attachment = Attachment.decode(sample.attachment)
        if attachment is None:
            self._node.counts["unsigned"] += 1
            return
        try:
            payload = self._wanted.type.from_cdr(sample.payload)
        except BadPayload:
            self._node.counts["malformed_from_ros2"] += 1
            return
        self._publishers.publish(
            attachment,
            (self._wanted.name, self._wanted.type.name),
            payload[-TWIST_BYTES:] if self._wanted.is_stripped else payload,
            topic=self._wanted.topic,
        )
