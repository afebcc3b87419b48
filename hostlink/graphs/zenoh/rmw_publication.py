"""Publication: a topic of the hub that ROS 2 can subscribe to. It costs nothing while nobody there does."""

from dataclasses import dataclass

from hostlink.errors import BadPayload
from hostlink.graphs.ros2_types import Ros2Message
from hostlink.graphs.zenoh.rmw_node import GROUP, RmwNode
from hostlink.graphs.zenoh.rmw_qos import LATCHED, TELEMETRY
from hostlink.graphs.zenoh.rmw_token import Kind
from hostlink.hub.message import Message
from hostlink.hub.participant import Participant


@dataclass(frozen=True, slots=True)
class Published:
    """What is to be published: two that are equal are one publication."""

    topic: str
    type_name: str  # in the hub
    type: Ros2Message
    is_latched: bool


class Publication:
    """`close` ends it. What is latched is kept for those who come later, as ROS 2's transient local."""

    def __init__(self, node: RmwNode, topic: Published) -> None:
        """Declare it.

        Raises:
            ConfigError: the session is closed.
        """
        qos, type_ = LATCHED if topic.is_latched else TELEMETRY, topic.type
        self._node, self._topic = node, topic
        self._endpoint = node.endpoint(Kind.PUBLISHER, topic.topic, type_.name, type_.type_hash, qos)
        self._publisher = node.session.declare_publisher(self._endpoint.key, kept=1 if topic.is_latched else 0)
        self._participant: Participant | None = None
        if topic.is_latched:
            self._subscribe()
        else:
            self._publisher.watch(self._match)
            self._match(self._publisher.is_subscribed)

    def close(self) -> None:
        """Publish no more."""
        self._unsubscribe()
        self._endpoint.close()
        self._publisher.close()

    def _match(self, is_subscribed: bool) -> None:
        if is_subscribed:
            self._subscribe()
        else:
            self._unsubscribe()

    def _subscribe(self) -> None:
        if self._participant is None:
            self._participant = self._node.hub.join(f"ros2 {self._topic.topic}", group=GROUP)
            self._participant.subscribe(self._topic.topic, self._receive)

    def _unsubscribe(self) -> None:
        if self._participant is not None:
            self._participant.leave()
            self._participant = None

    def _receive(self, message: Message) -> None:
        if message.type_name != self._topic.type_name:
            self._node.counts["other_type"] += 1
            return
        try:
            data = self._topic.type.to_cdr(message.payload)
        except BadPayload:
            self._node.counts["malformed_to_ros2"] += 1
            return
        _, attachment = self._endpoint.signed(message.stamp_ns)
        self._publisher.put(data, attachment=attachment)
        self._node.counts["to_ros2"] += 1
