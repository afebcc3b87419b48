"""`GET /api/drives`: who drove when; kept over a restart."""

import json
from pathlib import Path

from hostlink.client import connect
from hostlink.components.recorder.drives import NAME
from hostlink.components.recorder.settings import RecordingConfig
from hostlink.core.config import Config
from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, robot_topics
from tests.support.process import run
from tests.support.waiting import expect


def config_in(folder: Path) -> Config:
    return Config().with_tables(recording=RecordingConfig(folder=folder))


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


async def test_drive_history_that_is_turned_off_writes_no_file(tmp_path: Path) -> None:
    config = config_in(tmp_path).with_tables(recording=RecordingConfig(folder=tmp_path, drives=False))
    async with daemon(config, has_black_box=True) as host, fake_device(host.tcp, robot_topics()):
        await expect(lambda: host.hub.robots.has("robot_0"))
        await host.drive("robot_0", b'{"linear": 0.2, "angular": 0}')
        assert len((await host.get("/api/drives"))["drives"]) == 1
    assert not (tmp_path / NAME).exists()


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
        assert head.split("  ")[0].startswith("UTC")
        assert "program (127.0.0.1)" in row
        assert " 0.20 " in row
        assert (await run("drives", "other", "--url", host.url))[1] == "there are no drives of other yet\n"
        none = "there are no drives of robto_0 yet; similar names: robot_0\n"
        assert await run("drives", "robto_0", "--url", host.url) == (0, none, "")
        assert (
            json.loads((await run("drives", "--json", "-n", "1", "--url", host.url))[1])["drives"][0]["robot"]
            == "robot_0"
        )
        assert json.loads((await run("drives", "other", "--json", "--url", host.url))[1])["drives"] == []
