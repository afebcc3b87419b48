"""Recordings over REST: started, stopped, listed and removed."""

import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

from hostlink.components.gateway.recordings import RecordingRoutes, send_file
from hostlink.components.recorder.recordings import Recordings
from tests.support.hosts import recordings_of
from tests.support.participants import ROBOT
from tests.support.rest_memory import RestMemory, rest_memory

PATH = "/api/recordings"


@contextlib.asynccontextmanager
async def recorded(folder: Path) -> AsyncIterator[tuple[RestMemory, Recordings]]:
    async with rest_memory(settle_s=0.05) as api:
        made = recordings_of(api.hub)
        made.folder.path, made.folder.min_free_disk_mb, made.max_file_bytes = folder, 0.0, 1_000_000
        api.host.offer(made)
        api.add(RecordingRoutes(api.host).routes())
        try:
            yield api, made
        finally:
            await made.aclose()


async def test_recording_is_started_listed_stopped_and_removed(tmp_path: Path) -> None:
    async with recorded(tmp_path) as (api, _):
        status, view = await api.call("POST", PATH, {"name": "run", "robots": [ROBOT], "topics": ["/robot_0/*"]})
        assert (status, view["name"], view["owner"], view["files"]) == (200, "run", "phone", ["run.mcap"])
        assert view["dropped"] == 0
        assert "failure" not in view
        _, listed = await api.call("GET", PATH)
        assert [each["name"] for each in listed["recordings"]] == ["run"]
        assert [(each["file"], each["is_open"]) for each in listed["files"]] == [("run.mcap", True)]
        assert listed["folder"] == str(tmp_path)
        assert (await api.call("DELETE", f"{PATH}/run.mcap"))[0] == 409
        status, view = await api.call("POST", f"{PATH}/run/stop")
        assert (status, view["name"], view["bytes"]) == (200, "run", (tmp_path / "run.mcap").stat().st_size)
        _, listed = await api.call("GET", PATH)
        (file,) = listed["files"]
        assert (listed["recordings"], file["is_open"], file["bytes"]) == ([], False, view["bytes"])
        assert len(file["modified"]) == len("2026-01-02T03:04:05Z")
        assert await api.call("DELETE", f"{PATH}/run.mcap") == (200, {"removed": "run.mcap"})
        assert (await api.call("GET", PATH))[1]["files"] == []


async def test_request_without_a_body_records_everything_under_a_name_of_its_own(tmp_path: Path) -> None:
    async with recorded(tmp_path) as (api, made):
        status, view = await api.call("POST", PATH, b"")
        (recording,) = made.under_way()
        assert (status, view["name"]) == (200, recording.name)
        assert (recording.selection.topics, recording.selection.robots) == ((), ())


async def test_failed_recording_shows_its_failure(tmp_path: Path) -> None:
    async with recorded(tmp_path) as (api, made):
        await api.call("POST", PATH, {"name": "run"})
        made.under_way()[0].thread.failure = "No space left on device"
        _, listed = await api.call("GET", PATH)
        assert listed["recordings"][0]["failure"] == "No space left on device"


async def test_recording_that_cannot_be_started_or_found_is_an_error(tmp_path: Path) -> None:
    async with recorded(tmp_path) as (api, made):
        for body, status in (
            ({"robots": ["robot_9"]}, 404),
            ({"name": "../x"}, 400),
            ({"topics": "all"}, 400),
            ({"odd": 1}, 400),
            (b"{", 400),
        ):
            assert (await api.call("POST", PATH, body))[0] == status
        assert made.under_way() == []
        for method, path in (("POST", f"{PATH}/none/stop"), ("GET", f"{PATH}/none"), ("DELETE", f"{PATH}/none")):
            status, answer = await api.call(method, path)
            assert (status, answer["error"]["kind"]) == (404, "UnknownTopic")
        await api.call("POST", PATH, {"name": "run"})
        status, answer = await api.call("POST", PATH, {"name": "run"})
        assert (status, answer["error"]["kind"]) == (409, "RecordingBusy")


def test_file_is_sent_under_its_name_and_kept_by_no_cache(tmp_path: Path) -> None:
    answer = send_file(tmp_path / "run.mcap")
    assert answer.headers["Content-Disposition"] == 'attachment; filename="run.mcap"'
    assert (answer.headers["Cache-Control"], answer.content_type) == ("no-store", "application/octet-stream")
