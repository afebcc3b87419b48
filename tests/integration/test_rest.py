"""The REST API: what a script gets, and what it is told when it asks for something else."""

import json

import pytest
from yarl import URL

from hostlink.api.views import robot_view
from tests.support.daemon import daemon
from tests.support.device_reports import BATTERY, report
from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.waiting import expect


async def test_a_robot_and_its_odometry() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await device.send(pose(1.0, 2.0, 0.5))
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count == 1)
        robots = (await host.get("/api/robots"))["robots"]
        robot = await host.get("/api/robots/robot_0")
        odometry = await host.get("/api/robots/robot_0/odometry")
    assert [each["name"] for each in robots] == ["robot_0"]
    assert robot["connected"] is True
    assert robot["velocity_topic"] == "/robot_0/velocity_commands"
    assert odometry["pose"] == {"x_m": 1.0, "y_m": 2.0, "theta_rad": 0.5}
    assert odometry["twist"] == {"linear_m_s": 0.0, "linear_y_m_s": 0.0, "angular_rad_s": 0.0}
    assert 0 <= odometry["age_s"] < 5
    assert odometry["stamp_ns"] > 1_700_000_000_000_000_000


async def test_board_description_is_shown_while_the_device_is_connected() -> None:
    keys = ("battery_v", "battery_percent", "signal_dbm", "firmware", "device_errors")
    async with daemon() as host:
        async with fake_device(host.tcp, [*robot_topics(), BATTERY]) as device:
            await device.send(report(9.5))
            await expect(lambda: "battery_low" in robot_view(host.hub.robots.find("robot_0"))["device_errors"])
            robot = await host.get("/api/robots/robot_0")
            assert [robot[key] for key in keys[:4]] == [9.5, 25.0, -67, "rover 1.4"]
            assert "battery_low" in robot["device_errors"]
        await expect(lambda: host.hub.robots.find("robot_0").link is None)
        robot = await host.get("/api/robots/robot_0")
    assert [robot[key] for key in keys] == [None, None, None, None, []]


async def test_velocity_stop_and_reset() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        status, body = await host.rest("PUT", "/api/robots/robot_0/velocity", b'{"linear": 0.2, "angular": 0.5}')
        assert (status, body["velocity"]) == (200, {"linear_m_s": 0.2, "linear_y_m_s": 0.0, "angular_rad_s": 0.5})
        assert (body["is_limited"], body["limited_by"]) == (False, None)
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.5)
        status, stopped = await host.rest("POST", "/api/robots/robot_0/stop")
        assert status == 200
        assert await device.velocity_other_than((0.2, 0.5)) == (0.0, 0.0)
        assert (await host.rest("POST", "/api/robots/robot_0/odometry/reset"))[0] == 200
        assert await device.frame(101) == b""
        status, body = await host.rest("PUT", "/api/robots/robot_0/velocity", b'{"linear": 3.0, "angular": 0.0}')
        assert (status, body["error"]["kind"]) == (409, "disarmed")
        meant = json.dumps({"linear": 3.0, "angular": 0.0, "epoch": stopped["epoch"]}).encode()
        _, body = await host.rest("PUT", "/api/robots/robot_0/velocity", meant)
        assert (body["is_limited"], body["limited_by"]) == (True, "max_linear_m_s")


async def test_the_page_and_its_files() -> None:
    files = {"/": "html", "/web/page.js": "javascript", "/web/style.css": "css", "/web/icon.svg": "svg+xml"}
    async with daemon() as host:
        for path, kind in files.items():
            async with host.session.get(host.url + path) as response:
                assert (response.status, response.content_type.rpartition("/")[2]) == (200, kind)
                policy = response.headers["Content-Security-Policy"]
                assert "default-src 'none'" in policy
                assert "unsafe" not in policy
                assert response.headers["Cache-Control"] == "no-store"
        async with host.session.get(host.url + "/") as response:
            assert "http" not in await response.text()  # the page loads nothing from other hosts


@pytest.mark.parametrize("name", ["..%2Fserver.py", "x"])
async def test_no_file_but_the_pages(name: str) -> None:
    async with daemon() as host, host.session.get(URL(f"{host.url}/web/{name}", encoded=True)) as response:
        assert response.status == 404
