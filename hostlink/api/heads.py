"""Heads: what is decided before a request is routed: headers that must be text, a client that has left already."""

from collections.abc import Awaitable, Callable
from http import HTTPStatus

from aiohttp import ClientConnectionResetError, web

from hostlink.api.replies import refusal

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
