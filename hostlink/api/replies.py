"""Replies: JSON of the present state, or an error with a kind and a reason."""

from collections.abc import Mapping
from http import HTTPStatus

import msgspec
from aiohttp import web

from hostlink.api.routes import ErrorView, Handler
from hostlink.errors import (
    BadPayload,
    BadRequest,
    CommandRefused,
    ConfigError,
    DeviceBusy,
    DeviceGone,
    FrameTooLarge,
    HostlinkError,
    RecordingBusy,
    RecordingFailed,
    RefusalKind,
    ReloadRefused,
    ServiceFailed,
    UnknownFormat,
    UnknownTopic,
    WrongType,
)

STATUS = {
    BadRequest: HTTPStatus.BAD_REQUEST,
    WrongType: HTTPStatus.BAD_REQUEST,
    UnknownTopic: HTTPStatus.NOT_FOUND,
    FrameTooLarge: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    BadPayload: HTTPStatus.BAD_GATEWAY,
    ServiceFailed: HTTPStatus.BAD_GATEWAY,
    DeviceGone: HTTPStatus.SERVICE_UNAVAILABLE,
    DeviceBusy: HTTPStatus.SERVICE_UNAVAILABLE,
    ConfigError: HTTPStatus.INTERNAL_SERVER_ERROR,
    RecordingBusy: HTTPStatus.CONFLICT,
    ReloadRefused: HTTPStatus.CONFLICT,
    UnknownFormat: HTTPStatus.INSUFFICIENT_STORAGE,
    RecordingFailed: HTTPStatus.INSUFFICIENT_STORAGE,
}
REFUSAL_STATUS = {
    RefusalKind.NOT_FINITE: HTTPStatus.BAD_REQUEST,
    RefusalKind.UNSUPPORTED: HTTPStatus.BAD_REQUEST,
    RefusalKind.NOT_CONNECTED: HTTPStatus.SERVICE_UNAVAILABLE,
    RefusalKind.ENDING: HTTPStatus.SERVICE_UNAVAILABLE,
    RefusalKind.LOCKED: HTTPStatus.CONFLICT,
    RefusalKind.HELD: HTTPStatus.CONFLICT,
    RefusalKind.DISARMED: HTTPStatus.CONFLICT,
    RefusalKind.LATE: HTTPStatus.CONFLICT,
    RefusalKind.CROWDED: HTTPStatus.TOO_MANY_REQUESTS,
}
_KEPT_HEADERS = ("Allow", "WWW-Authenticate", "Retry-After")


def reply(body: Mapping[str, object], status: HTTPStatus = HTTPStatus.OK) -> web.Response:
    """JSON that no cache may keep."""
    return reply_encoded(msgspec.json.encode(body), status)


def reply_encoded(body: bytes, status: HTTPStatus = HTTPStatus.OK) -> web.Response:
    """JSON that was made in a thread, for `reply`."""
    return web.Response(
        body=body,
        status=status,
        content_type="application/json",
        headers={"Cache-Control": "no-store"},
    )


def refusal(kind: str, reason: str, status: HTTPStatus) -> web.Response:
    """The JSON of an error."""
    body: ErrorView = {"error": {"kind": kind, "reason": reason}}
    return reply(body, status)


@web.middleware
async def explain_errors(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Every error is JSON with a kind and a reason."""
    try:
        return await handler(request)
    except HostlinkError as error:
        status = REFUSAL_STATUS[error.kind] if isinstance(error, CommandRefused) else STATUS[type(error)]
        return refusal(error.kind, str(error), status)
    except web.HTTPException as error:
        if error.status < HTTPStatus.BAD_REQUEST:
            raise
        status = HTTPStatus(error.status)
        is_own = error.reason not in ("", status.phrase)  # a reason that a person understands by itself
        reason = error.reason if is_own else f"{request.method} {request.path}: {status.phrase}"
        answer = refusal("HTTP", reason, status)
        answer.headers.update({name: error.headers[name] for name in _KEPT_HEADERS if name in error.headers})
        return answer
