"""Replies: JSON of the present state, or an error with a kind and a reason."""

from collections.abc import Mapping
from http import HTTPStatus

import msgspec
from aiohttp import web

from hostlink.api.routes import ErrorView, Handler
from hostlink.errors import (
    BadPayload,
    BadRequest,
    ConfigError,
    DeviceBusy,
    DeviceGone,
    FrameTooLarge,
    HostlinkError,
    RecordingBusy,
    RecordingFailed,
    ReloadRefused,
    RobotHeld,
    ServiceFailed,
    UnknownTopic,
    WrongType,
)

STATUS = {
    BadRequest: HTTPStatus.BAD_REQUEST,
    WrongType: HTTPStatus.BAD_REQUEST,
    UnknownTopic: HTTPStatus.NOT_FOUND,
    RobotHeld: HTTPStatus.CONFLICT,
    FrameTooLarge: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    BadPayload: HTTPStatus.BAD_GATEWAY,
    ServiceFailed: HTTPStatus.BAD_GATEWAY,
    DeviceGone: HTTPStatus.SERVICE_UNAVAILABLE,
    DeviceBusy: HTTPStatus.SERVICE_UNAVAILABLE,
    ConfigError: HTTPStatus.INTERNAL_SERVER_ERROR,
    RecordingBusy: HTTPStatus.CONFLICT,
    ReloadRefused: HTTPStatus.CONFLICT,
    RecordingFailed: HTTPStatus.INSUFFICIENT_STORAGE,
}
_KEPT_HEADERS = ("Allow", "WWW-Authenticate", "Retry-After")


def reply(body: Mapping[str, object], status: HTTPStatus = HTTPStatus.OK) -> web.Response:
    """JSON that no cache may keep."""
    return web.Response(
        body=msgspec.json.encode(body),
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
        return refusal(type(error).__name__, str(error), STATUS[type(error)])
    except web.HTTPException as error:
        if error.status < HTTPStatus.BAD_REQUEST:
            raise
        status = HTTPStatus(error.status)
        is_own = error.reason not in ("", status.phrase)  # a reason that a person understands by itself
        reason = error.reason if is_own else f"{request.method} {request.path}: {status.phrase}"
        answer = refusal("HTTP", reason, status)
        answer.headers.update({name: error.headers[name] for name in _KEPT_HEADERS if name in error.headers})
        return answer
