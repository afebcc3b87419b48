"""Complaints of libraries: rate limited, and without a traceback for input of a client."""

import asyncio
import logging

from aiohttp.http_exceptions import BadHttpMessage
from structlog.testing import capture_logs

from hostlink.cli.serve import LOG_INTERVAL_S, MAX_KINDS, Budget, complaints_logged


def test_the_first_of_a_kind_is_due_and_then_one_in_an_interval() -> None:
    now_s = 0.0
    budget = Budget(lambda: now_s)
    assert [budget.due("a") for _ in range(5)] == [1, 0, 0, 0, 0]
    assert budget.due("b") == 1
    now_s = LOG_INTERVAL_S
    assert budget.due("a") == 5


def test_there_are_only_so_many_kinds() -> None:
    budget = Budget(lambda: 0.0)
    lines = sum(budget.due(str(number)) > 0 for number in range(10 * MAX_KINDS))
    assert lines == MAX_KINDS + 1


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
