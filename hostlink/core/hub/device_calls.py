"""DeviceCalls: the calls of services that devices make. Each is answered in time, within the device's buffer.

ros_lib's `ServiceClient::call` waits for its answer without end, and the device does nothing else meanwhile; the
protocol has no message for a call that failed. So a failure is a response of zeros and empty texts (success: false),
with the reason in `message` where the type has one, and a device that cannot receive even that loses its link.
"""

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

import structlog

from hostlink.core.hub.services import DEVICE_TIMEOUT_S, Provider
from hostlink.core.hub.shared import Shared
from hostlink.core.link.link import Link
from hostlink.core.messages.fitting import encode_within
from hostlink.core.messages.message_type import MessageType
from hostlink.core.protocol.endpoint import DeviceEndpoint
from hostlink.core.protocol.events import ServiceRequested
from hostlink.core.protocol.session import DeviceSession
from hostlink.core.runtime.cancellation import expire, within
from hostlink.core.runtime.logs import printable
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import (
    BadRequest,
    DeviceBusy,
    DeviceGone,
    FrameTooLarge,
    HostlinkError,
    ServiceFailed,
    UnknownTopic,
    WrongType,
)

log = structlog.get_logger()

CALL_S = 0.0003  # what a call costs
MAX_CALLS = 16  # of one device, active and waiting; ros_lib makes one and blocks
MAX_WAITING = 4  # of one service, behind the active call
RETRY_S = 0.05  # between two checks for room among the replies
MAX_REASON = 256  # characters of a reason in the log; it contains names from devices
LAST_S = 1.0  # for an answer that is late already to find room in the queue of the replies

_Outcome = Mapping[str, object] | bytes | HostlinkError


class _DeviceCall:
    """A request of a device, until it is answered."""

    def __init__(self, link: Link, event: ServiceRequested, now_s: float) -> None:
        self.link, self.endpoint, self.payload, self.request = link, event.service, event.payload, event.request
        self.negotiations = link.session.counts.negotiations  # before the call
        self.deadline_s = now_s + DEVICE_TIMEOUT_S
        self._is_dropped = False
        self.ends: set[asyncio.Timeout] = set()  # of what is done for it now

    @property
    def is_over(self) -> bool:
        """Whether the device no longer waits for the answer."""
        if self._is_dropped or self.request is None:
            return self._is_dropped
        return not self.link.session.is_waiting_for(self.endpoint, self.request)

    def is_given_up_for(self, newer: "_DeviceCall") -> bool:
        """Whether a newer call shows that the device no longer waits for the answer to this one.

        ros_lib gives a call up when its topics are requested, and takes any answer for that to its newest call.
        """
        return self.is_over or (self.request is None and self.negotiations < newer.negotiations)

    def drop(self) -> None:
        """End the call: the device no longer waits for the answer."""
        self._is_dropped = True
        for end in self.ends:
            expire(end)


