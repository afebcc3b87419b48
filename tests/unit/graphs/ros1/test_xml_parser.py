"""Large bodies are parsed in a thread, one at a time; small ones at once."""

import asyncio
import threading
import time

import pytest

from hostlink.graphs.ros1.local_node import THREAD_BYTES, Rpc


async def test_a_small_body_is_parsed_at_once() -> None:
    assert await Rpc().parse(lambda _: threading.get_ident(), bytes(THREAD_BYTES)) == threading.get_ident()


async def test_large_bodies_are_parsed_beside_the_loop_one_at_a_time() -> None:
    running, most, threads = 0, 0, set()

    def decode(body: bytes) -> int:
        nonlocal running, most
        running += 1
        most = max(most, running)
        threads.add(threading.get_ident())
        time.sleep(0.01)
        running -= 1
        return len(body)

    parser = Rpc()
    async with asyncio.TaskGroup() as tasks:
        parsing = [tasks.create_task(parser.parse(decode, bytes(THREAD_BYTES + size))) for size in range(1, 6)]
    assert [each.result() for each in parsing] == [THREAD_BYTES + size for size in range(1, 6)]
    assert threading.get_ident() not in threads
    assert most == 1


async def test_error_of_the_decoder_is_raised() -> None:
    def decode(_: bytes) -> None:
        raise ValueError("none")

    with pytest.raises(ValueError, match="none"):
        await Rpc().parse(decode, bytes(2 * THREAD_BYTES))
