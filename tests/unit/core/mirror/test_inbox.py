"""From other threads to the loop: bounded for each source, in turns, and a failure affects no other item."""

import asyncio
import itertools
import threading
from collections import Counter

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hostlink.components.zenoh.session import ZenohSample
from hostlink.core.hub.isolation import Isolation
from hostlink.core.mirror.inbox import MAX_SOURCES, MAX_WAITING_BYTES, ThreadInbox


async def settled() -> None:
    for _ in range(50):
        await asyncio.sleep(0)


async def test_items_arrive_in_the_loop_in_order() -> None:
    received: list[int] = []
    inbox = ThreadInbox(received.append)
    thread = threading.Thread(target=lambda: [inbox.put("a", number) for number in range(100)])
    thread.start()
    thread.join()
    assert received == []
    await settled()
    assert received == list(range(100))


async def test_flooding_source_loses_only_its_own_oldest_items() -> None:
    received: list[tuple[str, int]] = []
    counts: Counter[str] = Counter()
    inbox = ThreadInbox(received.append, counts=counts, max_waiting=10)
    inbox.put("calm", ("calm", 0))
    for number in range(1000):
        inbox.put("flood", ("flood", number))
    await settled()
    assert ("calm", 0) in received
    assert [number for who, number in received if who == "flood"] == list(range(990, 1000))
    assert counts["dropped"] == 990


async def test_only_needed_items_of_a_source_wait() -> None:
    received: list[int] = []
    counts: Counter[str] = Counter()
    inbox = ThreadInbox(
        received.append, counts=counts, needed=lambda waiting: waiting[-1:], is_known=lambda source: source != "shared"
    )
    for number in range(5):
        inbox.put("a", number)
        inbox.put("shared", -number)
        inbox.put("b", 10 + number)
    await settled()
    assert sorted(received) == [-4, 4, 14]
    assert counts["dropped"] == 12


async def test_sources_take_turns() -> None:
    received: list[str] = []
    inbox = ThreadInbox(received.append)
    for source in "aaab":
        inbox.put(source, source)
    await settled()
    assert received == ["a", "b", "a", "a"]


class Interleaving:
    """Steps of threads, in one order with the deliveries of the loop: None is the next one.

    `put a` queues the next number of source a; `know a` and `forget a` change whether that source is known.
    """

    def __init__(self, steps: list[str | None], *, max_waiting: int) -> None:
        self.delivered: dict[str, list[int]] = {source: [] for source in SOURCES}
        self.meant: dict[str, int] = {}  # the newest number of each source that was known when it was put
        self._known: set[str] = set()
        self._steps, self._numbers = iter(steps), itertools.count()
        self._inbox = ThreadInbox(self._deliver, max_waiting=max_waiting, is_known=self._known.__contains__)

    async def run(self) -> None:
        while self._step():
            await settled()
        await settled()

    def _deliver(self, item: tuple[str, int]) -> None:
        self.delivered[item[0]].append(item[1])
        self._step()

    def _step(self) -> bool:
        """Take the steps until the next delivery; return whether there may be more."""
        for step in self._steps:
            if step is None:
                return True
            what, source = step.split()
            match what:
                case "put":
                    number = next(self._numbers)
                    self.meant.pop(source, None)
                    if source in self._known:
                        self.meant[source] = number
                    self._inbox.put(source, (source, number))
                case "know":
                    self._known.add(source)
                case _:
                    self._known.discard(source)
        return False


SOURCES = "abc"
STEPS = [None, *(f"{what} {source}" for source in SOURCES for what in ("put", "know", "forget"))]


@given(steps=st.lists(st.sampled_from(STEPS), max_size=80), max_waiting=st.sampled_from([1, 2, 64]))
@example(steps=["put a", "put a", "put a", None, "know a", "put a"], max_waiting=64)
@example(steps=["put b", "know a", "put a", "forget a", "put a"], max_waiting=1)
@example(steps=["put a", "know a", "put a", "put b"], max_waiting=1)
def test_items_of_a_source_keep_their_order_while_it_becomes_known_or_unknown(
    steps: list[str | None], max_waiting: int
) -> None:
    async def run() -> Interleaving:
        made = Interleaving(steps, max_waiting=max_waiting)
        await made.run()
        return made

    made = asyncio.run(run())
    for source, numbers in made.delivered.items():
        assert numbers == sorted(numbers)
        assert source not in made.meant or numbers[-1] == made.meant[source]


async def test_sources_that_are_not_known_share_one_queue_and_displace_no_known_one() -> None:
    received: list[str] = []
    counts: Counter[str] = Counter()
    inbox = ThreadInbox(received.append, counts=counts, max_waiting=10, is_known=lambda source: source == "known")
    inbox.put("known", "first")
    for number in range(2 * MAX_SOURCES):
        inbox.put(number, "flood")
    inbox.put("known", "second")
    await settled()
    assert (received[0], received[2]) == ("first", "second")
    assert received.count("flood") == 10
    assert counts["dropped"] == 2 * MAX_SOURCES - 10


