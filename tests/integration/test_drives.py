"""`GET /api/drives`: who drove when; kept over a restart."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from hostlink.client import connect
from hostlink.config import Config, RecordingConfig
from hostlink.recording.drives import MAX_FILE_BYTES, MAX_RECENT, NAME, NAME_BEFORE, Drive, append_drives, read_drives
from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, robot_topics
from tests.support.process import run
from tests.support.waiting import expect


def config_in(folder: Path) -> Config:
    return Config(recording=RecordingConfig(folder=folder))


def a_drive(number: int = 0) -> Drive:
    return Drive(robot="rover", owner=f"client {number}", priority=50, began_ns=number, ended_ns=number + 1, end="over")


async def test_a_drive_is_shown_while_it_lasts_and_kept_when_it_is_over(tmp_path: Path) -> None:
    async with (
        daemon(config_in(tmp_path), has_black_box=True) as host,
        fake_device(host.tcp, robot_topics()) as device,
        connect(host.url) as program,
    ):
        await program.robot("robot_0").drive(0.3, 0.5)
        assert await device.velocity_other_than((0.0, 0.0)) == (0.3, 0.5)
        (drive,) = (await host.get("/api/drives?robot=robot_0"))["drives"]
        assert drive["address"] == (await host.get("/api/robots/robot_0"))["holder_address"] == "127.0.0.1"
        assert (drive["owner"], drive["fastest_m_s"], drive["fastest_rad_s"], drive["end"]) == (
            "client 1",
            0.3,
            0.5,
            "",
        )
        assert (await host.get("/api/drives?robot=another"))["drives"] == []
        assert [len((await host.get(f"/api/drives?limit={limit}"))["drives"]) for limit in (0, 1, 50)] == [0, 1, 1]
        for wrong in ("-1", "a", "", "1" * 5000):
            assert (await host.rest("GET", f"/api/drives?limit={wrong}"))[0] == 400
    async with daemon(config_in(tmp_path), has_black_box=True) as host:
        (drive,) = (await host.get("/api/drives"))["drives"]
        assert (drive["robot"], drive["owner"]) == ("robot_0", "client 1")
        assert drive["end"]
        assert drive["began"] <= drive["ended"]


async def test_failing_disk_is_counted_and_does_not_end_the_daemon(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with capture_logs() as lines:
        async with (
            daemon(config_in(tmp_path / "file" / "below"), has_black_box=True) as host,
            fake_device(host.tcp, robot_topics()) as device,
        ):
            await expect(lambda: host.hub.robots.has("robot_0"))
            await host.drive("robot_0", b'{"linear": 0.2, "angular": 0}')
            assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
            await host.rest("POST", "/api/robots/robot_0/lock")
            (drive,) = (await host.get("/api/drives"))["drives"]
            assert drive["end"].startswith("locked")
    assert [line["reason"] for line in lines if line["event"] == "drives.lost"] == ["Not a directory"]


async def test_drive_history_that_is_turned_off_writes_no_file(tmp_path: Path) -> None:
    config = replace(config_in(tmp_path), recording=RecordingConfig(folder=tmp_path, drives=False))
    async with daemon(config, has_black_box=True) as host, fake_device(host.tcp, robot_topics()):
        await expect(lambda: host.hub.robots.has("robot_0"))
        await host.drive("robot_0", b'{"linear": 0.2, "angular": 0}')
        assert len((await host.get("/api/drives"))["drives"]) == 1
    assert not (tmp_path / NAME).exists()


@pytest.mark.parametrize("damage", [b"", b'{"robot": "rov', b"\xff\xfe\n", b'{"robot": 3}\n', b"\n\n"])
def test_a_file_that_was_cut_or_damaged_is_read_to_its_end(tmp_path: Path, damage: bytes) -> None:
    append_drives(tmp_path, [a_drive(1)])
    with (tmp_path / NAME).open("ab") as file:
        file.write(damage + b"\n")
    append_drives(tmp_path, [a_drive(2)])
    assert read_drives(tmp_path) == [a_drive(1), a_drive(2)]


def test_a_line_that_was_cut_costs_no_later_drive(tmp_path: Path) -> None:
    append_drives(tmp_path, [a_drive(1), a_drive(2)])
    with (tmp_path / NAME).open("rb+") as file:
        file.truncate((tmp_path / NAME).stat().st_size - 10)
    append_drives(tmp_path, [a_drive(3)])
    append_drives(tmp_path, [a_drive(4)])
    assert read_drives(tmp_path) == [a_drive(1), a_drive(3), a_drive(4)]


def test_the_files_are_bounded_and_what_is_read_too(tmp_path: Path) -> None:
    line_bytes = len(json.dumps({"owner": "x"}))
    for first in range(0, 40_000, 4_000):
        append_drives(tmp_path, [a_drive(number) for number in range(first, first + 4_000)])
    assert sorted(file.name for file in tmp_path.iterdir()) == [NAME_BEFORE, NAME]
    assert all(file.stat().st_size < MAX_FILE_BYTES + 4_000 * 40 * line_bytes for file in tmp_path.iterdir())
    assert read_drives(tmp_path) == [a_drive(number) for number in range(40_000 - MAX_RECENT, 40_000)]


async def test_the_command_lists_them_or_says_that_there_are_none(tmp_path: Path) -> None:
    async with (
        daemon(config_in(tmp_path), has_black_box=True) as host,
        fake_device(host.tcp, robot_topics()) as device,
    ):
        assert await run("drives", "--url", host.url) == (0, "there are no drives of any robot yet\n", "")
        await host.drive("robot_0", b'{"linear": 0.2, "angular": 0}')
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
        _, out, _ = await run("drives", "robot_0", "--url", host.url)
        head, row = out.splitlines()
        assert head.split("  ")[0] == "from UTC"
        assert "rest 127.0.0.1" in row
        assert " 0.20 " in row
        assert (await run("drives", "other", "--url", host.url))[1] == "there are no drives of other yet\n"
        assert json.loads((await run("drives", "other", "--json", "--url", host.url))[1])["drives"] == []
