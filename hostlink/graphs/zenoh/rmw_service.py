"""Services both ways: those of the hub as queryables of ROS 2, and those of ROS 2 in the hub."""

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from hostlink.errors import BadPayload, BadRequest, HostlinkError, ServiceFailed
from hostlink.graphs.ros2_types import Ros2Service
from hostlink.graphs.zenoh.rmw_attachment import Attachment
from hostlink.graphs.zenoh.rmw_node import GROUP, RmwNode
from hostlink.graphs.zenoh.rmw_qos import SERVICE
from hostlink.graphs.zenoh.rmw_token import EndpointToken, Kind
from hostlink.graphs.zenoh.session import Query
from hostlink.hub.participant import Participant
from hostlink.messages.message_type import ServiceType

MAX_CALLS_OF_CLIENT = 8  # under way at once, of one client and one service
CALL_TIMEOUT_S = 30.0  # of a service of ROS 2


@dataclass(frozen=True, slots=True)
class Offered:
    """A service that is to be offered: two that are equal are one."""

    name: str
    known: ServiceType
    type: Ros2Service


class OfferedService:
    """A service of the hub, which ROS 2 can call."""

    def __init__(self, node: RmwNode, offered: Offered) -> None:
        """Declare it.

        Raises:
            ConfigError: the session is closed.
        """
        self._node, self._name, self._known, self._type = node, offered.name, offered.known, offered.type
        self._calls: Counter[bytes] = Counter()
        self._participant = node.hub.join(f"ros2 {self._name}", group=GROUP)
        self._endpoint = node.endpoint(Kind.SERVER, self._name, self._type.name, self._type.type_hash, SERVICE)
        self._queryable = node.session.serve(self._endpoint.key, self._receive)

    def close(self) -> None:
        """Answer no more."""
        self._endpoint.close()
        self._queryable.close()
        self._participant.leave()

    def _receive(self, query: Query) -> None:
        attachment = Attachment.decode(query.attachment)
        if attachment is None or self._calls[attachment.gid] >= MAX_CALLS_OF_CLIENT:
            self._node.counts["unsigned" if attachment is None else "crowded_calls"] += 1
            query.close()
            return
        self._calls[attachment.gid] += 1
        self._node.hub.spawn(self._answer(query, attachment), name=f"ros2 {self._name}")

    async def _answer(self, query: Query, attachment: Attachment) -> None:
        try:
            answer = await self._call(query.payload)
            if answer is not None:
                signed = attachment._replace(source_ns=time.time_ns()).encode()
                query.reply(answer, key=self._endpoint.key, attachment=signed)
                self._node.counts["calls_from_ros2"] += 1
        finally:
            query.close()
            self._calls[attachment.gid] -= 1
            if not self._calls[attachment.gid]:
                del self._calls[attachment.gid]

    async def _call(self, data: bytes) -> bytes | None:
        """The answer; None: the request is none, or the answer has no field for a failure. ROS 2 has no other way."""
        try:
            request = self._known.request.decode(self._type.request.from_cdr(data))
            answer = await self._participant.call(self._name, request)
            return self._type.response.to_cdr(self._known.response.encode(answer))
        except BadPayload:
            self._node.counts["malformed_from_ros2"] += 1
            return None
        except HostlinkError as error:
            self._node.counts["failed_calls"] += 1
            return self._failure(str(error))

    def _failure(self, reason: str) -> bytes | None:
        fields = {field.name: field.type for field in self._known.response.fields}
        if fields.get("success") != "bool":
            return None
        message = {"message": reason} if fields.get("message") == "string" else {}
        return self._type.response.to_cdr(self._known.response.encode({"success": False, **message}))


class CalledService:
    """A service of ROS 2, which the hub's devices and programs can call."""

    def __init__(self, node: RmwNode, token: EndpointToken, known: ServiceType, type_: Ros2Service) -> None:
        """Provide it.

        Raises:
            ConfigError: the session is closed.
            BadRequest: the name is the daemon's own.
        """
        self._node, self._name, self._known, self._type = node, token.name, known, type_
        self._participant: Participant = node.hub.join(f"ros2 {token.node.full_name}", group=GROUP)
        self._endpoint = node.endpoint(Kind.CLIENT, token.name, type_.name, type_.type_hash, SERVICE)
        try:
            self._participant.provide(token.name, known.name, self._answer)
        except BadRequest:
            self.close()
            raise

    def close(self) -> None:
        """Provide it no more."""
        self._participant.leave()
        self._endpoint.close()

    async def _answer(self, request: Mapping[str, object]) -> Mapping[str, object]:
        data = self._type.request.to_cdr(self._known.request.encode(request))
        number, attachment = self._endpoint.signed()
        samples = await self._node.session.get(
            self._endpoint.key, data, attachment=attachment, timeout_s=CALL_TIMEOUT_S
        )
        for sample in samples:
            signed = Attachment.decode(sample.attachment)
            if signed is not None and signed.sequence_number == number:
                self._node.counts["calls_to_ros2"] += 1
                return self._known.response.decode(self._type.response.from_cdr(sample.payload))
        raise ServiceFailed(self._name, "nobody in ROS 2 has answered")
