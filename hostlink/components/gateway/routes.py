"""Routes of the REST API, their OpenAPI document, and their answers: JSON, or an error with a kind and a reason."""

import inspect
import re
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass
from http import HTTPStatus
from importlib.metadata import version
from typing import Any, NotRequired, TypedDict

import msgspec
from aiohttp import ClientConnectionResetError, web

from hostlink.core.host import Role
from hostlink.errors import (
    BadPayload,
    BadRequest,
    CommandRefused,
    ComponentGone,
    ConfigError,
    DeviceBusy,
    DeviceGone,
    FrameTooLarge,
    HostlinkError,
    NoRole,
    RecordingBusy,
    RecordingFailed,
    RefusalKind,
    ReloadRefused,
    ServiceFailed,
    UnknownFormat,
    UnknownTopic,
    WrongType,
)

BODY = web.RequestKey("body", bytes)  # of a request whose route has a body
CAME = web.RequestKey("came", float)  # earliest arrival of its first byte, by the event loop's clock
MAX_BODY_BYTES = 64 * 1024  # default of a route
SMALL_BODY_BYTES = 4096  # of a velocity or a lock; outside the byte budget, so that large bodies cannot block them

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

FILE = "application/octet-stream"  # media type of files that are read in ranges
_REFERENCE = "#/components/schemas/{name}"

