"""ServiceOffer: one service that somebody here provides, for the nodes of ROS that call it."""

from hostlink.errors import HostlinkError
from hostlink.graphs.ros1.parts import Parts
from hostlink.graphs.ros1.tcpros import ANY, Header, encode_answer, encode_failure
from hostlink.graphs.ros1.wire import Wire
from hostlink.hub.participant import Participant
from hostlink.logs import printable
from hostlink.messages.message_type import ServiceType

MAX_CALLERS = 64  # of one service
MAX_WAITING = 8  # calls of one connection; nodes of ROS send the next one after the answer
REQUIRED = ("callerid", "md5sum")


class ServiceOffer:
    """Each connection is a participant of its own: when it ends, its calls do."""

    def __init__(self, parts: Parts, service: str, name: str, type_: ServiceType) -> None:
        """`service`: its name in the hub, `name` in ROS."""
        self.service, self.name, self.type = service, name, type_
        self.callers: set[Wire] = set()
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
        self.callers.add(wire)
        caller = _Caller(self, wire, self._parts, header)
        wire.stream.max_bytes = self._parts.max_message_bytes
        wire.receive, wire.on_end = caller.receive, caller.end

    def close(self) -> None:
        """It is provided no more."""
        for wire in list(self.callers):
            wire.close()

    def _refusal(self, header: Header) -> str | None:
        missing = [field for field in REQUIRED if field not in header]
        if missing:
            return f"missing field {missing[0]}"
        if header["md5sum"] not in (ANY, self.type.md5):
            return f"{self.name} is a {self.type.name} with md5 {self.type.md5}, not {printable(header['md5sum'])}"
        return f"more than {MAX_CALLERS} callers of {self.name}" if len(self.callers) >= MAX_CALLERS else None


class _Caller:
    """One connection that calls, one call after another."""

    def __init__(self, offer: ServiceOffer, wire: Wire, parts: Parts, header: Header) -> None:
        self._offer, self._wire, self._parts = offer, wire, parts
        self._is_persistent = header.get("persistent") == "1"
        self._participant: Participant = parts.join(printable(header["callerid"]), wire.close)
        self._waiting: list[bytes] = []
        self._is_working = False

    def receive(self, requests: list[bytes]) -> None:
        self._waiting += requests
        if len(self._waiting) > MAX_WAITING:
            self._parts.counts.failed_services += 1
            self._wire.close()
        elif not self._is_working:
            self._is_working = True
            self._parts.spawn(self._work(), name=f"ROS 1 call of {printable(self._offer.name)}")

    def end(self) -> None:
        self._offer.callers.discard(self._wire)
        self._waiting.clear()
        self._participant.leave()

    async def _work(self) -> None:
        try:
            while self._waiting and not self._wire.is_closed:
                self._wire.send(await self._answer(self._waiting.pop(0)))
        finally:
            self._is_working = False

    async def _answer(self, request: bytes) -> bytes:
        type_ = self._offer.type
        try:
            answer = await self._participant.call(self._offer.service, type_.request.decode(request))
            return encode_answer(type_.response.encode(answer))
        except HostlinkError as error:
            self._parts.counts.failed_services += 1
            return encode_failure(str(error))
