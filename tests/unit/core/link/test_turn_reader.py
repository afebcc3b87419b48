"""TurnReader: pieces of one connection in their turns, at once while the turn is free."""

import asyncio
from collections.abc import Callable

from hostlink.core.link.fair_share import TURN_S, FairShare, Turns
from hostlink.core.transport.base import READ_BYTES
from tests.support.virtual_loop import VirtualLoop, run_virtual


class FakeSource:
    """Connection with waiting bytes, of which each read takes one piece and costs some time."""

    def __init__(self, share: FairShare, *, piece_bytes: int, cost_s: float, log: list[str], name: str = "") -> None:
        self.unread_bytes = 0
        self.is_ended = self.is_behind = False
        self.turns = Turns(share)
        self.reader = self.turns.reader(self, self.read, lambda: log.append(f"{name} end"))
        self.cost_s = cost_s
        self._piece_bytes, self._log, self._name = piece_bytes, log, name

    def arrive(self, count: int) -> None:
        self.unread_bytes += count
        self.reader.receive()

    def read(self) -> None:
        began_s = loop().time()
        self.unread_bytes -= min(self._piece_bytes, self.unread_bytes)
        self._log.append(self._name)
        loop().burn(self.cost_s)
        self.turns.end(began_s)


def loop() -> VirtualLoop:
    running = asyncio.get_running_loop()
    assert isinstance(running, VirtualLoop)
    return running


def in_loop(work: Callable[[FairShare, list[str]], None], *, turns: int = 50) -> tuple[FairShare, list[str]]:
    """Run the work, then some turns of the loop. Return the share and the log."""

    async def run() -> tuple[FairShare, list[str]]:
        share, log = FairShare(), list[str]()
        work(share, log)
        for _ in range(turns):
            await asyncio.sleep(0)
        return share, log

    return run_virtual(run())


def test_free_turn_is_used_at_once() -> None:
    def work(share: FairShare, log: list[str]) -> None:
        source = FakeSource(share, piece_bytes=10, cost_s=0.0, log=log, name="a")
        source.arrive(25)
        assert log == ["a", "a", "a"]
        assert source.unread_bytes == 0

    assert in_loop(work)[0].waits == 0


def test_used_up_turn_defers_the_rest_of_the_pieces() -> None:
    def work(share: FairShare, log: list[str]) -> None:
        source = FakeSource(share, piece_bytes=10, cost_s=TURN_S, log=log, name="a")
        source.arrive(30)
        assert log == ["a"]

    assert in_loop(work)[1] == ["a", "a", "a"]


def test_bytes_that_arrive_while_waiting_cause_no_second_wait() -> None:
    def work(share: FairShare, log: list[str]) -> None:
        source = FakeSource(share, piece_bytes=10, cost_s=TURN_S, log=log, name="a")
        source.arrive(20)
        source.arrive(10)
        source.arrive(10)
        assert share.waits == 1

    share, log = in_loop(work)
    assert log == ["a"] * 4
    assert share.waits == 3


def test_calm_reader_has_three_quarters_of_the_time_during_a_flood() -> None:
    def work(share: FairShare, log: list[str]) -> None:
        FakeSource(share, piece_bytes=10, cost_s=TURN_S, log=log, name="busy").arrive(10)
        FakeSource(share, piece_bytes=READ_BYTES, cost_s=TURN_S, log=log, name="flood").arrive(3 * READ_BYTES)
        FakeSource(share, piece_bytes=10, cost_s=TURN_S, log=log, name="calm").arrive(60)

    first, *others = in_loop(work)[1]
    assert (first, others[0], others[4:6].count("flood")) == (
        "busy",
        "flood",
        1,
    )  # the fourth or, by rounding, the fifth
    assert others[1:4] == ["calm"] * 3


def test_reader_is_calm_again_after_its_flood() -> None:
    def work(share: FairShare, log: list[str]) -> None:
        source = FakeSource(share, piece_bytes=READ_BYTES // 8, cost_s=0.0, log=log, name="former")
        source.arrive(READ_BYTES)
        log.clear()
        source.cost_s = TURN_S
        FakeSource(share, piece_bytes=10, cost_s=TURN_S, log=log, name="busy").arrive(10)
        FakeSource(share, piece_bytes=READ_BYTES, cost_s=TURN_S, log=log, name="flood").arrive(3 * READ_BYTES)
        source.arrive(READ_BYTES // 2)

    assert in_loop(work)[1][:5] == ["busy", "flood", "former", "former", "former"]


def test_end_follows_the_last_piece() -> None:
    def work(share: FairShare, log: list[str]) -> None:
        source = FakeSource(share, piece_bytes=10, cost_s=TURN_S, log=log, name="a")
        source.unread_bytes, source.is_ended = 20, True
        source.reader.receive()

    assert in_loop(work)[1] == ["a", "a", "a end"]


def test_stopped_reader_reads_no_more() -> None:
    def work(share: FairShare, log: list[str]) -> None:
        source = FakeSource(share, piece_bytes=10, cost_s=TURN_S, log=log, name="a")
        source.arrive(30)
        source.reader.stop()
        source.is_ended = True
        source.arrive(10)

    assert in_loop(work)[1] == ["a"]
