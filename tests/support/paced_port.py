"""PacedPort: a pseudo-terminal that is as slow as a serial line, with a board's UART at its end."""

import asyncio
import contextlib
import os
import termios
from collections.abc import AsyncIterator, Callable, Iterator

from hostlink.core.runtime.cancellation import meanwhile
from hostlink.core.runtime.loop_time import loop_time_s
from tests.support.pty_pair import pty_pair
from tests.support.uart import BoardUart

TURN_S = 0.001
AHEAD_S = 0.004  # of the line: what a USB adapter has taken of the host's bytes and not sent yet
_BAUDS = {getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdecimal()}
_OUTPUT_SPEED = 5  # index in the result of tcgetattr


class PacedPort:
    """Carries bytes between a pseudo-terminal and the board that is plugged in. The host's rate is that of the port.

    What the line has no time for stays in the pseudo-terminal, as in a driver, but is not counted as unsent there and
    cannot be discarded. Bytes to a board that is not there are lost.
    """

    def __init__(self, descriptor: int, path: str) -> None:
        self.path = path
        self.arrived: list[
            tuple[float, bytes]
        ] = []  # bytes that the host wrote, with the times at which they were read
        self._descriptor = descriptor
        self._board: BoardUart | None = None
        self._on_arrival: Callable[[], None] = lambda: None

    @contextlib.contextmanager
    def plugged(self, board: BoardUart, on_arrival: Callable[[], None] = lambda: None) -> Iterator[None]:
        """Connect a board for the length of the block. `on_arrival` is called when bytes have arrived at its UART."""
        self._board, self._on_arrival = board, on_arrival
        self._set_rates(board)
        try:
            yield
        finally:
            self._board = None

    @property
    def host_baud(self) -> int:
        """The rate that the host has set."""
        return _BAUDS[termios.tcgetattr(self._descriptor)[_OUTPUT_SPEED]]

    async def run(self) -> None:
        """Carry bytes until cancelled."""
        while True:
            self._turn(loop_time_s())
            await asyncio.sleep(TURN_S)

    def _turn(self, now_s: float) -> None:
        board = self._board
        if board is None:
            self._read(65536)
            return
        self._set_rates(board)
        to_board, to_host = board.from_host, board.to_host
        room_s = now_s + AHEAD_S - to_board.free_at_s
        if room_s > 0 and (data := self._read(1 + int(min(room_s, AHEAD_S) / to_board.byte_s))):
            self.arrived.append((now_s, data))
            to_board.send(data, now_s)
        if data := to_host.pop(now_s):
            with contextlib.suppress(BlockingIOError):  # the host reads nothing: its buffer is full
                os.write(self._descriptor, data)
        next_s = to_board.next_arrival_s()
        if next_s is not None and next_s <= now_s:
            self._on_arrival()

    def _set_rates(self, board: BoardUart) -> None:
        board.from_host.baud = board.to_host.read_baud = self.host_baud
        board.from_host.read_baud = board.to_host.baud

    def _read(self, limit: int) -> bytes:
        try:
            return os.read(self._descriptor, limit)
        except BlockingIOError:
            return b""


@contextlib.asynccontextmanager
async def paced_port() -> AsyncIterator[PacedPort]:
    """A port for the length of the block."""
    with pty_pair() as (descriptor, path):
        os.set_blocking(descriptor, False)
        port = PacedPort(descriptor, path)
        async with meanwhile(("line", port.run())):
            yield port
