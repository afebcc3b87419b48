"""ClientServices: the services that one client of rosbridge provides; calls go out to it, and it answers them."""

import asyncio
import itertools
import reprlib
from collections.abc import Callable, Mapping
from typing import NamedTuple

from hostlink.api.outgoing import ClientQueue, put_json
from hostlink.api.request import Request
from hostlink.errors import BadRequest, ServiceFailed
from hostlink.hub.participant import Participant
from hostlink.messages.catalog import Catalog
from hostlink.messages.message_type import ServiceType

Values = Mapping[str, object]


class _Call(NamedTuple):
    """A call that the client has not answered yet."""

    service: str  # as the client spells it
    type: ServiceType | None
    answer: asyncio.Future[Values]

    def succeed(self, values: Values) -> None:
        if not self.answer.done():
            self.answer.set_result(values)

    def fail(self, error: Exception) -> None:
        if not self.answer.done():
            self.answer.set_exception(error)

    def completed(self, values: Values) -> Values:
        """As the type of the service has it, as through ROS; BadRequest for what does not fit."""
        return values if self.type is None else self.type.response.decode(self.type.response.encode(values))


class ClientServices:
    """Provided, called and answered."""

    def __init__(
        self, participant: Participant, catalog: Catalog, queue: ClientQueue, warn: Callable[[str], None]
    ) -> None:
        """`warn` sends the client what is no error of its own."""
        self._participant, self._catalog, self._queue, self._warn = participant, catalog, queue, warn
        self._numbers = itertools.count(1)
        self._waiting: dict[str, _Call] = {}

    def advertise(self, request: Request) -> None:
        """Provide a service; the newest offer of a name counts.

        Raises:
            BadRequest: a field is wrong, there are too many, or the name is the daemon's own.
        """
        name, type_name = request.text("service"), request.text("type")

        async def answer(arguments: Values) -> Values:
            return await self._call(name, type_name, arguments)

        self._participant.provide(name, type_name, answer, notify=self._warn)

    def unadvertise(self, request: Request) -> None:
        """Provide it no more."""
        self._participant.withdraw(request.text("service"))

    def respond(self, request: Request) -> None:
        """Accept the client's `service_response`; one that nobody waits for is late, and harmless.

        Raises:
            BadRequest: it is none, and the call has failed.
        """
        call = self._waiting.get(str(request.id))
        if call is None or call.answer.done():
            self._warn("service_response: no call waits for an answer with this id (any more)")
            return
        try:
            self._accept(call, request)
        except BadRequest as error:
            call.fail(error)
            raise

    def _accept(self, call: _Call, request: Request) -> None:
        """As rosbridge does, an object goes to the caller whatever `result` is: success is a field of the object.

        Only what could be no answer of the service's is a failure.
        """
        values, is_right = request.fields.get("values"), request.fields.get("result")
        if is_right not in (True, False, None):  # roslibpy sends null where its function returns nothing
            raise BadRequest(f"{call.service}: result must be true or false")
        if is_right is False and not isinstance(values, dict):
            call.fail(ServiceFailed(call.service, values if isinstance(values, str) else reprlib.repr(values)))
        elif isinstance(values, dict | None):
            call.succeed(call.completed(values or {}))
        else:
            raise BadRequest(f"{call.service}: its answer is no object")

    async def _call(self, name: str, type_name: str, arguments: Values) -> Values:
        """Call the client. Where the type has a definition, both ways are complete and right, as through ROS."""
        type_ = self._catalog.service(type_name)
        if type_ is not None:
            arguments = type_.request.decode(type_.request.encode(arguments))
        key = f"{self._participant.name} {next(self._numbers)}"
        call = self._waiting[key] = _Call(name, type_, asyncio.get_running_loop().create_future())
        request = {"op": "call_service", "id": key, "service": name, "args": arguments}
        try:
            put_json(self._queue, request)
            return await call.answer
        finally:
            del self._waiting[key]
