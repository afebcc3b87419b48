"""Sleep of the computer: the daemon reads its clock, and treats the sleep as a pause."""

import asyncio

import pytest

from hostlink.core import running as module
from tests.support.daemon import daemon
from tests.support.waiting import expect


async def test_sleep_of_the_computer_is_a_pause_of_the_daemon(monkeypatch: pytest.MonkeyPatch) -> None:
    slept_s = 5.0
    monkeypatch.setattr(module, "slept_s", lambda: slept_s)
    async with daemon() as host:
        began_s = asyncio.get_running_loop().time()
        slept_s = 3600.0
        await expect(lambda: host.hub.gates.pauses(asyncio.get_running_loop().time()).was_paused(began_s - 1.0))
