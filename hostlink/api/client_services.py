"""ClientServices: the services that one client of rosbridge offers; calls go out to it, and it answers them."""

import asyncio
import itertools
from collections.abc import Mapping
from typing import Any

import msgspec

from hostlink.api.client_queue import ClientQueue
from hostlink.errors import BadRequest, UnknownTopic
from hostlink.hub.services import Provider, Services
from hostlink.hub.subscriptions import resolve

MAX_SERVICES = 64


class ClientServices:
    """Offered, called and answered; when the client leaves, every call that waits for it fails at once."""

    def __init__(self, client: str, services: Services, queue: ClientQueue) -> None:
        self._client, self._services, self._queue = client, services, queue
        self._numbers = itertools.count(1)
        self._names: set[str] = set()
        self._waiting: dict[str, tuple[str, asyncio.Future[Mapping[str, object]]]] = {}

    def advertise(self, name: str, type_name: str) -> None:
        """Offer a service; the newest offer of a name counts."""
        if len(self._names) >= MAX_SERVICES:
            raise BadRequest(f"more than {MAX_SERVICES} services")
        resolved = resolve(name)

        async def answer(request: Mapping[str, object]) -> Mapping[str, object]:
            return await self._ask(name, request)

        self._services.provide(Provider(resolved, type_name, self._client, answer))
        self._names.add(resolved)

    def unadvertise(self, name: str) -> None:
        """Offer it no more."""
        self._services.withdraw(name, self._client)
        self._names.discard(resolve(name))

    def respond(self, request: dict[str, Any]) -> None:
        """Take the client's `service_response`; one that nobody waits for is late, and harmless."""
        _, future = self._waiting.get(str(request.get("id")), ("", None))
        if future is None or future.done():
            return
        values = request.get("values")
        if request.get("result", True) is False:
            future.set_exception(BadRequest(f"{request.get('service')}: {values}"))
        elif isinstance(values, dict):
            future.set_result(values)
        else:
            future.set_exception(BadRequest(f"{request.get('service')}: its answer is no object"))

    def close(self) -> None:
        """The client is gone."""
        for name in list(self._names):
            self.unadvertise(name)
        for name, future in self._waiting.values():
            if not future.done():
                future.set_exception(UnknownTopic("service", name))

    async def _ask(self, name: str, arguments: Mapping[str, object]) -> Mapping[str, object]:
        key = f"{self._client} {next(self._numbers)}"
        future: asyncio.Future[Mapping[str, object]] = asyncio.get_running_loop().create_future()
        self._waiting[key] = (name, future)
        call = {"op": "call_service", "id": key, "service": name, "args": arguments}
        self._queue.put_result(msgspec.json.encode(call))
        try:
            return await future
        finally:
            del self._waiting[key]
