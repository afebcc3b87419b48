"""Checks of a request's head before it is routed."""

from aiohttp import ClientConnectionResetError, web
from aiohttp.test_utils import make_mocked_request

from hostlink.components.gateway.routes import refuse_unreadable


async def test_client_that_left_before_100_continue_raises_no_error() -> None:
    async def cannot_write(_: web.BaseRequest) -> web.StreamResponse:
        raise ClientConnectionResetError("Cannot write to closing transport")

    response = await refuse_unreadable(cannot_write)(make_mocked_request("POST", "/", {"Expect": "100-continue"}))
    assert response.status == 400
