"""Virtual time: timers fire in order and at their time, waiting costs nothing, a deadlock says who waits."""

import asyncio
import time

import pytest

from tests.support.memory_transport import memory_pair
from tests.support.virtual_loop import Deadlock, run_virtual, virtual

HOUR_S = 3600.0


async def now_after(delay_s: float) -> float:
    await asyncio.sleep(delay_s)
    return asyncio.get_running_loop().time()


def test_an_hour_passes_at_once() -> None:
    began_s = time.monotonic()
    assert run_virtual(now_after(HOUR_S)) == HOUR_S
    assert time.monotonic() - began_s < 1.0


def test_a_year_is_more_than_the_longest_wait_of_asyncio() -> None:
    assert run_virtual(now_after(365 * 24 * HOUR_S)) == pytest.approx(365 * 24 * HOUR_S)


@virtual
async def test_timers_fire_in_the_order_of_their_times() -> None:
    fired: list[float] = []

    async def fire(at_s: float) -> None:
        fired.append(await now_after(at_s))

    async with asyncio.TaskGroup() as tasks:
        for at_s in (3.0, 0.25, 7.5, 0.0):
            tasks.create_task(fire(at_s))
    assert fired == [0.0, 0.25, 3.0, 7.5]


@virtual
async def test_ready_callbacks_run_before_time_moves() -> None:
    host, device = memory_pair()
    async with asyncio.timeout(1.0):
        for _ in range(1000):
            await device.send(b"x")
            await host.receive()
    assert asyncio.get_running_loop().time() == 0.0


@virtual
async def test_a_timeout_happens_at_its_time() -> None:
    host, _ = memory_pair()
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(11.0):
            await host.receive()
    assert asyncio.get_running_loop().time() == 11.0


def test_a_deadlock_names_the_tasks_and_where_they_wait() -> None:
    async def never() -> None:
        await asyncio.sleep(2.0)
        await asyncio.Event().wait()

    async def main() -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(never(), name="the silent one")

    with pytest.raises(
        Deadlock,
        match=r"deadlock at 2 s: nothing is ready and no timer is set\n(.*\n)*  the silent one waits in .*never",
    ):
        run_virtual(main())


def test_a_deadlock_cancels_what_waits() -> None:
    cleaned: list[str] = []

    async def main() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            cleaned.append("main")

    with pytest.raises(Deadlock):
        run_virtual(main())
    assert cleaned == ["main"]


def test_errors_pass_through() -> None:
    async def main() -> None:
        await asyncio.sleep(1.0)
        raise LookupError("as it is")

    with pytest.raises(LookupError, match="as it is"):
        run_virtual(main())


def test_sockets_have_no_place_here() -> None:
    async def main() -> None:
        await asyncio.open_connection("127.0.0.1", 1)

    with pytest.raises(NotImplementedError):
        run_virtual(main())


@virtual
async def test_work_for_a_thread_is_done_at_once() -> None:
    with pytest.raises(ZeroDivisionError):
        await asyncio.to_thread(divmod, 1, 0)
    assert (await asyncio.to_thread(sum, [1, 2]), asyncio.get_running_loop().time()) == (3, 0.0)
