"""The relay ends every connection that it has, whenever it is cancelled."""

import asyncio

import pytest

from tests.support.virtual_loop import run_virtual
from tools.faults import Script
from tools.relay import Relay

CLOSING_S = 1.0


class SlowEnd:
    """One connection: it ends at once or not at all, and a second passes until it is closed."""

    peer = address = "memory"

    def __init__(self, *, has_ended: bool) -> None:
        self._has_ended = has_ended
        self.is_closed = False

    async def receive(self) -> bytes:
        if not self._has_ended:
            await asyncio.get_running_loop().create_future()
        return b""

    async def send(self, data: bytes) -> None:
        raise AssertionError(f"nothing is sent in these tests, but {data!r} was")

    def round_trip_s(self) -> float | None:
        return None

    def descriptor(self) -> int | None:
        return None

    async def aclose(self) -> None:
        try:
            await asyncio.sleep(CLOSING_S)
        finally:
            self.is_closed = True

    def break_off(self) -> None:
        self.is_closed = True


@pytest.mark.parametrize("cancelled_after_s", [0.0, CLOSING_S / 2, CLOSING_S * 1.5])
@pytest.mark.parametrize("has_ended", [False, True])
def test_a_relay_that_is_cancelled_closes_both_ends(cancelled_after_s: float, *, has_ended: bool) -> None:
    device, host = SlowEnd(has_ended=has_ended), SlowEnd(has_ended=False)

    async def connect() -> SlowEnd:
        return host

    async def scenario() -> None:
        serving = asyncio.get_running_loop().create_task(relay().serve(device))
        await asyncio.sleep(cancelled_after_s)
        serving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await serving

    def relay() -> Relay:
        return Relay(Script(), connect, lambda *_: None)

    run_virtual(scenario())
    assert (device.is_closed, host.is_closed) == (True, True)


def test_a_relay_that_is_cancelled_while_it_connects_closes_the_device() -> None:
    device = SlowEnd(has_ended=False)

    async def connect() -> SlowEnd:
        return await asyncio.get_running_loop().create_future()

    async def scenario() -> None:
        relay = Relay(Script(), connect, lambda *_: None)
        async with asyncio.TaskGroup() as tasks:
            serving = tasks.create_task(relay.serve(device))
            await asyncio.sleep(1.0)
            serving.cancel()

    run_virtual(scenario())
    assert device.is_closed
