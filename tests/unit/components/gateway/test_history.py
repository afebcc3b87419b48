"""Histories and incidents over REST: the last minutes of a robot, and the minutes around an incident."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from hostlink.components.gateway import history as module
from hostlink.components.gateway.history import (
    PIECE,
    HistoryRoutes,
    Pauses,
    encode_history,
    incident_views,
    stored_history,
)
from hostlink.components.recorder.black_box import BlackBox
from hostlink.components.recorder.folder import StoredFile
from hostlink.components.recorder.incident import Incident, SavedIncident
from hostlink.components.recorder.mcap_writer import McapWriter
from hostlink.core.runtime.folders import FolderOwner
from tests.support.hosts import black_box_of
from tests.support.participants import ODOMETRY_ID, POSE, ROBOT, VELOCITY_ID
from tests.support.rest_memory import RestMemory, rest_memory
from tests.support.waiting import TIMEOUT_S, expect

VELOCITY = f"/api/robots/{ROBOT}/velocity"
ZERO = {"linear_m_s": 0.0, "linear_y_m_s": 0.0, "angular_rad_s": 0.0}


@contextlib.asynccontextmanager
async def boxed(folder: Path) -> AsyncIterator[tuple[RestMemory, BlackBox]]:
    """Run a REST API whose black box has two poses and one command of the robot."""
    async with rest_memory(settle_s=0.05) as api:
        box = black_box_of(api.hub, folder)
        before = len(api.hub.topics.find(f"/{ROBOT}/odometry").subscribers)
        box.start()
        api.host.offer(box)
        api.add(HistoryRoutes(api.host).routes())
        await expect(lambda: len(api.hub.topics.find(f"/{ROBOT}/odometry").subscribers) > before)
        await api.device.send(ODOMETRY_ID, POSE.pack(1.00000049, 2.0, 0.5))
        await api.device.send(ODOMETRY_ID, POSE.pack(1.5, 2.0, 0.5))
        await expect(lambda: api.hub.topics.find(f"/{ROBOT}/odometry").messages == 2)
        await answered(api, "PUT", VELOCITY, {"linear": 0.2, "angular": 0.0})
        await expect(lambda: len(api.device.payloads(VELOCITY_ID)) > 1)
        try:
            yield api, box
        finally:
            await box.aclose()


async def answered(
    api: RestMemory, method: str, path: str, body: object = b"", *, holds: Callable[[Any], bool] = bool
) -> Any:
    """Repeat a request until it succeeds with an answer of which `holds` is true. A busy machine refuses late ones."""
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            status, answer = await api.call(method, path, body)
            if status == 200 and holds(answer):
                return answer
            await asyncio.sleep(0.02)


def requested(listed: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the incidents that the test requested. A stalled machine adds another one."""
    return [each for each in listed["incidents"] if each["cause"] == "requested"]


def kinds(history: dict[str, Any]) -> list[str]:
    return [each["msg"]["kind"] for each in history["events"]]


async def test_history_has_poses_commands_and_events_with_ages_oldest_first(tmp_path: Path) -> None:
    async with boxed(tmp_path) as (api, _):
        await answered(api, "POST", f"/api/robots/{ROBOT}/lock?wait_s=0")
        history = await answered(api, "GET", f"/api/robots/{ROBOT}/history", holds=lambda h: "locked" in kinds(h))
    assert [each["pose"] for each in history["poses"]] == [
        {"x_m": 1.0, "y_m": 2.0, "theta_rad": 0.5},
        {"x_m": 1.5, "y_m": 2.0, "theta_rad": 0.5},
    ]
    assert next(each["velocity"] for each in history["commands"] if each["velocity"] != ZERO) == {
        "linear_m_s": 0.2,
        "linear_y_m_s": 0.0,
        "angular_rad_s": 0.0,
    }
    for part in ("poses", "commands", "events"):
        ages = [each["age_s"] for each in history[part]]
        assert ages == sorted(ages, reverse=True)
        assert all(0.0 <= age_s < 30.0 for age_s in ages)


async def test_history_of_an_unknown_robot_is_answered_404(tmp_path: Path) -> None:
    async with boxed(tmp_path) as (api, _):
        status, body = await api.call("GET", "/api/robots/robot_9/history")
    assert (status, body["error"]["kind"]) == (404, "UnknownTopic")


