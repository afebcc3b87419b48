"""BoardSettings with any answers of a board."""

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
    """Board that answers each request with the lines that `answer` returns for its text."""

    def __init__(self, answer: Callable[[str], list[str]], *, delay_s: float = 0.0) -> None:
        self.requests: list[str] = []
        self._answer = answer
        self._delay_s = delay_s

    async def serve(self, transport: MemoryTransport) -> None:
        """Serve until cancelled."""
        while True:
            for number, words in _REQUEST.findall(await transport.receive()):
                self.requests.append(words.decode())
                await asyncio.sleep(self._delay_s)
                for line in self._answer(words.decode()):
                    transport.write(request_line(int(number), line))


def use(board: Board, action: Callable[[BoardSettings], Awaitable[T]], *, baud: int = 115200) -> T:
    """Return the result or the error of the action."""

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
    if isinstance(result, HostlinkError):  # a task group would raise it in an exception group
        raise result
    return result


def test_board_that_always_restarts_before_storing_raises() -> None:
    board = Board(lambda words: ["error lost"] if words.startswith("save") else ["ok"])
    with pytest.raises(HostlinkError, match=r"^/dev/ttyUSB0: the board restarts before it stores the settings; check"):
        use(board, lambda settings: settings.write({"host": "a", "port": "1"}))
    assert board.requests[:4] == ["forget", "set host=a", "set port=1", "save 2"]
    assert board.requests.count("save 2") == STORE_TRIES


def test_refused_setting_drops_the_earlier_ones() -> None:
    board = Board(lambda words: ["error unknown"] if words.startswith("set port") else ["ok"])
    with pytest.raises(HostlinkError, match="port: the sketch does not know this setting"):
        use(board, lambda settings: settings.write({"host": "a", "port": "1"}))
    assert board.requests[-2:] == ["set port=1", "forget"]


def test_unknown_settings_of_a_board_are_returned() -> None:
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


def test_slow_line_gets_a_longer_timeout() -> None:
    board = Board(lambda _: ["value host=a", "ok"], delay_s=10.0)
    assert use(board, lambda settings: settings.read(), baud=300) == {"host": "a"}
    assert board.requests == ["info"]
