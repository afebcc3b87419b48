"""What is decided before a request is routed."""

from aiohttp import ClientConnectionResetError, web
from aiohttp.test_utils import make_mocked_request

from hostlink.api.routes import refuse_unreadable


async def test_a_client_that_left_before_it_was_told_to_continue_is_no_fault() -> None:
    async def cannot_write(_: web.BaseRequest) -> web.StreamResponse:
        raise ClientConnectionResetError("Cannot write to closing transport")

    response = await refuse_unreadable(cannot_write)(make_mocked_request("POST", "/", {"Expect": "100-continue"}))
    assert response.status == 400
