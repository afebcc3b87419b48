"""ClientServices: the services that one client of rosbridge offers; calls go out to it, and it answers them."""

import asyncio
import itertools
import reprlib
from collections.abc import Mapping

import msgspec

from hostlink.api.client_queue import ClientQueue
from hostlink.api.request import Request
from hostlink.errors import BadRequest, UnknownTopic
from hostlink.hub.services import Provider, Services
from hostlink.hub.subscriptions import resolve
from hostlink.messages.catalog import Catalog

MAX_SERVICES = 64
_Answer = asyncio.Future[Mapping[str, object]]


class ClientServices:
    """Offered, called and answered; when the client leaves, every call that waits for it fails at once."""

    def __init__(self, client: str, services: Services, catalog: Catalog, queue: ClientQueue) -> None:
        self._client, self._services, self._catalog, self._queue = client, services, catalog, queue
        self._numbers = itertools.count(1)
        self._names: set[str] = set()
        self._waiting: dict[str, tuple[str, _Answer]] = {}

    @property
    def names(self) -> list[str]:
        """The services."""
        return sorted(self._names)

    def advertise(self, request: Request) -> None:
        """Offer a service; the newest offer of a name counts."""
        name, type_name = request.text("service"), request.text("type")
        resolved = resolve(name)
        if len(self._names | {resolved}) > MAX_SERVICES:
            raise BadRequest(f"more than {MAX_SERVICES} services")

        async def answer(arguments: Mapping[str, object]) -> Mapping[str, object]:
            return await self._ask(name, type_name, arguments)

        self._services.provide(Provider(resolved, type_name, self._client, answer))
        self._names.add(resolved)

    def unadvertise(self, request: Request) -> None:
        """Offer it no more."""
        self._withdraw(resolve(request.text("service")))

    def respond(self, request: Request) -> None:
        """Take the client's `service_response`; one that nobody waits for is late, and harmless."""
        name, answer = self._waiting.get(str(request.id), ("", None))
        if answer is None or answer.done():
            return
        values = request.fields.get("values")
        if request.fields.get("result", True) is False:
            answer.set_exception(BadRequest(f"{name}: {values if isinstance(values, str) else reprlib.repr(values)}"))
        elif isinstance(values, dict | None):
            answer.set_result(values or {})
        else:
            answer.set_exception(BadRequest(f"{name}: its answer is no object"))

    def close(self) -> None:
        """The client is gone."""
        for name in self.names:
            self._withdraw(name)
        for name, answer in self._waiting.values():
            if not answer.done():
                answer.set_exception(UnknownTopic("service", name))

    def _withdraw(self, name: str) -> None:
        self._services.withdraw(name, self._client)
        self._names.discard(name)

    async def _ask(self, name: str, type_name: str, arguments: Mapping[str, object]) -> Mapping[str, object]:
        """Call the client. Where the type has a definition, both ways are complete and right, as through ROS."""
        type_ = self._catalog.service(type_name)
        if type_ is not None:
            arguments = type_.request.decode(type_.request.encode(arguments))
        key = f"{self._client} {next(self._numbers)}"
        answer: _Answer = asyncio.get_running_loop().create_future()
        self._waiting[key] = (name, answer)
        call = {"op": "call_service", "id": key, "service": name, "args": arguments}
        self._queue.put_result(msgspec.json.encode(call))
        try:
            values = await answer
        finally:
            del self._waiting[key]
        return values if type_ is None else type_.response.decode(type_.response.encode(values))