class DeviceCalls:
    """Calls of devices to services: one after another for each endpoint. Calls over the bound fail at once."""

    def __init__(
        self,
        shared: Shared,
        *,
        give_up: Callable[[Link], Coroutine[Any, Any, None]],
        name_of: Callable[[Link, str], str],
    ) -> None:
        """`give_up` ends the link of a device that cannot be answered; `name_of`: the service that a device means."""
        self.refused = 0  # calls over a bound
        self._services, self._catalog, self._spawn = shared.services, shared.catalog, shared.spawn
        self._give_up, self._name_of, self._turns = give_up, name_of, shared.turns()
        self._calls: dict[int, dict[int, deque[_DeviceCall]]] = {}  # by link, by endpoint

    def accept(self, link: Link, event: ServiceRequested) -> None:
        """Start a call of a device, or queue it behind earlier ones."""
        call = _DeviceCall(link, event, loop_time_s())
        of_link = self._calls.setdefault(link.number, {})
        waiting = of_link.get(event.service.id)
        if waiting is None and _count(of_link) < MAX_CALLS:
            of_link[event.service.id] = deque([call])
            self._spawn(self._work(of_link, event.service.id), name=f"service calls of link {link.number}")
            return
        for older in waiting or ():
            if older.is_given_up_for(call):
                older.drop()
        if waiting is None or _count(of_link) >= MAX_CALLS:
            self._refuse(call, _count(of_link), is_only=waiting is None)
        elif len(waiting) > MAX_WAITING:
            self._refuse(call, len(waiting), is_only=False)
        else:
            waiting.append(call)

    def leave(self, link: Link) -> None:
        """Drop all calls of a device that disconnected."""
        for waiting in self._calls.pop(link.number, {}).values():
            for call in waiting:
                call.drop()

    def _refuse(self, call: _DeviceCall, waiting: int, *, is_only: bool) -> None:
        """Answer with DeviceBusy. Without room for the answer, end the link unless earlier answers are queued.

        A request with an identity is left unanswered then.
        """
        self.refused += 1
        try:
            self._respond(call, DeviceBusy(call.endpoint.name, waiting))
        except HostlinkError as error:
            if is_only or call.request is not None:
                self._spawn(self._end(call, error), name=f"end of link {call.link.number}")

    async def _work(self, of_link: dict[int, deque[_DeviceCall]], topic_id: int) -> None:
        waiting = of_link[topic_id]
        try:
            while waiting:
                await self._turns.wait(CALL_S, is_flooding=_count(of_link) > 1)  # ros_lib makes one, and waits
                await self._finish(waiting[0])
                waiting.popleft()
        except Exception:  # a bug here must not leave a device waiting
            log.exception("service.crashed", service=printable(waiting[0].endpoint.name))
            await self._give_up(waiting[0].link)
        finally:
            del of_link[topic_id]

    async def _finish(self, call: _DeviceCall) -> None:
        outcome: _Outcome = ServiceFailed.timeout(call.endpoint.name, DEVICE_TIMEOUT_S)
        with contextlib.suppress(TimeoutError):
            outcome = await within(call.deadline_s - loop_time_s(), self._outcome(call), call.ends)
        left_s = max(call.deadline_s - loop_time_s(), LAST_S)
        try:
            await within(left_s, self._deliver(call, outcome), call.ends)
        except (TimeoutError, HostlinkError) as error:
            await self._end(call, error)

    async def _outcome(self, call: _DeviceCall) -> _Outcome:
        """Call the service, and return its answer or its error."""
        if call.is_over:
            return DeviceGone(call.endpoint.name)
        type_ = self._catalog.service(call.endpoint.type)
        try:
            if type_ is None or call.link.session.is_refused(call.endpoint):
                return await self._pass_on(call)
            request = type_.request.decode(call.payload)
            name = self._name_of(call.link, call.endpoint.name)
            offered = self._services.find_or_none(name)
            is_stop = isinstance(offered, Provider) and offered.ignores_request  # refused for no type
            if offered is not None and offered.type_name != call.endpoint.type and not is_stop:
                raise WrongType(name, offered.type_name, call.endpoint.type)
            return await self._services.call(name, request, timeout_s=DEVICE_TIMEOUT_S)
        except HostlinkError as error:
            return error

    async def _pass_on(self, call: _DeviceCall) -> bytes:
        """Call a device whose program encodes the same type alike. The host needs no definition then."""
        service = self._services.of_device(self._name_of(call.link, call.endpoint.name))
        session, type_name = call.link.session, call.endpoint.type
        encoding = (session.protocol, call.endpoint.md5, session.response_endpoint(call.endpoint).md5)
        if service is not None and service.type_name == type_name and service.encoding == encoding:
            return await service.call(call.payload, timeout_s=DEVICE_TIMEOUT_S)
        raise WrongType(call.endpoint.name, "a service type with a definition", call.endpoint.type)

    async def _deliver(self, call: _DeviceCall, outcome: _Outcome) -> None:
        """Queue the answer as soon as there is room and the device has announced the endpoint of the response."""
        if isinstance(outcome, HostlinkError) and not call.is_over:
            log.warning(
                "service.failed", service=printable(call.endpoint.name), reason=printable(str(outcome), MAX_REASON)
            )
        while not call.is_over:
            try:
                self._respond(call, outcome)
            except (DeviceBusy, UnknownTopic):
                await asyncio.sleep(RETRY_S)
            else:
                return

    def _respond(self, call: _DeviceCall, outcome: _Outcome) -> None:
        session = call.link.session
        response = session.response_endpoint(call.endpoint)
        known = None if session.is_refused(response) else self._catalog.service(response.type)
        type_, room_bytes = None if known is None else known.response, session.room_bytes(response)
        payload, problem = encode_response(type_, outcome, response, session, room_bytes)
        try:
            self._queue(call, response, payload)
        except FrameTooLarge as error:  # encoded for the device, it is longer
            room_bytes -= error.frame_bytes - error.limit_bytes
            payload, problem = encode_response(type_, outcome, response, session, room_bytes)
            self._queue(call, response, payload)
        if problem is not None:
            is_cut = isinstance(problem, FrameTooLarge)
            event = "service.cut" if is_cut else "service.failed"
            log.warning(event, service=printable(response.name), reason=printable(str(problem), MAX_REASON))
            session.too_large = str(problem) if is_cut else session.too_large  # the diagnosis knows what to do
        call.link.wake()

    def _queue(self, call: _DeviceCall, response: DeviceEndpoint, payload: bytes | None) -> None:
        if call.request is None:
            call.link.session.respond(response, payload)
        else:
            call.link.session.respond(response, payload, request=call.request)

    async def _end(self, call: _DeviceCall, error: Exception) -> None:
        """End the link of a device that would wait without end. A device with other topics has restarted already.

        A device whose requests have an identity does not wait: it is not answered, and its robot may be driven on.
        """
        if not call.is_over and call.link.session.has(call.endpoint):
            reason = printable(str(error), MAX_REASON) or "no room for the answer"
            if call.request is not None:
                call.link.session.leave_unanswered(call.endpoint, call.request)
                log.warning("service.failed", service=printable(call.endpoint.name), reason=reason)
                return
            log.error("service.unanswerable", service=printable(call.endpoint.name), reason=reason)
            await self._give_up(call.link)


