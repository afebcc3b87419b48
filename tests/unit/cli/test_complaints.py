"""Complaints of libraries: rate limited, and without a traceback for input of a client."""

import asyncio
import logging

from aiohttp.http_exceptions import BadHttpMessage
from structlog.testing import capture_logs

from hostlink.cli.library_logs import complaints_logged


async def test_a_wrong_request_is_a_line_without_a_traceback_and_a_fault_has_one() -> None:
    server = logging.getLogger("aiohttp.server")
    with capture_logs() as lines:
        async with complaints_logged():
            for error in (BadHttpMessage("no\n\n  b'\x1b[2J'"), KeyError("x"), KeyError("y")):
                server.error("Error handling request", exc_info=error)
            asyncio.get_running_loop().call_exception_handler({"message": "a callback failed", "exception": KeyError()})
    assert [(line["event"], "exc_info" in line) for line in lines] == [
        ("client.malformed", False),
        ("library.complained", True),
        ("loop.error", True),
    ]
    assert lines[0]["reason"] == "no"
