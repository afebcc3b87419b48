"""Publication: one topic that somebody here publishes, to the nodes of ROS that subscribe to it."""

from hostlink.errors import HostlinkError
from hostlink.graphs.ros1.parts import Parts
from hostlink.graphs.ros1.tcpros import Header, encode_message, refusal
from hostlink.graphs.ros1.wire import Wire
from hostlink.hub.message import Message
from hostlink.hub.participant import Participant
from hostlink.logs import printable
from hostlink.messages.message_type import MessageType

MAX_SUBSCRIBERS = 64  # of one topic


class Publication:
    """It subscribes in the hub while a node of ROS does. Payloads pass as they are."""

    def __init__(self, parts: Parts, topic: str, name: str, type_: MessageType, *, is_latched: bool) -> None:
        """`topic`: its name in the hub, `name` in ROS."""
        self.topic, self.name, self.type, self.is_latched = topic, name, type_, is_latched
        self.subscribers: dict[Wire, str] = {}  # and who each is
        self._parts = parts
        self._participant: Participant | None = None
        self._header = {
            "callerid": parts.node,
            "topic": name,
            "type": type_.name,
            "md5sum": type_.md5,
            "message_definition": type_.full_definition,
            "latching": str(int(is_latched)),
            "tcp_nodelay": "1",
        }

    def accept(self, wire: Wire, header: Header) -> None:
        """A node subscribes, and receives what was latched and all that comes from now on."""
        reason = self._refusal(header)
        if reason is not None:
            self._parts.counts.refused_headers += 1
            wire.refuse(reason)
            return
        wire.send_header(self._header)
        wire.receive = lambda _: None  # a subscriber has nothing more to send
        wire.on_end = lambda: self._remove(wire)
        self._send_latched(wire)
        self.subscribers[wire] = printable(header["callerid"])
        self._subscribe()

    def close(self) -> None:
        """It is published no more."""
        for wire in list(self.subscribers):
            wire.close()

    def _refusal(self, header: Header) -> str | None:
        if len(self.subscribers) >= MAX_SUBSCRIBERS:
            return f"more than {MAX_SUBSCRIBERS} subscribers of {self.name}"
        return refusal(header, self.name, self.type)

    def _subscribe(self) -> None:
        if self._participant is None:
            self._participant = self._parts.join(self.name, self.close)
            self._listen(self._participant)

    def _listen(self, participant: Participant) -> None:
        try:
            participant.subscribe(self.topic, self._receive, type_name=self.type.name)
        except HostlinkError as error:  # its type has changed: the graph reports it soon
            self._parts.log_once("ros1.publication_failed", topic=self.name, reason=str(error))
            self.close()

    def _remove(self, wire: Wire) -> None:
        self._parts.counts.dropped_to_slow_subscribers += wire.outgoing.dropped
        self.subscribers.pop(wire, None)
        if not self.subscribers and self._participant is not None:
            self._participant.leave()
            self._participant = None

    def _send_latched(self, wire: Wire) -> None:
        """To a subscriber that comes beside others; the first one receives it with the subscription in the hub."""
        if self.is_latched and self._participant is not None:
            visitor = self._parts.join(self.name)
            visitor.subscribe(self.topic, lambda message: wire.send(encode_message(message.payload)))
            visitor.leave()

    def _receive(self, message: Message) -> None:
        data = encode_message(message.payload)
        for wire in self.subscribers:
            wire.send(data)
        self._parts.counts.messages_to_ros += len(self.subscribers)
