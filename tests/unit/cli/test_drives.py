"""The table of drives, in the width of a terminal."""

from typing import Any, cast

import pytest

from hostlink.cli.output import table
from hostlink.cli.record import HEADS, NEWEST, _incidents, progress, row, time_text, write_newest
from hostlink.client import Host
from hostlink.errors import HostlinkError


def drive(**changes: Any) -> dict[str, Any]:
    known = {"robot": "robot_0", "owner": "client 12", "address": "10.0.0.105", "seconds": 72.94, "end": "owner left"}
    return {"began": "2026-11-22T08:40:57.123+00:00", "fastest_m_s": 0.3436, "fastest_rad_s": 1.5, **known, **changes}


def test_a_drive_of_today_has_its_time_alone() -> None:
    assert row(drive(), "2026-11-22")[:4] == ["08:40:57", "72.9", "robot_0", "client 12 (10.0.0.105)"]
    assert row(drive(), "2026-11-23")[0] == "2026-11-22 08:40:57"
    assert row(drive(end=""), "2026-11-22")[-1] == "drives now"
    assert row({**drive(), "address": ""}, "2026-11-22")[3] == "client 12"


def test_the_lines_of_a_lesson_fit_80_columns() -> None:
    drives = [drive(), drive(owner="demo", address="", end=""), drive(end="no command came", seconds=4.0)]
    lines = table(HEADS, [row(each, "2026-11-22") for each in drives])[1:]
    assert max(map(len, lines)) <= 80


def test_time_of_an_incident_of_today_has_no_date() -> None:
    assert time_text("2026-11-22T08:40:57Z", "2026-11-22") == "08:40:57"
    assert time_text("2026-11-21T08:40:57Z", "2026-11-22") == "2026-11-21 08:40:57"


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
