"""Services of devices, of programs and of the daemon.

A device's service has one call in flight, because devices of rosserial number no requests. An answer of theirs after
the deadline must not be taken for that to the next call; where requests have an identity, nothing is waited for.
"""

import asyncio
import reprlib
from collections import defaultdict
from collections.abc import Awaitable, Callable, Hashable, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import TypeVar

import structlog

from hostlink.core.hub.graph_changes import GraphChanges, GraphKind
from hostlink.core.hub.node import Node
from hostlink.core.hub.topic_graph import resolve
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.message_type import ServiceType
from hostlink.core.runtime.cancellation import expire, within
from hostlink.core.runtime.logs import printable
from hostlink.errors import (
    BadRequest,
    DeviceBusy,
    DeviceGone,
    HostlinkError,
    ServiceFailed,
    UnknownTopic,
    WrongType,
    nearest_field,
)

log = structlog.get_logger()

DEVICE_TIMEOUT_S = 5.0
PROGRAM_TIMEOUT_S = 60.0  # a program may do something slow, and rosbridge would wait without end
LONGEST_TURN_S = 60.0  # of one call at a device, also for a caller that waits longer: a request may be lost
MAX_WAITING = 256  # calls of one service of a device, each with its own deadline
Send = Callable[[bytes], bytes | None]  # returns the identity of the request, as `DeviceSession.call`
Answer = Callable[[Mapping[str, object]], Awaitable[Mapping[str, object]]]
Notify = Callable[[str], None]
_Service = TypeVar("_Service", "DeviceService", "Provider")


class DeviceService:
    """Service of a device: one call in flight; the others wait in order, each with its own deadline."""

    def __init__(self, name: str, type_name: str, type_: ServiceType | None, key: Hashable, send: Send) -> None:
        self.name, self.type_name, self.type, self.key = name, type_name, type_, key
        # Protocol of the device, and the sums of requests and responses as it announced them. With the same type they
        # tell that another device encodes them alike.
        self.encoding = ("", "", "")
        self._send = send
        self._calls = 0
        self._turn = asyncio.Lock()  # queue of the calls: the protocol allows one at a time
        self._answer: asyncio.Future[bytes] | None = None
        self._request: bytes | None = None  # identity of the call in flight
        self._late: asyncio.Future[None] | None = None  # late answer to a call that was given up

    async def call(self, payload: bytes, *, timeout_s: float) -> bytes:
        """Call the service, and return the payload of the answer.

        Raises:
            DeviceBusy: too many calls wait.
            DeviceGone: the device disconnected.
            ServiceFailed: no answer within timeout_s seconds.
            FrameTooLarge: the device's buffer is smaller than the request.
            BadPayload: the answer is not of its type.
        """
        if self._calls > MAX_WAITING:
            raise DeviceBusy(self.name, self._calls)
        self._calls += 1
        try:
            async with asyncio.timeout(timeout_s), self._turn:
                return await self._call_in_turn(payload, min(timeout_s, LONGEST_TURN_S))
        except TimeoutError:
            raise ServiceFailed.timeout(self.name, timeout_s) from None
        finally:
            self._calls -= 1

    def answered(self, payload: bytes, request: bytes | None = None) -> bool:
        """Pass on an answer of the device, to the request of this identity. Return False if no call waits for it."""
        answer = self._awaiting(request)
        if answer is not None:
            answer.set_result(payload)
        return answer is not None

    def refused(self, reason: HostlinkError, request: bytes | None = None) -> bool:
        """Fail the call with this identity, whose answer is not of its type. Return False if no call waits for it."""
        answer = self._awaiting(request)
        if answer is not None:
            answer.set_exception(reason)
        return answer is not None

    def _awaiting(self, request: bytes | None) -> asyncio.Future[bytes] | None:
        """Return what waits for the answer to a request. None: nothing does; a late answer has come then."""
        if request != self._request:
            return None
        if self._answer is not None and not self._answer.done():
            return self._answer
        if self._late is not None and not self._late.done():
            self._late.set_result(None)
        return None

    @property
    def is_awaited(self) -> bool:
        """Whether the device may still answer an earlier call, without an identity."""
        answer = self._answer if self._request is None else None
        return any(each is not None and not each.done() for each in (answer, self._late))

    def expect_late(self) -> None:
        """Expect a late answer to a call from before the device announced its topics again."""
        self._late = asyncio.get_running_loop().create_future()

    def close(self) -> None:
        """Fail every call at once, because the device disconnected."""
        self._send = self._fail
        if self._answer is not None and not self._answer.done():
            self._answer.set_exception(DeviceGone(self.name))
        if self._late is not None and not self._late.done():
            self._late.set_result(None)

    async def _call_in_turn(self, payload: bytes, turn_s: float) -> bytes:
        try:
            async with asyncio.timeout(turn_s):
                await self._settle(turn_s / 2)  # the other half is for the call itself
                return await self._exchange(payload)
        except TimeoutError:
            raise ServiceFailed.timeout(self.name, turn_s) from None

    async def _exchange(self, payload: bytes) -> bytes:
        self._answer = asyncio.get_running_loop().create_future()
        try:
            self._request = self._send(payload)
            return await self._answer
        except asyncio.CancelledError:  # given up by its deadline or its caller; the device may still answer
            if self._request is None:
                self._late = asyncio.get_running_loop().create_future()
            raise
        finally:
            self._answer = self._request = None

    async def _settle(self, grace_s: float) -> None:
        """Wait for the late answer to a call that was given up. After `grace_s` it counts as lost."""
        if self._late is not None:
            await asyncio.wait([self._late], timeout=grace_s)
            self._late = None

    def _fail(self, payload: bytes) -> bytes | None:  # noqa: ARG002 - signature of Send
        raise DeviceGone(self.name)


