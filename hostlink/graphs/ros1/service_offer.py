"""ServiceOffer: one service that somebody here provides, for the nodes of ROS that call it."""

from hostlink.errors import HostlinkError
from hostlink.graphs.ros1.handshake import refusal
from hostlink.graphs.ros1.parts import Parts
from hostlink.graphs.ros1.tcpros import Header, encode_answer, encode_failure
from hostlink.graphs.ros1.wire import Wire
from hostlink.hub.participant import Participant
from hostlink.logs import printable
from hostlink.messages.message_type import ServiceType

MAX_CALLERS = 64  # of one service
MAX_WAITING = 8  # calls of one connection; nodes of ROS send the next one after the answer


class ServiceOffer:
    """Each connection is a participant of its own: when it ends, its calls do."""

    def __init__(self, parts: Parts, service: str, name: str, type_: ServiceType) -> None:
        """`service`: its name in the hub, `name` in ROS."""
        self.service, self.name, self.type = service, name, type_
        self.callers: dict[Wire, _Caller] = {}  # oldest first
        self._parts = parts

    def accept(self, wire: Wire, header: Header) -> None:
        """A node requests the type of the service, or calls it."""
        reason = self._refusal(header)
        if reason is not None:
            self._parts.counts.refused_headers += 1
            wire.refuse(reason)
            return
        wire.send_header(
            {
                "callerid": self._parts.node,
                "service": self.name,
                "type": self.type.name,
                "md5sum": self.type.md5,
                "request_type": self.type.request.name,
                "response_type": self.type.response.name,
            }
        )
        if header.get("probe") == "1":
            wire.close()
            return
        caller = self.callers[wire] = _Caller(self, wire, self._parts, header)
        wire.stream.max_bytes = self._parts.max_message_bytes
        wire.receive, wire.on_end = caller.receive, caller.end

    def close(self) -> None:
        """It is provided no more."""
        for wire in list(self.callers):
            wire.close()

    def _refusal(self, header: Header) -> str | None:
        is_full = header.get("probe") != "1" and len(self.callers) >= MAX_CALLERS
        reason = refusal(header, self.name, self.type)
        if reason is None and is_full and not self._make_room():
            return f"more than {MAX_CALLERS} callers of {self.name}"
        return reason

    def _make_room(self) -> bool:
        """Close the oldest that waits for no answer; returns whether there is one."""
        idle = next((wire for wire, caller in self.callers.items() if not caller.is_working), None)
        if idle is not None:
            self._parts.counts.crowded_out += 1
            idle.close()
        return idle is not None


class _Caller:
    """One connection that calls, one call after another."""

    def __init__(self, offer: ServiceOffer, wire: Wire, parts: Parts, header: Header) -> None:
        self._offer, self._wire, self._parts = offer, wire, parts
        self._participant: Participant = parts.join(printable(header["callerid"]), wire.close)
        self._waiting: list[bytes] = []
        self.is_working = False

    def receive(self, requests: list[bytes]) -> None:
        self._waiting += requests
        if len(self._waiting) > MAX_WAITING:
            self._parts.counts.failed_services += 1
            self._wire.close()
        elif not self.is_working:
            self.is_working = True
            self._parts.spawn(self._work(), name=f"ROS 1 call of {printable(self._offer.name)}")

    def end(self) -> None:
        self._offer.callers.pop(self._wire, None)
        self._waiting.clear()
        self._participant.leave()

    async def _work(self) -> None:
        try:
            while self._waiting and not self._wire.is_closed:
                self._wire.send(await self._answer(self._waiting.pop(0)))
        finally:
            self.is_working = False

    async def _answer(self, request: bytes) -> bytes:
        type_ = self._offer.type
        try:
            answer = await self._participant.call(self._offer.service, type_.request.decode(request))
            return encode_answer(type_.response.encode(answer))
        except HostlinkError as error:
            self._parts.counts.failed_services += 1
            return encode_failure(str(error))
