"""FairShare: links wait for each other's computing time, but no longer than a turn."""

import asyncio

from hostlink.core.config import LinkConfig
from hostlink.core.link.fair_share import MAX_DEFERRALS, TURN_S, FairShare
from hostlink.core.link.link import Link
from hostlink.core.protocol.events import Event
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.protocol.rosserial.session import Session
from tests.support.memory_transport import memory_pair
from tests.support.virtual_loop import VirtualLoop, run_virtual, virtual

FRAME = encode(999, b"")  # unknown topic, so each frame is an event
FRAME_COST_S = 0.0001


def loop() -> VirtualLoop:
    running = asyncio.get_running_loop()
    assert isinstance(running, VirtualLoop)
    return running


def burn(_link: Link, _event: Event) -> None:
    loop().burn(FRAME_COST_S)


async def longest_pause_s(until: asyncio.Event) -> float:
    """Longest wait of a task that requests one turn of the loop after the other."""
    longest_s, before_s = 0.0, loop().time()
    while not until.is_set():
        await asyncio.sleep(0)
        now_s = loop().time()
        longest_s, before_s = max(longest_s, now_s - before_s), now_s
    return longest_s


def flooded(links: int, frames: int) -> tuple[float, list[int]]:
    """Return the longest pause of an unrelated task, and the number of frames that each link has read."""

    async def run() -> tuple[float, list[int]]:
        share, done = FairShare(), asyncio.Event()
        ends, running, made = [], [], []
        for number in range(links):
            host, device = memory_pair(room_bytes=1 << 20)
            link = Link(host, Session(check=lambda _: None), LinkConfig(), number=number, on_event=burn, share=share)
            made.append(link)
            running.append(loop().create_task(link.run()))
            await device.send(FRAME * frames)
            ends.append(device)
        watching = loop().create_task(longest_pause_s(done))
        while min(link.session.counts.frames_from_device for link in made) < frames:  # noqa: ASYNC110 - virtual time does not advance
            await asyncio.sleep(0)
        done.set()
        pause_s = await watching
        for device in ends:
            await device.aclose()
        for task in running:
            await task
        return pause_s, [link.session.counts.frames_from_device for link in made]

    return run_virtual(run())


def test_floods_of_any_number_of_links_yield_the_loop_every_few_milliseconds() -> None:
    piece_s = 512 // len(FRAME) * FRAME_COST_S
    for links in (1, 2, 16):
        pause_s, read = flooded(links, 2000)
        assert read == [2000] * links
        assert pause_s <= TURN_S + 2 * piece_s


@virtual
async def test_links_that_wait_alternate() -> None:
    share, served = FairShare(), []

    async def work(number: int) -> None:
        for _ in range(20):
            await share.wait(TURN_S)
            served.append(number)
            share.spend(TURN_S)

    async with asyncio.TaskGroup() as tasks:
        for number in range(5):
            tasks.create_task(work(number))
    for end in range(len(served) - 20):  # the links end one by one
        counts = [served[:end].count(number) for number in range(5)]
        assert max(counts) - min(counts) <= 2


@virtual
async def test_calm_reader_is_served_before_flooding_readers() -> None:
    share, served = FairShare(), []

    async def work(name: str, *, is_flooding: bool) -> None:
        for _ in range(50):
            await share.wait(TURN_S, is_flooding=is_flooding)
            served.append(name)
            share.spend(TURN_S)
            if not is_flooding:
                await asyncio.sleep(0)

    async with asyncio.TaskGroup() as tasks:
        for number in range(10):
            tasks.create_task(work(f"flood {number}", is_flooding=True))
        tasks.create_task(work("robot", is_flooding=False))
    first = served.index("robot")
    assert first <= 2
    assert served[:110].count("robot") >= 40  # the others have ten times as many frames waiting by then
    assert len(served) == 11 * 50  # every frame was served


