"""Route: one path of the API, its role, its body and its response; and the OpenAPI document of all routes."""

import inspect
import re
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import KW_ONLY, dataclass
from http import HTTPStatus
from importlib.metadata import version
from typing import Any, TypedDict

import msgspec
from aiohttp import web

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
