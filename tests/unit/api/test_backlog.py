"""Who sends faster than it is read, and who was only delayed."""

import asyncio

from hostlink.api.backlog import MANY, Backlog
from tests.support.virtual_loop import run_virtual


class Inbox:
    """Messages that are received at once if they have come, else as they come."""

    def __init__(self) -> None:
        self.messages: asyncio.Queue[int] = asyncio.Queue()
        self.backlog = Backlog()

    async def receive(self) -> bool:
        """Whether its sender floods."""
        with self.backlog.receiving():
            await self.messages.get()
        return self.backlog.is_flooding


def test_who_drives_is_no_flood_after_the_daemon_was_busy_for_a_second() -> None:
    async def run() -> set[bool]:
        inbox, found = Inbox(), set()
        for _ in range(5):
            for number in range(50):  # of a second
                inbox.messages.put_nowait(number)
            for _ in range(50):
                found.add(await inbox.receive())
                await asyncio.sleep(0.001)  # others have their turn
            waiting = asyncio.get_running_loop().call_later(0.02, inbox.messages.put_nowait, 1)
            found.add(await inbox.receive())
            waiting.cancel()
        return found

    assert run_virtual(run()) == {False}


def test_who_sends_without_end_floods_also_while_it_is_read_slowly() -> None:
    async def run() -> list[bool]:
        inbox, found = Inbox(), []
        for number in range(10 * MANY):
            inbox.messages.put_nowait(number)
        for _ in range(10 * MANY):
            found.append(await inbox.receive())
            await asyncio.sleep(0.05)
        return found

    found = run_virtual(run())
    assert found == [False] * MANY + [True] * 9 * MANY


def test_who_flooded_floods_no_more_once_nothing_of_it_waits() -> None:
    async def run() -> bool:
        inbox = Inbox()
        for number in range(2 * MANY):
            inbox.messages.put_nowait(number)
        for _ in range(2 * MANY):
            await inbox.receive()
        asyncio.get_running_loop().call_later(0.1, inbox.messages.put_nowait, 1)
        return await inbox.receive()

    assert run_virtual(run()) is False
