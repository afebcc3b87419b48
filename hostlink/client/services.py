"""ProvidedServices: the services that this client answers; offered again after each loss of the connection."""

import asyncio
import contextlib
import inspect
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from typing import Any

from hostlink.client.connection import HostConnection, Message
from hostlink.errors import HostlinkError

Values = Mapping[str, Any]
Answer = Callable[[Values], Awaitable[Values | None] | Values | None]
MAX_CALLS = 64  # under way at once; the daemon has as many for one program


class ProvidedServices:
    """Calls come from the connection's reader, and each is answered by a task of its own."""

    def __init__(self, connection: HostConnection) -> None:
        self._connection = connection
        self._answers: dict[str, dict[object, Answer]] = {}  # of blocks, by service; the newest one answers
        self._tasks: asyncio.TaskGroup | None = None
        self._calls: set[asyncio.Task[None]] = set()
        connection.handlers["call_service"].append(self._receive)

    def begin(self, tasks: asyncio.TaskGroup) -> None:
        """Calls are answered from now on, each by a task of this group."""
        self._tasks = tasks

    def end(self) -> None:
        """Calls that are under way are given up."""
        self._tasks = None
        for call in self._calls:
            call.cancel()

    @contextlib.asynccontextmanager
    async def serve(self, service: str, type_name: str, answer: Answer) -> AsyncIterator[None]:
        """Answer the calls of a service for the length of the block.

        Raises:
            HostlinkError: there is no connection.
        """
        request = {"op": "advertise_service", "id": f"provide:{service}", "service": service, "type": type_name}
        withdrawal = {"op": "unadvertise_service", "service": service}
        async with self._connection.keeping(f"provide:{service}", request, withdrawal):
            block = object()
            self._answers.setdefault(service, {})[block] = answer
            try:
                yield
            finally:
                del self._answers[service][block]
                if not self._answers[service]:
                    del self._answers[service]

    def _receive(self, call: Message) -> None:
        if self._tasks is not None:
            task = self._tasks.create_task(self._answer(call))
            self._calls.add(task)
            task.add_done_callback(self._calls.discard)

    async def _answer(self, call: Message) -> None:
        values, is_right = await self._values(call)
        response = {"op": "service_response", "id": call["id"], "service": call["service"]}
        try:
            await self._connection.send(response | {"values": values, "result": is_right})
        except (
            HostlinkError
        ) as error:  # the values have no JSON; or the connection is gone, and the answer is not needed
            with contextlib.suppress(HostlinkError):
                await self._connection.send(response | {"values": str(error), "result": False})

    async def _values(self, call: Message) -> tuple[Mapping[str, Any] | str, bool]:
        answers = self._answers.get(str(call["service"]))
        if answers is None:
            return "it is not offered any more", False
        if len(self._calls) > MAX_CALLS:
            return f"more than {MAX_CALLS} calls under way", False
        try:
            values = next(reversed(answers.values()))(call["args"])
            if inspect.isawaitable(values):
                values = await values
        except HostlinkError as error:
            return str(error), False
        return values or {}, True