@dataclass(slots=True, eq=False)
class Provider:
    """Provider of a service other than a device: a program, or the daemon itself."""

    name: str
    type_name: str
    key: Hashable
    answer: Answer
    notify: Notify | None = None  # called with a text when another provider gets the calls
    _: KW_ONLY
    fail: Callable[[Exception], None] = lambda _: None  # called with the error of a bug
    is_reading: bool = False  # a call changes nothing
    ignores_request: bool = False  # a call with unknown fields is answered, too
    _is_withdrawn: bool = field(default=False, init=False)
    _calls: set[asyncio.Timeout] | None = field(default=None, init=False)  # none so far: most are never called

    async def call(self, name: str, request: Mapping[str, object], *, timeout_s: float) -> Mapping[str, object]:
        """Call the service, and return the answer. `name` is the caller's spelling.

        Raises:
            UnknownTopic: the service was withdrawn before it answered.
            ServiceFailed: no answer within timeout_s seconds, or a bug, which ends the provider.
            HostlinkError: the error that the provider answers.
        """
        if self._calls is None:
            self._calls = set()
        try:
            return await within(timeout_s, self.answer(request), self._calls)
        except TimeoutError:
            if self._is_withdrawn:
                raise UnknownTopic("service", name) from None
            raise ServiceFailed.timeout(self.name, timeout_s) from None
        except HostlinkError:
            raise
        except Exception as error:
            log.exception("service.crashed", service=printable(self.name))
            self.fail(error)
            raise ServiceFailed(self.name, f"{type(error).__name__}: {error}") from error

    def close(self) -> None:
        """Fail every waiting call at once, because the service is withdrawn."""
        self._is_withdrawn = True
        for end in self._calls or ():
            expire(end)

    @property
    def is_daemon(self) -> bool:
        """Whether the daemon itself provides the service."""
        return isinstance(self.key, Node) and self.key.is_daemon


