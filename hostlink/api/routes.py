"""Routes of the REST API, their OpenAPI document, and their answers: JSON, or an error with a kind and a reason."""

import inspect
import re
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass
from http import HTTPStatus
from importlib.metadata import version
from typing import Any, TypedDict

import msgspec
from aiohttp import ClientConnectionResetError, web

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
from hostlink.hub.node import Role

BODY = web.RequestKey("body", bytes)  # of a request whose route has one
CAME = web.RequestKey("came", float)  # when its first byte came, at the earliest, by the loop's clock
MAX_BODY_BYTES = 64 * 1024  # of routes that say nothing else
SMALL_BODY_BYTES = 4096  # of a velocity or a lock: not in the budget, so that others' bodies keep out none of them

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

FILE = "application/octet-stream"  # the media type of what is read in ranges
_REFERENCE = "#/components/schemas/{name}"
_EVERYWHERE = (HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN, HTTPStatus.TOO_MANY_REQUESTS)


class ErrorReason(TypedDict):
    """Why something was refused: a kind for programs, a reason for people."""

    kind: str
    reason: str


class ErrorView(TypedDict):
    """The body of every error."""

    error: ErrorReason


@dataclass(frozen=True, slots=True)
class Route:
    """One path and method."""

    path: str
    handler: Handler
    summary: str
    response: type | None  # the type of its JSON; None: it is no JSON
    _: KW_ONLY
    method: str = "GET"
    media_type: str = "application/json"
    request: type | None = None  # the type of its body
    max_body_bytes: int = MAX_BODY_BYTES
    is_body_optional: bool = False
    check_head: Callable[[web.Request], object] | None = None  # raises what refuses it before its body is read
    on_head: Callable[[web.Request], None] | None = None  # done at once when its body is not there yet
    role: Role | None = Role.READ  # None: everybody, without a token
    is_limited: bool = True  # False: answered however often it comes, because it stops a robot
    fails: tuple[HTTPStatus, ...] = ()


_PHRASES = {HTTPStatus.REQUEST_ENTITY_TOO_LARGE: "Request Entity Too Large"}  # others since Python 3.13


def openapi(routes: Iterable[Route]) -> dict[str, Any]:
    """The OpenAPI 3.1 document of the routes."""
    listed = list(routes)
    types = [each for route in listed for each in (route.response, route.request) if each is not None]
    _, schemas = msgspec.json.schema_components([*types, ErrorView], ref_template=_REFERENCE)
    for schema in schemas.values():
        if "description" in schema:  # a docstring, which only Python 3.13 strips of its indentation
            schema["description"] = inspect.cleandoc(schema["description"])
    paths: dict[str, Any] = {}
    for route in listed:
        paths.setdefault(route.path, {})[route.method.lower()] = _operation(route)
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "hostlink",
            "version": version("hostlink"),
            "description": "Robots that speak rosserial. The WebSocket at / speaks rosbridge v2.",
        },
        "paths": paths,
        "components": {
            "schemas": schemas,
            "securitySchemes": {
                "bearer": {"type": "http", "scheme": "bearer"},
                "query": {"type": "apiKey", "in": "query", "name": "token"},
            },
        },
        "security": [{}, {"bearer": []}, {"query": []}],
    }


def _operation(route: Route) -> dict[str, Any]:
    schema = {"type": "string"} if route.response is None else _schema(route.response)
    fails = route.fails if route.role is None else (*route.fails, *_EVERYWHERE)
    operation: dict[str, Any] = {
        "summary": route.summary,
        "operationId": re.sub(r"\W+", "_", f"{route.method.lower()} {route.path}").strip("_"),
        "responses": {"200": {"description": route.summary, "content": {route.media_type: {"schema": schema}}}}
        | {str(status.value): _failure(status) for status in sorted(fails)},
    }
    if route.role is None:
        operation["security"] = [{}]
    names = re.findall(r"{(\w+)}", route.path)
    if names:
        operation["parameters"] = [
            {"name": name, "in": "path", "required": True, "schema": {"type": "string"}} for name in names
        ]
    if route.request is not None:
        operation["requestBody"] = {
            "required": not route.is_body_optional,
            "content": {"application/json": {"schema": _schema(route.request)}},
        }
    return operation


def _failure(status: HTTPStatus) -> dict[str, Any]:
    phrase = _PHRASES.get(status, status.phrase)
    return {"description": phrase, "content": {"application/json": {"schema": _schema(ErrorView)}}}


def _schema(type_: type) -> dict[str, str]:
    return {"$ref": _REFERENCE.format(name=type_.__name__)}


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
COMPRESSED_BYTES = 4096  # of an answer; below it, compression saves no packet
_KEPT_HEADERS = ("Allow", "WWW-Authenticate", "Retry-After")


def reply(body: Mapping[str, object], status: HTTPStatus = HTTPStatus.OK) -> web.Response:
    """JSON that no cache may keep."""
    return reply_encoded(msgspec.json.encode(body), status)


def reply_encoded(body: bytes, status: HTTPStatus = HTTPStatus.OK) -> web.Response:
    """Answer with JSON that was made in a thread."""
    answer = web.Response(
        body=body, status=status, content_type="application/json", headers={"Cache-Control": "no-store"}
    )
    if len(body) >= COMPRESSED_BYTES:
        answer.enable_compression()  # if the client accepts it; a thread does it
    return answer


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


FOXGLOVE = ("foxglove.sdk.v1", "foxglove.websocket.v1")  # subprotocols: the same protocol by two names
_READ_AS_TEXT = ("Host", "Origin", "Expect", "Sec-WebSocket-Key")

Answer = Callable[[web.BaseRequest], Awaitable[web.StreamResponse]]


def readable(value: str) -> str:
    """A header's value with what is no UTF-8 replaced: aiohttp makes surrogates of it, which cannot be sent."""
    return value.encode(errors="replace").decode()


def refuse_unreadable(answer: Answer) -> Answer:
    """Answer 400 to a head that is no text, or whose sender has left; `answer` does the rest.

    aiohttp itself would read Expect before a middleware does.
    """

    async def answer_readable(request: web.BaseRequest) -> web.StreamResponse:
        for name in _READ_AS_TEXT:
            if any(readable(value) != value for value in request.headers.getall(name, ())):
                return refusal("BadRequest", f"the header {name} is no UTF-8", HTTPStatus.BAD_REQUEST)
        try:
            return await answer(request)
        except ClientConnectionResetError:  # before aiohttp's "100 Continue", whose failure it logs as a fault
            return refusal("HTTP", "it broke off before its body was requested", HTTPStatus.BAD_REQUEST)

    return answer_readable


def is_foxglove(request: web.Request) -> bool:
    """Whether a WebSocket is to speak Foxglove's protocol; without a subprotocol it is rosbridge's.

    Raises:
        web.HTTPBadRequest: it requests other subprotocols alone.
    """
    names = request.headers.get("Sec-WebSocket-Protocol")
    if names is None:
        return False
    if not {name.strip() for name in names.split(",")} & set(FOXGLOVE):
        raise web.HTTPBadRequest(
            reason=f"{readable(names)[:120]} is not spoken here, but {' and '.join(FOXGLOVE)}; rosbridge v2 has no name"
        )
    return True
