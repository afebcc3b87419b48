"""FoxgloveServices: the calls of services that one client of Foxglove's protocol has under way."""

from collections.abc import Callable, Coroutine
from typing import Any

from hostlink.api.foxglove_directory import Service
from hostlink.api.foxglove_frames import ROS1, ServiceCall, encode_response
from hostlink.api.outgoing import ClientQueue, Outgoing, put_json
from hostlink.errors import BadRequest, HostlinkError
from hostlink.hub.byte_budget import Share
from hostlink.hub.participant import MAX_CALLS, Participant


class FoxgloveServices:
    """Request and response are serialised as ROS 1 has them. A call that fails is answered with the reason."""

    def __init__(
        self,
        participant: Participant,
        queue: ClientQueue,
        spawn: Callable[[Coroutine[Any, Any, None]], object],
        share: Share,
    ) -> None:
        """`spawn` runs a call as a child of the client's connection; `share`: of the calls of all clients together."""
        self.calls = 0
        self._share = share
        self._participant, self._queue, self._spawn = participant, queue, spawn

    def call(self, call: ServiceCall, service: Service | None) -> None:
        """Call a service, and send its response when it comes."""
        if self.calls >= MAX_CALLS:
            self._fail(call, f"more than {MAX_CALLS} calls under way")
        elif service is None:
            self._fail(call, f"there is no service {call.service_id}")
        elif call.encoding != ROS1:
            self._fail(call, f"{service.name}: a request must be of the encoding {ROS1}, not {call.encoding[:64]!r}")
        else:
            self.calls += 1
            self._spawn(self._finish(call, service))

    async def _finish(self, call: ServiceCall, service: Service) -> None:
        try:
            with self._share.holding(len(call.payload), "calls that are under way"):
                response = await self._participant.call(service.name, _decode(call, service))
            payload = service.type.response.encode(response)
            self._queue.put_result(Outgoing(encode_response(call._replace(payload=payload)), is_binary=True))
        except HostlinkError as error:
            self._fail(call, str(error))
        finally:
            self.calls -= 1

    def _fail(self, call: ServiceCall, reason: str) -> None:
        failure = {"op": "serviceCallFailure", "serviceId": call.service_id, "callId": call.call_id}
        put_json(self._queue, failure | {"message": reason})


def _decode(call: ServiceCall, service: Service) -> dict[str, object]:
    """The request's fields.

    Raises:
        BadRequest: the payload is not exactly one request.
    """
    try:
        return service.type.request.decode(call.payload)
    except HostlinkError as error:
        raise BadRequest(f"{service.name}: {error}") from None