@pytest.mark.parametrize("others", [0, 1])
async def test_source_that_becomes_known_adds_no_queue_to_the_greatest_number(others: int) -> None:
    """Without room for one more queue its items stay in the shared one, which is full of them."""
    received: list[str] = []
    known: set[object] = set()
    inbox = ThreadInbox(received.append, max_waiting=2, is_known=known.__contains__)
    for each in ["other"] * others + ["a"]:
        inbox.put(each, f"{each} 1")
    known |= {*range(MAX_SOURCES), "a"}
    for number in range(MAX_SOURCES - 1):
        inbox.put(number, "filler")
    inbox.put("a", "a 2")
    inbox.put(MAX_SOURCES - 1, "one more")
    await settled()
    assert [each for each in received if each != "filler"] == ["a 1", "a 2"]
    assert received.count("filler") == MAX_SOURCES - 1


async def test_the_number_of_sources_is_bounded() -> None:
    received: list[int] = []
    counts: Counter[str] = Counter()
    inbox = ThreadInbox(received.append, counts=counts)
    for number in range(MAX_SOURCES + 5):
        inbox.put(str(number), number)
    await settled()
    assert len(received) == MAX_SOURCES
    assert counts["dropped"] == 5


async def test_the_bytes_that_wait_are_bounded() -> None:
    received: list[ZenohSample] = []
    counts: Counter[str] = Counter()
    inbox = ThreadInbox(received.append, counts=counts)
    large = ZenohSample("key", bytes(MAX_WAITING_BYTES // 4))
    for number in range(6):
        inbox.put(str(number), large)
    assert counts["dropped"] == 2
    await settled()
    assert len(received) == 4
    for number in range(6):
        inbox.put(str(number), large)  # there is room again
    assert counts["dropped"] == 4


async def test_the_bytes_that_wait_are_bounded_also_where_an_item_is_bytes_alone() -> None:
    received: list[bytes] = []
    inbox = ThreadInbox(received.append)
    for _ in range(6):
        inbox.put("", bytes(MAX_WAITING_BYTES // 4))
    await settled()
    assert (len(received), inbox.counts["dropped"]) == (4, 2)


async def test_failing_callback_is_counted_and_the_next_item_is_delivered() -> None:
    received: list[int] = []

    def deliver(number: int) -> None:
        if number == 1:
            raise ValueError("a defect")
        received.append(number)

    isolation = Isolation()
    inbox = ThreadInbox(deliver, guarded=lambda: isolation.around("graph"))
    for number in range(3):
        inbox.put("a", number)
    await settled()
    assert received == [0, 2]
    assert isolation.crashes["graph"] == 1


async def test_closed_inbox_delivers_nothing() -> None:
    received: list[int] = []
    inbox = ThreadInbox(received.append)
    inbox.put("a", 1)
    inbox.close()
    inbox.put("a", 2)
    await settled()
    assert received == []


def test_an_item_for_a_loop_that_has_ended_is_dropped() -> None:
    received: list[int] = []

    async def make() -> ThreadInbox[int]:
        return ThreadInbox(received.append)

    inbox = asyncio.run(make())
    inbox.put("a", 1)
    assert received == []


@pytest.mark.parametrize("count", [1, 5000])
async def test_a_long_queue_leaves_the_loop_to_others(count: int) -> None:
    received: list[int] = []

    def deliver(number: int) -> None:
        received.append(number)
        sum(range(2000))

    inbox = ThreadInbox(deliver, max_waiting=count)
    for number in range(count):
        inbox.put("a", number)
    turns = 0
    while len(received) < count:
        turns += 1
        await asyncio.sleep(0)
    assert turns > count // 1000


async def test_an_item_that_would_be_too_much_leaves_the_one_that_it_would_replace() -> None:
    received: list[ZenohSample] = []
    counts: Counter[str] = Counter()
    inbox = ThreadInbox(received.append, counts=counts, max_waiting=1)
    inbox.put("small", ZenohSample("small", b"x"))
    inbox.put("large", ZenohSample("large", bytes(MAX_WAITING_BYTES - 1)))
    inbox.put("small", ZenohSample("too much", b"xx"))
    await settled()
    assert {each.key for each in received} == {"small", "large"}
    assert counts["dropped"] == 1
    inbox.put("small", ZenohSample("later", b"z"))
    await settled()
    assert received[-1].key == "later"


async def test_items_of_a_thread_are_read_in_order() -> None:
    inbox: ThreadInbox[int] = ThreadInbox(max_waiting=1000)
    thread = threading.Thread(target=lambda: [inbox.put("", number) for number in range(1000)])
    thread.start()
    assert [await anext(inbox) for _ in range(1000)] == list(range(1000))
    thread.join()
    assert inbox.counts["dropped"] == 0


async def test_a_reader_that_waits_is_woken() -> None:
    inbox: ThreadInbox[int] = ThreadInbox()
    for number in range(3):
        asyncio.get_running_loop().call_later(0.001, inbox.put, "", number)
        async with asyncio.timeout(1):
            assert await anext(inbox) == number


async def test_a_flood_wakes_the_loop_once() -> None:
    inbox: ThreadInbox[int] = ThreadInbox(max_waiting=8)
    for number in range(10_000):
        inbox.put("", number)
    loop = asyncio.get_running_loop()
    assert len(loop._ready) < 10  # type: ignore[attr-defined]
    assert await anext(inbox) == 9992
    assert inbox.counts["dropped"] == 9992