STATUS = {
    BadRequest: HTTPStatus.BAD_REQUEST,
    NoRole: HTTPStatus.FORBIDDEN,
    WrongType: HTTPStatus.BAD_REQUEST,
    UnknownTopic: HTTPStatus.NOT_FOUND,
    FrameTooLarge: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    BadPayload: HTTPStatus.BAD_GATEWAY,
    ServiceFailed: HTTPStatus.BAD_GATEWAY,
    DeviceGone: HTTPStatus.SERVICE_UNAVAILABLE,
    ComponentGone: HTTPStatus.SERVICE_UNAVAILABLE,
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
COMPRESSED_BYTES = 4096  # smaller answers fit in a few packets without compression

FOXGLOVE = ("foxglove.sdk.v1", "foxglove.websocket.v1")  # subprotocols: two names of one protocol


class ErrorReason(TypedDict):
    """Reason of an error: a kind for programs, a text for people. holder: of a `held` robot, who drives it."""

    kind: str
    reason: str
    holder: NotRequired[str]


class ErrorView(TypedDict):
    """Body of every error."""

    error: ErrorReason


@dataclass(frozen=True, slots=True)
class Route:
    """One path and method. Its summary is the docstring of its handler, up to `Raises:`."""

    path: str
    handler: Handler
    response: type | None  # type of its JSON; None: not JSON
    _: KW_ONLY
    method: str = "GET"
    media_type: str = "application/json"
    request: type | None = None  # type of its body
    is_upload: bool = False  # its handler reads a file from the body
    max_body_bytes: int = MAX_BODY_BYTES
    is_body_optional: bool = False
    check_head: Callable[[web.Request], object] | None = None  # refuses a request before its body is read
    on_head: Callable[[web.Request], None] | None = None  # called at once when the body is still missing
    role: Role | None = Role.READ  # None: no token is needed
    is_limited: bool = True  # False: exempt from the rate limit, because it stops a robot
    fails: tuple[HTTPStatus, ...] = ()  # besides those that its role, its path and its body cause


_PHRASES = {HTTPStatus.REQUEST_ENTITY_TOO_LARGE: "Request Entity Too Large"}  # changed in Python 3.13


def openapi(routes: Iterable[Route]) -> dict[str, Any]:
    """Return the OpenAPI 3.1 document of the routes."""
    listed = list(routes)
    types = [each for route in listed for each in (route.response, route.request) if each is not None]
    _, schemas = msgspec.json.schema_components([*types, ErrorView], ref_template=_REFERENCE)
    for schema in schemas.values():
        if "description" in schema:  # a docstring, whose indentation Python removes only since 3.13
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
    fails = set(route.fails)
    summary = " ".join((inspect.getdoc(route.handler) or "").partition("Raises:")[0].split()).removesuffix(".")
    operation: dict[str, Any] = {
        "summary": summary,
        "operationId": re.sub(r"\W+", "_", f"{route.method.lower()} {route.path}").strip("_"),
        "responses": {"200": {"description": summary, "content": {route.media_type: {"schema": schema}}}},
    }
    if route.role is None:
        operation["security"] = [{}]
    else:
        fails |= {HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN, HTTPStatus.TOO_MANY_REQUESTS}
    names = re.findall(r"{(\w+)}", route.path)
    if names:
        operation["parameters"] = [
            {"name": name, "in": "path", "required": True, "schema": {"type": "string"}} for name in names
        ]
        fails |= set() if route.is_upload else {HTTPStatus.NOT_FOUND}  # an upload creates what its path names
    if route.request is not None:
        operation["requestBody"] = {
            "required": not route.is_body_optional,
            "content": {"application/json": {"schema": _schema(route.request)}},
        }
        fails |= {HTTPStatus.BAD_REQUEST, HTTPStatus.REQUEST_ENTITY_TOO_LARGE}
    if route.is_upload:
        content = {FILE: {"schema": {"type": "string", "format": "binary"}}}
        operation["requestBody"] = {"required": True, "content": content}
    operation["responses"] |= {str(status.value): _failure(status) for status in sorted(fails)}
    return operation


def _failure(status: HTTPStatus) -> dict[str, Any]:
    phrase = _PHRASES.get(status, status.phrase)
    return {"description": phrase, "content": {"application/json": {"schema": _schema(ErrorView)}}}


def _schema(type_: type) -> dict[str, str]:
    return {"$ref": _REFERENCE.format(name=type_.__name__)}


_KEPT_HEADERS = ("Allow", "WWW-Authenticate", "Retry-After")


def reply(body: Mapping[str, object], status: HTTPStatus = HTTPStatus.OK) -> web.Response:
    """Answer with JSON that no cache may store."""
    return reply_encoded(msgspec.json.encode(body), status)


def reply_encoded(body: bytes, status: HTTPStatus = HTTPStatus.OK) -> web.Response:
    """Answer with encoded JSON."""
    answer = web.Response(
        body=body, status=status, content_type="application/json", headers={"Cache-Control": "no-store"}
    )
    if len(body) >= COMPRESSED_BYTES:
        answer.enable_compression()  # in a thread, if the client accepts it
    return answer


def refusal(kind: str, reason: str, status: HTTPStatus) -> web.Response:
    """Return the JSON of an error."""
    body: ErrorView = {"error": {"kind": kind, "reason": reason}}
    return reply(body, status)


def error_view(error: HostlinkError) -> ErrorView:
    """Return the body of the answer to a request that failed so."""
    view: ErrorView = {"error": {"kind": error.kind, "reason": str(error)}}
    if isinstance(error, CommandRefused) and error.holder is not None:
        view["error"]["holder"] = str(error.holder)
    return view


def error_status(error: HostlinkError) -> HTTPStatus:
    """Return the status of the answer to a request that failed so."""
    return REFUSAL_STATUS[error.kind] if isinstance(error, CommandRefused) else STATUS[type(error)]


@web.middleware
async def explain_errors(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Turn every error into JSON with a kind and a reason."""
    try:
        return await handler(request)
    except HostlinkError as error:
        return reply(error_view(error), error_status(error))
    except web.HTTPException as error:
        if error.status < HTTPStatus.BAD_REQUEST:
            raise
        status = HTTPStatus(error.status)
        is_own = error.reason not in ("", status.phrase)  # a handler's own reason, not the standard phrase
        reason = error.reason if is_own else f"{request.method} {request.path}: {status.phrase}{_step(error)}"
        answer = refusal("HTTP", reason, status)
        answer.headers.update({name: error.headers[name] for name in _KEPT_HEADERS if name in error.headers})
        return answer


def _step(error: web.HTTPException) -> str:
    """Return the next step after a request of a path or a method that does not exist; empty after other errors."""
    if isinstance(error, web.HTTPMethodNotAllowed):
        return f"; allowed: {', '.join(sorted(error.allowed_methods))}"
    is_missing = error.status == HTTPStatus.NOT_FOUND
    return (
        "; GET /api/openapi.json lists the requests, GET /api/robots the robots, and / is the page"
        if is_missing
        else ""
    )


_READ_AS_TEXT = ("Host", "Origin", "Expect", "Connection", "Sec-WebSocket-Key", "Sec-WebSocket-Version")

Answer = Callable[[web.BaseRequest], Awaitable[web.StreamResponse]]


def readable(value: str) -> str:
    """Replace bytes of a header that are not UTF-8: aiohttp decodes them to surrogates, which cannot be sent."""
    return value.encode(errors="replace").decode()


def refuse_unreadable(answer: Answer) -> Answer:
    """Answer 400 to a head that is not text, or whose sender has disconnected. `answer` handles other requests.

    aiohttp itself reads Expect before middlewares run.
    """

    async def answer_readable(request: web.BaseRequest) -> web.StreamResponse:
        for name in _READ_AS_TEXT:
            try:
                "".join(request.headers.getall(name, ())).encode()
            except UnicodeEncodeError:
                return refusal("BadRequest", f"the header {name} is not UTF-8", HTTPStatus.BAD_REQUEST)
        try:
            return await answer(request)
        except ClientConnectionResetError:  # aiohttp logs a failed "100 Continue" as an error
            return refusal("HTTP", "the client disconnected before its body was requested", HTTPStatus.BAD_REQUEST)

    return answer_readable


def is_foxglove(request: web.Request) -> bool:
    """Whether a WebSocket speaks Foxglove's protocol. Without a subprotocol it speaks rosbridge.

    Raises:
        web.HTTPBadRequest: only unknown subprotocols are offered.
    """
    names = request.headers.get("Sec-WebSocket-Protocol")
    if names is None:
        return False
    if not {name.strip() for name in names.split(",")} & set(FOXGLOVE):
        raise web.HTTPBadRequest(
            reason=f"unknown subprotocol {readable(names)[:120]}; use {' or '.join(FOXGLOVE)}, or none for rosbridge v2"
        )
    return True