@virtual
async def test_flooding_readers_are_not_starved() -> None:
    share, reads = FairShare(), 0

    async def flood() -> None:
        nonlocal reads
        while True:
            await share.wait(TURN_S, is_flooding=True)
            reads += 1
            share.spend(TURN_S)

    async def busy() -> None:
        while True:
            await share.wait(TURN_S)
            share.spend(TURN_S)
            await asyncio.sleep(0)

    async with asyncio.TaskGroup() as tasks:
        others = [tasks.create_task(work()) for work in (flood, busy, busy, busy)]
        for _ in range(1000):
            await asyncio.sleep(0)
        for task in others:
            task.cancel()
    assert reads > 50


@virtual
async def test_small_work_of_many_fits_into_one_turn() -> None:
    share = FairShare()
    for _ in range(100):
        await share.wait(TURN_S / 1000)
        share.spend(TURN_S / 1000)
    assert share.waits == 0


@virtual
async def test_cancelled_reader_does_not_block_the_others() -> None:
    share, served = FairShare(), []

    async def work(name: str) -> None:
        await share.wait(TURN_S)
        served.append(name)
        share.spend(TURN_S)

    async with asyncio.TaskGroup() as tasks:
        for name in ("first", "second", "third"):
            task = tasks.create_task(work(name))
            if name == "second":
                loop().call_soon(task.cancel)  # after its first step, in which it began to wait
    assert served == ["first", "third"]


@virtual
async def test_unexpectedly_expensive_work_delays_the_others() -> None:
    share, turns, turn = FairShare(), [], 0

    async def work() -> None:
        await share.wait(0.0)  # all of them may be admitted at once
        turns.append(turn)
        share.spend(TURN_S)

    async with asyncio.TaskGroup() as tasks:
        for _ in range(MAX_DEFERRALS + 1):
            tasks.create_task(work())
        for turn in range(30):  # noqa: B007 - `work` reads it
            await asyncio.sleep(0)
    assert len(turns) == len(set(turns)) == MAX_DEFERRALS + 1


@virtual
async def test_calm_readers_do_not_each_wait_for_a_flood() -> None:
    piece_s, calm_s, many, floods = 0.003, 0.0004, 17, 16
    share, longest_s = FairShare(), 0.0

    async def flood() -> None:
        while True:
            await share.wait(piece_s, is_flooding=True)
            loop().burn(piece_s)
            share.spend(piece_s)

    async def calm() -> None:
        nonlocal longest_s
        for _ in range(100):
            began_s = loop().time()
            await share.wait(calm_s)
            longest_s = max(longest_s, loop().time() - began_s)
            loop().burn(calm_s)
            share.spend(calm_s)

    async with asyncio.TaskGroup() as tasks:
        flooding = [tasks.create_task(flood()) for _ in range(floods)]
        for waiting in [tasks.create_task(calm()) for _ in range(many)]:
            await waiting
        for task in flooding:
            task.cancel()
    assert longest_s <= many * calm_s * 4 / 3 + 2 * piece_s


@virtual
async def test_flooding_reader_has_a_quarter_of_the_time_while_calm_ones_wait() -> None:
    share, spent_s = FairShare(), {"flood": 0.0, "calm": 0.0}

    async def work(name: str, cost_s: float) -> None:
        while True:
            await share.wait(cost_s, is_flooding=name == "flood")
            loop().burn(cost_s)
            share.spend(cost_s)
            spent_s[name] += cost_s

    async with asyncio.TaskGroup() as tasks:
        running = [tasks.create_task(work("flood", 0.003)) for _ in range(4)]
        running += [tasks.create_task(work("calm", 0.0004)) for _ in range(8)]
        while loop().time() < 1.0:  # noqa: ASYNC110 - virtual time does not advance
            await asyncio.sleep(0)
        for task in running:
            task.cancel()
    assert 0.2 < spent_s["flood"] / sum(spent_s.values()) < 0.3
