"""Heads: what a request says of itself must be text where hostlink reads it as text, before anything else is done."""

from collections.abc import Awaitable, Callable
from http import HTTPStatus

from aiohttp import web

from hostlink.api.replies import refusal

_READ_AS_TEXT = ("Host", "Origin", "Expect", "Sec-WebSocket-Key")

Answer = Callable[[web.BaseRequest], Awaitable[web.StreamResponse]]


def readable(value: str) -> str:
    """A header's value with what is no UTF-8 replaced: aiohttp makes half characters of it, which nobody can send."""
    return value.encode(errors="replace").decode()


def refuse_unreadable(answer: Answer) -> Answer:
    """Answer 400 to a head that is no text; all else is `answer`'s. Before it aiohttp looks at Expect by itself."""

    async def answer_readable(request: web.BaseRequest) -> web.StreamResponse:
        for name in _READ_AS_TEXT:
            if any(readable(value) != value for value in request.headers.getall(name, ())):
                return refusal("BadRequest", f"the header {name} is no UTF-8", HTTPStatus.BAD_REQUEST)
        return await answer(request)

    return answer_readable


def refuse_subprotocol(request: web.Request) -> None:
    """400 for a WebSocket that is meant for another protocol; it would be understood as little as it understands."""
    names = request.headers.get("Sec-WebSocket-Protocol")
    if names is not None:
        raise web.HTTPBadRequest(
            reason=f"no subprotocol is spoken here, rosbridge v2 has none: {readable(names)[:120]}"
        )
