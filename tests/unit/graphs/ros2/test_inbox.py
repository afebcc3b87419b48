"""What another thread puts in comes out in the loop, in order, and is bounded."""

import asyncio
import threading

from hostlink.graphs.ros2.inbox import Inbox


async def test_what_a_thread_puts_in_comes_out_in_order() -> None:
    inbox: Inbox[int] = Inbox(1000)
    thread = threading.Thread(target=lambda: [inbox.put(number) for number in range(1000)])
    thread.start()
    assert [await anext(inbox) for _ in range(1000)] == list(range(1000))
    thread.join()
    assert inbox.dropped == 0


async def test_the_oldest_goes_and_is_counted() -> None:
    inbox: Inbox[int] = Inbox(1)
    for number in range(5):
        inbox.put(number)
    assert await anext(inbox) == 4
    assert inbox.dropped == 4


async def test_a_flood_wakes_the_loop_once() -> None:
    inbox: Inbox[int] = Inbox(8)
    for number in range(10_000):
        inbox.put(number)
    loop = asyncio.get_running_loop()
    assert len(loop._ready) < 10  # type: ignore[attr-defined]
    assert await anext(inbox) == 9992


def test_a_loop_that_has_ended_is_no_error() -> None:
    async def make() -> Inbox[int]:
        return Inbox(1)

    inbox = asyncio.run(make())
    inbox.put(1)
