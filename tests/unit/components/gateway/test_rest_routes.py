"""REST routes other than those of a robot: drives, reload, listening, standstills, and the history of the fleet."""

import asyncio
import json
from pathlib import Path

import pytest

from hostlink.components.recorder.drives import Drive, DriveLog
from hostlink.core.config import Config, RobotConfig
from tests.support.api_memory import Answer, ApiMemory, api_memory
from tests.support.participants import ROBOT
from tests.support.rest_memory import RestMemory, rest_memory
from tests.support.virtual_loop import run_virtual, within
from tests.support.waiting import expect

S = 1_000_000_000


def drive(robot: str, *, ended_s: float = 12.5, seconds: float | None = 2.0) -> Drive:
    return Drive(
        robot=robot, owner="ann", address="10.0.0.3", priority=50, began_ns=10 * S, ended_ns=int(ended_s * S),
        seconds=seconds, commands=7, fastest_m_s=0.123456, fastest_rad_s=-1.5, end="released",
    )  # fmt: skip


class FakeDrives(DriveLog):
    """Log of drives, which keeps what it was asked for."""

    lost = 3

    def __init__(self, *drives: Drive) -> None:
        self.drives, self.asked = drives, list[tuple[str | None, int | None]]()

    def newest_first(self, *, robot: str | None, limit: int | None) -> list[Drive]:
        self.asked.append((robot, limit))
        return list(self.drives)


def test_drive_has_its_times_in_utc_and_rounded_figures() -> None:
    drives = FakeDrives(drive("a"), drive("b", seconds=None), drive("c", seconds=None, ended_s=9.0))

    async def test(api: RestMemory) -> None:
        status, body = await api.call("GET", "/api/drives")
        assert (status, body["lost"], [each["seconds"] for each in body["drives"]]) == (200, 3, [2.0, 2.5, 0.0])
        assert body["drives"][0] == {
            "robot": "a", "owner": "ann", "address": "10.0.0.3", "priority": 50,
            "began": "1970-01-01T00:00:10.000+00:00", "ended": "1970-01-01T00:00:12.500+00:00", "seconds": 2.0,
            "commands": 7, "fastest_m_s": 0.1235, "fastest_rad_s": -1.5, "end": "released",
        }  # fmt: skip
        await api.call("GET", "/api/drives?robot=b&limit=999999")
        assert drives.asked == [(None, None), ("b", 999999)]

    within(rest_memory, drives=drives)(test)()


@pytest.mark.parametrize("limit", ["", "-1", "1.5", "many", "1000000", "\u0661"])
def test_limit_other_than_a_number_is_refused(limit: str) -> None:
    drives = FakeDrives()

    async def test(api: RestMemory) -> None:
        status, body = await api.call("GET", f"/api/drives?limit={limit}")
        assert (status, body["error"]["kind"], drives.asked) == (400, "BadRequest", [])

    within(rest_memory, drives=drives)(test)()


async def test_reload_answers_what_has_changed_and_why_it_is_refused() -> None:
    config = Config(robots={ROBOT: RobotConfig(max_linear_m_s=0.2)})
    async with rest_memory(settle_s=0.05, read=lambda: config) as api:
        status, body = await api.call("POST", "/api/reload")
        assert (status, body) == (
            200,
            {"changed": [f"robots.{ROBOT}.max_linear_m_s"], "needs_restart": [], "renamed": {}},
        )
        await expect(lambda: api.hub.robots.find_here(ROBOT).config.max_linear_m_s == 0.2)


async def test_reload_without_a_file_is_a_conflict() -> None:
    async with rest_memory(settle_s=0.05) as api:
        status, body = await api.call("POST", "/api/reload")
        assert (status, body["error"]["kind"]) == (409, "ReloadRefused")


@within(rest_memory)
async def test_listening_is_empty_before_any_port_is_open(api: RestMemory) -> None:
    status, body = await api.call("GET", "/api/listening")
    assert (status, body["tcp"], body["udp"], body["serial"]) == (200, None, None, [])


@within(rest_memory)
async def test_standstill_is_measured_without_stopping(api: RestMemory) -> None:
    await api.call("PUT", f"/api/robots/{ROBOT}/velocity", {"linear": 0.2, "angular": 0.0})
    epoch = api.hub.robots.find(ROBOT).admission.epoch
    status, one = await api.call("GET", f"/api/robots/{ROBOT}/standstill?wait_s=0.1")
    assert (status, one["standstill"]["state"]) == (200, "unknown")
    status, all_ = await api.call("GET", "/api/standstill?wait_s=0.1")
    assert (status, [each["name"] for each in all_["robots"]]) == (200, [ROBOT])
    assert api.hub.robots.find(ROBOT).admission.epoch == epoch


def test_history_of_the_fleet_has_commands_of_the_chosen_robot_alone(tmp_path: Path) -> None:
    async def test(api: ApiMemory) -> None:
        for chosen in ("", ROBOT):
            answer = await api.request("GET", f"/api/history?chosen={chosen}", Accept_Encoding="identity")
            assert answer.status == 200
            (robot,) = json.loads(body_of(answer))["robots"]
            assert robot == {"name": ROBOT, "poses": [], "commands": [], "plot_data": [], "events": []}
        await api.device.aclose()
        await asyncio.sleep(0.1)
        api.hub.robots.forget(ROBOT)
        answer = await api.request("GET", "/api/history", Accept_Encoding="identity")
        assert json.loads(body_of(answer)) == {"robots": []}

    async def run() -> None:
        async with api_memory(tmp_path) as api:
            await test(api)

    run_virtual(run())


def body_of(answer: Answer) -> bytes:
    """Join the chunks of a body."""
    if answer.headers.get("Transfer-Encoding") != "chunked":
        return answer.body
    joined, rest = b"", answer.body
    while rest:
        size, _, rest = rest.partition(b"\r\n")
        joined, rest = joined + rest[: int(size, 16)], rest[int(size, 16) + 2 :]
    return joined
