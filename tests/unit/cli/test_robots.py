"""`hostlink stop`, `lock` and `unlock` of several robots, and of all."""

import asyncio
from typing import Any, cast

import pytest

from hostlink.cli.robots import _halt, _lock, _stop, _unlock
from hostlink.client import Host, Robot, Standstill, StandstillState
from hostlink.errors import HostlinkError

STOPPED = Standstill(StandstillState.STOPPED, 0.0, 0.0, 0.0)


class _Host:
    """A host with robots of these names, which notes what is asked of it."""

    def __init__(self, *names: str) -> None:
        self.names = names
        self.asked: list[str] = []

    async def robots(self) -> list[dict[str, Any]]:
        return [{"name": name, "locked": True} for name in self.names]

    def robot(self, name: str) -> Any:
        return _Robot(self, name)

    async def stop_all(self) -> dict[str, Standstill]:
        self.asked.append("stop all")
        return await self.standstill()

    async def standstill(self) -> dict[str, Standstill]:
        return dict.fromkeys(self.names, STOPPED)


class _Robot:
    def __init__(self, host: _Host, name: str) -> None:
        self.host, self.name = host, name

    async def unlock(self) -> None:
        self.host.asked.append(f"unlock {self.name}")

    async def state(self) -> dict[str, Any]:
        return {"name": self.name}


@pytest.fixture
def halted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Commands that robots got; the commands of the shell name the methods of Robot."""
    asked: list[str] = []

    def noting(word: str) -> Any:
        async def halt(robot: Any, **_: object) -> Standstill:
            asked.append(f"{word} {robot.name}")
            return STOPPED

        return halt

    for word in ("stop", "lock"):
        monkeypatch.setattr(Robot, word, noting(word))
    return asked


async def test_no_stop_waits_for_a_robot_whose_daemon_does_not_answer(capsys: pytest.CaptureFixture[str]) -> None:
    is_near_stopped = asyncio.Event()

    async def stop(robot: Robot, *, wait_s: float) -> Standstill:
        if robot.name == "far":
            await is_near_stopped.wait()
            raise HostlinkError("far does not answer")
        is_near_stopped.set()
        return STOPPED

    async with asyncio.timeout(1.0):
        with pytest.raises(HostlinkError, match="far does not answer"):
            await _halt(cast("Host", _Host("far", "near")), ["far", "near"], stop, json=False, of_all="")
    assert capsys.readouterr().out.startswith("near is stopped")


@pytest.mark.parametrize("names", [["all"], ["*"], ["ALL"], ["/all"], ["far", "all"], ["all", "nonsense"], []])
async def test_the_word_all_stops_locks_and_unlocks_every_robot(names: list[str], halted: list[str]) -> None:
    made = _Host("far", "near")
    host = cast("Host", made)
    await _stop(host, names, json=False)
    assert made.asked == ["stop all"]
    await _lock(host, names, "a foot", json=False)
    assert halted == ["lock far", "lock near"]
    await _unlock(host, names, everything=not names)
    assert made.asked[1:] == ["unlock far", "unlock near"]


async def test_a_robot_that_is_named_all_keeps_its_name(halted: list[str]) -> None:
    made = _Host("all", "near")
    host = cast("Host", made)
    await _stop(host, ["all"], json=False)
    await _lock(host, ["all"], "a foot", json=False)
    await _unlock(host, ["all"], everything=False)
    assert (halted, made.asked) == (["stop all", "lock all"], ["unlock all"])


async def test_the_refusal_of_an_unknown_robot_names_the_command_for_every_robot(halted: list[str]) -> None:
    host = cast("Host", _Host("robot_0"))
    for wanted, done in (
        ("`hostlink stop` stops every robot", _stop(host, ["robot_9"], json=False)),
        ("`hostlink lock` locks every robot", _lock(host, ["robot_9"], "a foot", json=False)),
    ):
        with pytest.raises(HostlinkError, match="no robot named robot_9") as found:
            await done
        assert str(found.value).endswith(wanted)
    assert halted == []
