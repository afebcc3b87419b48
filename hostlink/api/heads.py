"""Heads: the headers that hostlink reads as text must be text, before anything else is done."""

from collections.abc import Awaitable, Callable
from http import HTTPStatus

from aiohttp import web

from hostlink.api.replies import refusal

_READ_AS_TEXT = ("Host", "Origin", "Expect", "Sec-WebSocket-Key")

Answer = Callable[[web.BaseRequest], Awaitable[web.StreamResponse]]


def readable(value: str) -> str:
    """A header's value with what is no UTF-8 replaced: aiohttp makes surrogates of it, which cannot be sent."""
    return value.encode(errors="replace").decode()


def refuse_unreadable(answer: Answer) -> Answer:
    """Answer 400 to a head that is no text; `answer` does the rest. aiohttp itself would read Expect before it."""

    async def answer_readable(request: web.BaseRequest) -> web.StreamResponse:
        for name in _READ_AS_TEXT:
            if any(readable(value) != value for value in request.headers.getall(name, ())):
                return refusal("BadRequest", f"the header {name} is no UTF-8", HTTPStatus.BAD_REQUEST)
        return await answer(request)

    return answer_readable


def refuse_subprotocol(request: web.Request) -> None:
    """Refuse a WebSocket of another protocol.

    Raises:
        web.HTTPBadRequest: it requests a subprotocol.
    """
    names = request.headers.get("Sec-WebSocket-Protocol")
    if names is not None:
        raise web.HTTPBadRequest(
            reason=f"no subprotocol is spoken here, rosbridge v2 has none: {readable(names)[:120]}"
        )
