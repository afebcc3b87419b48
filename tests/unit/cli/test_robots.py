"""`hostlink stop` and `lock` of several robots."""

import asyncio
from typing import Any, cast

import pytest

from hostlink.cli.robots import _halt
from hostlink.client import Host, Robot, Standstill, StandstillState
from hostlink.errors import HostlinkError

STOPPED = Standstill(StandstillState.STOPPED, 0.0, 0.0, 0.0)


class _Host:
    """A host with two robots."""

    async def robots(self) -> list[dict[str, Any]]:
        return [{"name": "far"}, {"name": "near"}]

    def robot(self, name: str) -> str:
        return name

    async def standstill(self) -> dict[str, Standstill]:
        return {"far": STOPPED, "near": STOPPED}


async def test_no_stop_waits_for_a_robot_whose_daemon_does_not_answer(capsys: pytest.CaptureFixture[str]) -> None:
    is_near_stopped = asyncio.Event()

    async def stop(robot: Robot, *, wait_s: float) -> Standstill:
        if cast("str", robot) == "far":
            await is_near_stopped.wait()
            raise HostlinkError("far does not answer")
        is_near_stopped.set()
        return STOPPED

    async with asyncio.timeout(1.0):
        with pytest.raises(HostlinkError, match="far does not answer"):
            await _halt(cast("Host", _Host()), ["far", "near"], stop, json=False)
    assert capsys.readouterr().out.startswith("near is stopped")
