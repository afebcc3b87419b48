"""Services both ways: the devices' own, and those that clients and other devices offer to a device.

rosserial has no request number, so a device's service has one call in flight; an answer that comes after its deadline
must not be taken for the answer to the next call.
"""

import asyncio
import itertools
from collections.abc import Awaitable, Callable, Hashable, Mapping

import structlog

from hostlink.errors import BadRequest, DeviceBusy, DeviceGone, HostlinkError, ServiceTimeout, UnknownTopic, WrongType
from hostlink.hub.subscriptions import DAEMON, resolve
from hostlink.logs import printable
from hostlink.messages.catalog import Catalog
from hostlink.messages.message_type import ServiceType

log = structlog.get_logger()

DEVICE_TIMEOUT_S = 5.0
PROGRAM_TIMEOUT_S = 60.0  # a program may do something that takes its time, and rosbridge would wait for ever
MAX_WAITING = 8  # calls for one service; more mean that the device cannot keep up
Send = Callable[[bytes], None]
Answer = Callable[[Mapping[str, object]], Awaitable[Mapping[str, object]]]


class DeviceService:
    """A service of a device's: one call in flight, the others wait their turn within their own deadlines."""

    def __init__(self, name: str, type_name: str, type_: ServiceType | None, key: Hashable, send: Send) -> None:
        self.name, self.type_name, self.type, self.key = name, type_name, type_, key
        self.late_answers = 0
        self._send = send
        self._calls = 0
        self._turn = asyncio.Lock()  # the queue of the calls: the protocol has room for one
        self._answer: asyncio.Future[bytes] | None = None
        self._late: asyncio.Future[None] | None = None  # an answer to a call that was given up may still come

    async def call(self, payload: bytes, *, timeout_s: float) -> bytes:
        """The payload of the answer; DeviceBusy, DeviceGone, ServiceTimeout or FrameTooLarge."""
        if self._calls > MAX_WAITING:
            raise DeviceBusy(self.name, self._calls)
        self._calls += 1
        try:
            async with asyncio.timeout(timeout_s), self._turn:
                await self._settle(timeout_s / 2)  # the other half is for the call itself
                return await self._exchange(payload)
        except TimeoutError:
            raise ServiceTimeout(self.name, timeout_s) from None
        finally:
            self._calls -= 1

    def answered(self, payload: bytes) -> bool:
        """The device answered; False when nobody waits for it (any more)."""
        if self._answer is not None and not self._answer.done():
            self._answer.set_result(payload)
            return True
        self.late_answers += 1
        if self._late is not None and not self._late.done():
            self._late.set_result(None)
        return False

    def close(self) -> None:
        """The device is gone: every call fails at once."""
        self._send = self._fail
        if self._answer is not None and not self._answer.done():
            self._answer.set_exception(DeviceGone(self.name))
        if self._late is not None and not self._late.done():
            self._late.set_result(None)

    async def _exchange(self, payload: bytes) -> bytes:
        self._answer = asyncio.get_running_loop().create_future()
        try:
            self._send(payload)
            return await self._answer
        except asyncio.CancelledError:  # given up, by its deadline or with its caller; the device may answer yet
            self._late = asyncio.get_running_loop().create_future()
            raise
        finally:
            self._answer = None

    async def _settle(self, grace_s: float) -> None:
        """Let the answer to a call that was given up come first; after `grace_s` it is taken as lost."""
        if self._late is not None:
            await asyncio.wait([self._late], timeout=grace_s)
            self._late = None

    def _fail(self, payload: bytes) -> None:  # noqa: ARG002 - the shape of Send
        raise DeviceGone(self.name)


class Provider:
    """Somebody who answers calls of devices: a client of the API, or a device through its DeviceService."""

    def __init__(self, name: str, type_name: str, key: Hashable, answer: Answer) -> None:
        self.name, self.type_name, self.key, self.answer = name, type_name, key, answer