async def test_saved_incident_is_pending_and_then_a_file_with_its_history(tmp_path: Path) -> None:
    async with boxed(tmp_path) as (api, box):
        status, view = await api.call("POST", "/api/incidents", {"robot": ROBOT, "reason": "it turned left"})
        assert (status, view["cause"], view["detail"], view["file"], view["bytes"]) == (
            200, "requested", "it turned left", "", 0,
        )  # fmt: skip
        assert len(view["at"]) == len("2026-01-02T03:04:05Z")
        _, listed = await api.call("GET", "/api/incidents")
        assert (requested(listed), listed["missed"]) == ([view], 0)
        assert listed["folder"] == str(tmp_path / "incidents")
        await box.aclose()
        _, listed = await api.call("GET", "/api/incidents")
        (saved,) = requested(listed)
        assert saved["file"].endswith(".mcap")
        assert saved["bytes"] == (tmp_path / "incidents" / saved["file"]).stat().st_size
        assert saved | {"file": "", "bytes": 0} == view
        status, found = await api.call("GET", f"/api/incidents/{saved['file']}/history")
    assert (status, found["damage"], found["robot"]) == (200, [], ROBOT)
    assert [each["pose"]["x_m"] for each in found["history"]["poses"]] == [1.0, 1.5]
    assert 0.2 in [each["velocity"]["linear_m_s"] for each in found["history"]["commands"]]
    assert all(-5.0 < each["age_s"] < 5.0 for each in found["history"]["poses"])


async def test_unknown_incident_and_request_of_an_unknown_robot_are_answered_404(tmp_path: Path) -> None:
    async with boxed(tmp_path) as (api, box):
        for path in ("none.mcap", "none.mcap/history"):
            status, body = await api.call("GET", f"/api/incidents/{path}")
            assert (status, body["error"]["reason"]) == (404, "no incident named none.mcap")
        assert (await api.call("POST", "/api/incidents", {"robot": "robot_9"}))[0] == 404
        assert (await api.call("POST", "/api/incidents", {"reason": "no robot"}))[0] == 400
        box.folder.path.mkdir()
        McapWriter(box.folder.path / "plain.mcap", metadata={"recording": "plain"}).close()
        assert stored_history(api.hub.catalog, box.folder.path / "plain.mcap") is None
        assert (await api.call("GET", "/api/incidents/plain.mcap/history"))[0] == 404


async def test_request_is_refused_where_no_incident_can_be_saved(tmp_path: Path) -> None:
    """Another daemon owns the folder, or the disk fails."""
    async with boxed(tmp_path) as (api, box):
        request = {"robot": ROBOT, "reason": "why"}
        other, box.folder.owner = FolderOwner(tmp_path, "daemon 7"), FolderOwner(tmp_path, "daemon 8")
        other.claim()
        status, body = await api.call("POST", "/api/incidents", request)
        assert (status, body["error"]["kind"]) == (409, "RecordingBusy")
        assert body["error"]["reason"].startswith(f"{tmp_path} belongs to daemon 7; set another recording.folder")
        other.release()
        (tmp_path / "file").write_text("")
        box.folder.owner = FolderOwner(tmp_path / "file", "daemon 8")
        assert (await api.call("POST", "/api/incidents", request))[0] == 507
        assert requested((await api.call("GET", "/api/incidents"))[1]) == []
        box.folder.owner = FolderOwner(tmp_path, "daemon 8")
        assert (await api.call("POST", "/api/incidents", request))[0] == 200


def test_history_is_the_same_json_for_any_number_of_pieces() -> None:
    for count in (0, 1, PIECE - 1, PIECE, PIECE + 1, 3 * PIECE):
        rests: list[None] = []
        view = {"poses": list(range(count)), "events": [{"age_s": 0.5}]}
        assert json.loads(encode_history(view, lambda: rests.append(None))) == view  # noqa: B023 - called here
        assert len(rests) == -(-count // PIECE) + 1


def test_reading_thread_pauses_only_after_it_has_worked_for_a_while(monkeypatch: Any) -> None:
    now_s, slept = 0.0, []
    monkeypatch.setattr(module.time, "perf_counter", lambda: now_s)
    monkeypatch.setattr(module.time, "sleep", slept.append)
    pauses = Pauses()
    for step in range(10):
        now_s = step * module.WORK_S / 2
        pauses()
    assert slept == [module.REST_S] * 4


OLD = Incident("robot_0", "locked", "smoke", 1_000_000_000_000)
NEW = Incident("robot_0", "gone", "its link ended while it was driven", 2_000_000_000_000)


def saved(incident: Incident) -> SavedIncident:
    return SavedIncident(incident, StoredFile(f"{incident.cause}.mcap", 9, 0.0))


@pytest.mark.parametrize(
    "pending", [[NEW], [OLD, NEW]], ids=["another", "one that was saved while the files were read"]
)
def test_pending_incidents_are_listed_first_and_a_saved_one_once(pending: list[Incident]) -> None:
    views = incident_views(pending, [saved(OLD)])
    assert [(each["cause"], each["file"]) for each in views] == [("gone", ""), ("locked", "locked.mcap")]
