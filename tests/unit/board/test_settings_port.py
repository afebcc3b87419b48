"""What is made of a board's answers, whatever they are."""

import asyncio
import re
from collections.abc import Awaitable, Callable
from typing import TypeVar

import pytest

from hostlink.board.settings import STORE_TRIES, BoardSettings, request_line
from hostlink.errors import HostlinkError
from tests.support.memory_transport import MemoryTransport, memory_pair
from tests.support.virtual_loop import run_virtual

T = TypeVar("T")

_REQUEST = re.compile(rb"#hl (\d+) (.*) [0-9A-F]{8}\n")


class Board:
    """Answers each request with the lines that `answer` gives for its words."""

    def __init__(self, answer: Callable[[str], list[str]], *, delay_s: float = 0.0) -> None:
        self.requests: list[str] = []
        self._answer = answer
        self._delay_s = delay_s

    async def serve(self, transport: MemoryTransport) -> None:
        """Until it is cancelled."""
        while True:
            for number, words in _REQUEST.findall(await transport.receive()):
                self.requests.append(words.decode())
                await asyncio.sleep(self._delay_s)
                for line in self._answer(words.decode()):
                    transport.write(request_line(int(number), line))


def use(board: Board, action: Callable[[BoardSettings], Awaitable[T]], *, baud: int = 115200) -> T:
    """What the action returns or raises."""

    async def talk() -> T | HostlinkError:
        host, device = memory_pair(address="/dev/ttyUSB0")
        async with asyncio.TaskGroup() as tasks:
            serving = tasks.create_task(board.serve(device))
            try:
                return await action(BoardSettings(host, patience_s=60.0, baud=baud))
            except HostlinkError as error:
                return error
            finally:
                await asyncio.sleep(0)
                serving.cancel()

    result = run_virtual(talk())
    if isinstance(result, HostlinkError):  # a task group would raise it as a group
        raise result
    return result


def test_a_board_that_always_restarts_before_it_stores_is_an_error() -> None:
    board = Board(lambda words: ["error lost"] if words.startswith("save") else ["ok"])
    with pytest.raises(HostlinkError, match=r"^/dev/ttyUSB0: it restarts before it stores anything; is its supply"):
        use(board, lambda settings: settings.write({"host": "a", "port": "1"}))
    assert board.requests[:4] == ["forget", "set host=a", "set port=1", "save 2"]
    assert board.requests.count("save 2") == STORE_TRIES


def test_what_was_set_is_forgotten_where_something_is_refused() -> None:
    board = Board(lambda words: ["error unknown"] if words.startswith("set port") else ["ok"])
    with pytest.raises(HostlinkError, match="port: its sketch does not know this setting"):
        use(board, lambda settings: settings.write({"host": "a", "port": "1"}))
    assert board.requests[-2:] == ["set port=1", "forget"]


def test_settings_that_another_library_has_are_shown_and_none_is_missed() -> None:
    board = Board(
        lambda _: [
            "value hue=blue%20%1b",
            "secret key=hunter2",
            "value wifi_password=hunter2",
            "nonsense",
            "value no_equals",
            "ok",
        ]
    )
    assert use(board, lambda settings: settings.read()) == {"hue": "blue \x1b", "key": "set", "wifi_password": "set"}


def test_a_slow_line_is_given_the_time_that_it_takes() -> None:
    board = Board(lambda _: ["value host=a", "ok"], delay_s=10.0)
    assert use(board, lambda settings: settings.read(), baud=300) == {"host": "a"}
    assert board.requests == ["info"]