class Services:
    """Every service by name; one name has one provider, the newest."""

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog
        self._devices: dict[str, DeviceService] = {}
        self._providers: dict[str, Provider] = {}

    def add_device_service(self, service: DeviceService) -> None:
        """A device offers a service; it replaces one of that name. BadRequest for a name of the daemon's own."""
        provider = self._providers.get(service.name)
        if provider is not None and provider.key == DAEMON:
            raise BadRequest(f"{service.name} is a service of hostlink's own")
        before = self._devices.get(service.name)
        if before is not None:
            before.close()
        self._devices[service.name] = service

    def remove_device_service(self, service: DeviceService) -> None:
        """The device offers it no more."""
        service.close()
        if self._devices.get(service.name) is service:
            del self._devices[service.name]

    def provide(self, provider: Provider) -> None:
        """A client offers a service; BadRequest for a name of the daemon's own."""
        before = self._providers.get(provider.name)
        if before is not None and before.key == DAEMON != provider.key:
            raise BadRequest(f"{provider.name} is a service of hostlink's own")
        squatter = self._devices.get(provider.name)
        if provider.key == DAEMON and squatter is not None:  # the emergency stop is nobody else's
            self.remove_device_service(squatter)
        self._providers[provider.name] = provider

    def withdraw(self, name: str, key: Hashable) -> None:
        """A client offers it no more."""
        provider = self._providers.get(resolve(name))
        if provider is not None and provider.key == key:
            del self._providers[provider.name]

    def leave(self, key: Hashable) -> None:
        """`key` is gone with all that it offered."""
        for name, service in list(self._devices.items()):
            if service.key == key:
                service.close()
                del self._devices[name]
        for name, provider in list(self._providers.items()):
            if provider.key == key:
                del self._providers[name]

    def of_device(self, name: str) -> DeviceService | None:
        """The device's service of that name."""
        return self._devices.get(resolve(name))

    def provider(self, name: str) -> Provider | None:
        """The client's service of that name."""
        return self._providers.get(resolve(name))

    def is_offered(self, name: str) -> bool:
        """Whether there is a service of that name."""
        return self.of_device(name) is not None or self.provider(name) is not None

    def all(self) -> list[tuple[str, str]]:
        """(name, type) of every service."""
        found = {name: provider.type_name for name, provider in self._providers.items()}
        found |= {name: service.type_name for name, service in self._devices.items()}
        return sorted(found.items())

    def find(self, name: str) -> DeviceService | Provider:
        """The service of that name; UnknownTopic if there is none."""
        found = self.of_device(name) or self.provider(name)
        if found is None:
            others = itertools.chain(self._devices, self._providers)
            raise UnknownTopic("service", name, (known for known in others if not known.startswith("/rosapi/")))
        return found

    def type_of(self, name: str) -> ServiceType | None:
        """The type of a service, if it has a definition; UnknownTopic if nobody offers it."""
        service = self.find(name)
        return self._catalog.service(service.type_name) if isinstance(service, Provider) else service.type

    async def call(
        self, name: str, request: Mapping[str, object], *, timeout_s: float | None = None
    ) -> Mapping[str, object]:
        """Call a service, whoever offers it. UnknownTopic, WrongType, BadRequest, or what DeviceService.call raises."""
        service = self.find(name)
        if isinstance(service, Provider):
            timeout_s = PROGRAM_TIMEOUT_S if timeout_s is None else timeout_s
            try:
                async with asyncio.timeout(timeout_s):
                    return await service.answer(request)
            except TimeoutError:
                raise ServiceTimeout(service.name, timeout_s) from None
        if service.type is None:
            raise WrongType(service.name, "a service type with a definition", service.type_name)
        timeout_s = DEVICE_TIMEOUT_S if timeout_s is None else timeout_s
        answer = await service.call(service.type.request.encode(request), timeout_s=timeout_s)
        return service.type.response.decode(answer)

    async def answer_device(self, name: str, type_name: str, payload: bytes) -> bytes:
        """The response to a device that calls a service.

        The protocol has no way to say that a call failed, and a device waits for an answer without end. So a failure is
        an answer of defaults (success: false), with the reason in `message` where the type has one.
        """
        type_ = self._catalog.service(type_name)
        if type_ is None:
            raise WrongType(name, "a service type with a definition", type_name)
        try:
            answer = await self.call(name, type_.request.decode(payload), timeout_s=DEVICE_TIMEOUT_S)
        except HostlinkError as error:
            log.warning("service.failed", service=printable(name), reason=str(error))
            has_message = any(field.name == "message" and field.type == "string" for field in type_.response.fields)
            answer = {"message": str(error)} if has_message else {}
        return type_.response.encode(answer)