class Services:
    """All services by name and provider.

    The daemon's own service precedes a device's, and that precedes a program's. Of several of one kind, the newest gets
    the calls; when it is withdrawn, the one before it.
    """

    def __init__(self, catalog: Catalog, changes: GraphChanges | None = None) -> None:
        """`changes` is notified of every added and removed service."""
        self._catalog = catalog
        self._changes = GraphChanges() if changes is None else changes
        self._offers: dict[str, dict[Hashable, DeviceService | Provider]] = {}  # by name; the newest is the last one
        self._names: defaultdict[Hashable, set[str]] = defaultdict(set)  # names of each provider

    def add_device_service(self, service: DeviceService) -> None:
        """Add a service of a device.

        Raises:
            BadRequest: the name is the daemon's own.
        """
        name, program = service.name, self.provider(service.name)
        if program is not None and program.is_daemon:
            raise BadRequest(f"{name} is a service of hostlink's own")
        self._remove(name, service.key)
        if program is not None:
            self._log_takeover(name, service.key, program)
        elif self.of_device(name) is not None:
            log.warning("service.taken_over", service=printable(name), by=str(service.key))
        self._add(service)

    def provide(self, provider: Provider) -> None:
        """Add a service of a program or of the daemon.

        Raises:
            BadRequest: the name is the daemon's own.
        """
        name = provider.name
        before = self.provider(name)
        if before is not None and before.is_daemon and not provider.is_daemon:
            raise BadRequest(f"{name} is a service of hostlink's own")
        if provider.is_daemon:  # no device may answer the emergency stop
            for key in [key for key, each in self._offers.get(name, {}).items() if isinstance(each, DeviceService)]:
                self._remove(name, key)
        elif self.of_device(name) is not None:
            if provider.notify is not None:
                provider.notify(f"{name} is a service of a device's, which gets the calls")
        elif before is not None and before.key != provider.key:
            self._log_takeover(name, provider.key, before)
        self._add(provider)

    def _add(self, service: DeviceService | Provider) -> None:
        offers = self._offers.setdefault(service.name, {})
        offers.pop(service.key, None)
        offers[service.key] = service
        self._names[service.key].add(service.name)
        self._changes.note(GraphKind.SERVICE, service.name)

    def _remove(self, name: str, key: Hashable) -> None:
        """Remove the service of one provider, whose calls fail. Do nothing if it provides none of this name."""
        offers = self._offers.get(name, {})
        service = offers.pop(key, None)
        if service is not None:
            if not offers:
                del self._offers[name]
            service.close()
            self._names[key].discard(name)
            self._changes.note(GraphKind.SERVICE, name)

    def withdraw(self, name: str, key: Hashable) -> None:
        """Remove a service of a program."""
        self._remove(resolve(name), key)

    def leave(self, key: Hashable) -> None:
        """Remove all services of a provider."""
        for name in list(self._names.get(key, ())):
            self._remove(name, key)
        self._names.pop(key, None)

    def of_device(self, name: str) -> DeviceService | None:
        """Return the newest service of this name of a device."""
        return self._newest(name, DeviceService)

    def provider(self, name: str) -> Provider | None:
        """Return the newest service of this name of a program or of the daemon."""
        return self._newest(name, Provider)

    def _newest(self, name: str, kind: type[_Service]) -> _Service | None:
        offers = self._offers.get(resolve(name), {})
        return next((each for each in reversed(offers.values()) if isinstance(each, kind)), None)

    def is_offered(self, name: str) -> bool:
        """Whether a service of this name exists."""
        return self.of_device(name) is not None or self.provider(name) is not None

    def is_reading(self, name: str) -> bool:
        """Whether a call of this service changes nothing."""
        found = self.provider(name)
        return found is not None and found.is_reading

    def names(self) -> Iterable[str]:
        """Return the names of all services, in no order."""
        return self._offers.keys()

    def all(self) -> list[tuple[str, str]]:
        """Return (name, type) of all services."""
        return sorted((name, self.find(name).type_name) for name in self.names())

    def find(self, name: str) -> DeviceService | Provider:
        """Return the service that gets the calls of this name.

        Raises:
            UnknownTopic: the service does not exist.
        """
        found = self.find_or_none(name)
        if found is None:
            raise UnknownTopic("service", name, (known for known in self._offers if not known.startswith("/rosapi/")))
        return found

    def find_or_none(self, name: str) -> DeviceService | Provider | None:
        """Return the service that gets the calls of this name; None if it does not exist."""
        program = self.provider(name)
        if program is not None and program.is_daemon:
            return program
        return self.of_device(name) or program

    def type_of(self, name: str) -> ServiceType | None:
        """Return the type of a service; None if it has no definition.

        Raises:
            UnknownTopic: the service does not exist.
        """
        service = self.find(name)
        return self._catalog.service(service.type_name) if isinstance(service, Provider) else service.type

    async def call(
        self, name: str, request: Mapping[str, object], *, timeout_s: float | None = None
    ) -> Mapping[str, object]:
        """Call a service of any provider.

        Raises:
            UnknownTopic: the service does not exist.
            WrongType, BadRequest, BadPayload: the request or the answer is not of its type.
            ServiceFailed, DeviceBusy, DeviceGone, FrameTooLarge: the call failed.
        """
        service = self.find(name)
        if isinstance(service, Provider):
            if not service.ignores_request:
                known = self._catalog.service(service.type_name)
                if known is not None:
                    _check_fields(service.name, request, [field.name for field in known.request.fields])
            return await service.call(name, request, timeout_s=PROGRAM_TIMEOUT_S if timeout_s is None else timeout_s)
        if service.type is None:
            raise WrongType(service.name, "a service type with a definition", service.type_name)
        timeout_s = DEVICE_TIMEOUT_S if timeout_s is None else timeout_s
        answer = await service.call(service.type.request.encode(request), timeout_s=timeout_s)
        return service.type.response.decode(answer)

    def _log_takeover(self, name: str, key: Hashable, before: Provider) -> None:
        log.warning("service.taken_over", service=printable(name), by=str(key), before=str(before.key))
        if before.notify is not None:
            before.notify(f"{name}: {key} offers it too and gets the calls, as long as it is there")


def _check_fields(name: str, request: Mapping[str, object], known: list[str]) -> None:
    """Refuse a request to a program, or to the daemon itself, which reads it without a codec.

    Raises:
        BadRequest: a field is unknown.
    """
    for each in request:
        if each not in known:
            raise BadRequest(f"{name}: the request has no field {reprlib.repr(each)}{nearest_field(each, known)}")