def encode_response(
    type_: MessageType | None,
    outcome: _Outcome,
    response: DeviceEndpoint,
    session: DeviceSession,
    limit_bytes: int,
) -> tuple[bytes | None, HostlinkError | None]:
    """Encode as much of an answer as fits `limit_bytes`; also return the problem of an answer that does not fit.

    A payload of None means zeros: the layout is unknown here.

    Raises:
        FrameTooLarge: the device's buffer is smaller than the shortest response.
    """
    if isinstance(outcome, bytes):
        is_right = len(outcome) <= limit_bytes
        return (outcome, None) if is_right else (None, session.too_long(response, len(outcome)))
    if type_ is None:
        return None, None
    if isinstance(outcome, HostlinkError):
        return _encode_failure(type_, outcome, response, session, limit_bytes), None
    try:
        whole_bytes = len(type_.encode(outcome))
        payload = encode_within(type_, outcome, limit_bytes)
    except BadRequest as error:
        return _encode_failure(type_, error, response, session, limit_bytes), error
    problem = None if whole_bytes <= limit_bytes else session.too_long(response, whole_bytes)
    if payload is None and problem is not None:
        payload = _encode_failure(type_, problem, response, session, limit_bytes)
    return payload, problem


def _encode_failure(
    type_: MessageType, reason: HostlinkError, response: DeviceEndpoint, session: DeviceSession, limit_bytes: int
) -> bytes:
    """Encode default values, and as much of the reason as there is room for."""
    has_message = any(field.name == "message" and field.type_text == "string" for field in type_.fields)
    payload = encode_within(type_, {"message": str(reason)} if has_message else {}, limit_bytes)
    if payload is None:
        raise session.too_long(response, type_.layout.minimum_bytes)
    return payload


def _count(of_link: Mapping[int, deque[_DeviceCall]]) -> int:
    return sum(map(len, of_link.values()))
