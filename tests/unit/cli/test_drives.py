"""The table of drives, in the width of a terminal."""

import time
from collections.abc import Iterator
from datetime import datetime, timedelta, timezone
from typing import Any, cast

import pytest

from hostlink.cli.local_time import offset, time_text, wall_text
from hostlink.cli.output import table
from hostlink.cli.record import HEADS, NEWEST, _incidents, progress, row, write_newest
from hostlink.client import Host
from hostlink.components.recorder.folder import file_stamp
from hostlink.errors import HostlinkError

NOW = datetime(2026, 11, 22, 12, tzinfo=timezone(timedelta(hours=1)))
LATER = NOW + timedelta(days=1)


def drive(**changes: Any) -> dict[str, Any]:
    known = {
        "robot": "robot_0",
        "owner": "client 12",
        "address": "10.0.0.105",
        "seconds": 72.94,
        "end": "the driver left",
    }
    return {"began": "2026-11-22T08:40:57.123+00:00", "fastest_m_s": 0.3436, "fastest_rad_s": 1.5, **known, **changes}


@pytest.fixture(autouse=True)
def _berlin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The computer's clock shows the time of Berlin."""
    monkeypatch.setenv("TZ", "CET-1CEST,M3.5.0,M10.5.0/3")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


def test_a_drive_of_today_has_its_time_alone() -> None:
    assert row(drive(), NOW)[:4] == ["09:40:57", "72.9", "robot_0", "client 12 (10.0.0.105)"]
    assert row(drive(), LATER)[0] == "2026-11-22 09:40:57"
    assert row(drive(end=""), NOW)[-1] == "drives now"
    assert row({**drive(), "address": ""}, NOW)[3] == "client 12"


def test_the_lines_of_a_lesson_fit_80_columns() -> None:
    drives = [drive(), drive(owner="demo", address="", end=""), drive(end="no command came", seconds=4.0)]
    lines = table(["UTC+1", *HEADS], [row(each, NOW) for each in drives])[1:]
    assert max(map(len, lines)) <= 80


def test_time_of_an_incident_of_today_has_no_date() -> None:
    assert time_text("2026-11-22T08:40:57Z", NOW) == "09:40:57"
    assert time_text("2026-11-21T08:40:57Z", NOW) == "2026-11-21 09:40:57"
    assert time_text("2026-11-21T23:40:57.9+00:00", NOW) == "00:40:57"


def test_time_with_another_offset_than_now_has_its_own() -> None:
    assert time_text("2026-07-21T23:40:57.9+00:00", NOW) == "2026-07-22 01:40:57 UTC+2"


@pytest.mark.parametrize(
    ("minutes", "text"), [(0, "UTC"), (60, "UTC+1"), (-210, "UTC-3:30"), (345, "UTC+5:45"), (-30, "UTC-0:30")]
)
def test_offset_is_short(minutes: int, text: str) -> None:
    assert offset(NOW.astimezone(timezone(timedelta(minutes=minutes)))) == text


def test_time_of_a_recording_is_local_with_its_offset_and_the_name_of_its_file_is_utc() -> None:
    assert wall_text(1_795_336_857_900_000_000) == "2026-11-22 09:40:57 UTC+1"
    assert file_stamp(1_795_336_857_900_000_000) == "2026-11-22T08-40-57Z"


def test_long_list_shows_the_newest_and_how_many_are_older(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [[f"row {number}"] for number in range(1001)]
    write_newest(["when"], rows, None, whole=[])
    out, err = capsys.readouterr()
    assert out.splitlines()[1:] == [f"row {number}" for number in range(NEWEST)]
    assert err == "981 older ones are not listed; -n 1001 lists them too\n"
    write_newest(["when"], rows, 1000, whole=[])
    assert capsys.readouterr().err == "1 older one is not listed; -n 1001 lists them too\n"
    write_newest(["when"], rows, 1001, whole=[])
    assert capsys.readouterr().err == ""


def test_small_recording_has_its_size_in_kilobytes() -> None:
    view = {"seconds": 3.2, "messages": 1, "bytes": 17_234, "dropped": 0}
    assert progress(view) == "0:03  1 message  17.2 kB  0 dropped"


class _Host:
    """A host with two incidents of robots, and one more robot."""

    async def get(self, _: str) -> dict[str, Any]:
        return {"incidents": [{"robot": name, "file": f"{name}.mcap"} for name in ("mule", "donkey")], "pending": 0}

    async def robots(self) -> list[dict[str, Any]]:
        return [{"name": "horse"}]


async def test_incidents_are_listed_of_one_robot() -> None:
    host = cast("Host", _Host())
    assert [each["robot"] for each in (await _incidents(host, None))["incidents"]] == ["mule", "donkey"]
    assert [each["robot"] for each in (await _incidents(host, "/mule"))["incidents"]] == ["mule"]
    assert (await _incidents(host, "horse"))["incidents"] == []
    with pytest.raises(HostlinkError, match="there is no robot named mul; similar names: mule; `hostlink incidents`"):
        await _incidents(host, "mul")
    with pytest.raises(
        HostlinkError, match=r"mule\.mcap is the file of an incident; `hostlink incidents NAME -o FILE`"
    ):
        await _incidents(host, "mule.mcap")
