"""The REST API: what a script gets, and what it is told when it asks for something else."""

from hostlink.core.robot.state_views import robot_view
from tests.support.daemon import daemon
from tests.support.device_reports import BATTERY, report
from tests.support.fake_device import fake_device, robot_topics
from tests.support.hosts import host_in
from tests.support.waiting import expect


async def test_board_description_is_shown_while_the_device_is_connected() -> None:
    keys = ("battery_v", "battery_percent", "signal_dbm", "firmware", "device_errors")
    async with daemon() as host:
        async with fake_device(host.tcp, [*robot_topics(), BATTERY]) as device:
            await device.send(report(9.5))
            await expect(lambda: "battery_low" in robot_view(host_in(host.hub).robot("robot_0"))["device_errors"])
            robot = await host.get("/api/robots/robot_0")
            assert [robot[key] for key in keys[:4]] == [9.5, 25.0, -67, "rover 1.4"]
            assert "battery_low" in robot["device_errors"]
        await expect(lambda: host.hub.robots.find("robot_0").link is None)
        robot = await host.get("/api/robots/robot_0")
    assert [robot[key] for key in keys] == [None, None, None, None, []]


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


async def test_a_request_of_a_wrong_path_or_method_is_told_the_next_step() -> None:
    async with daemon() as host:
        for path in ("/api", "/api/", "/api/robot", "/robots"):
            status, answer = await host.rest("GET", path)
            assert (status, answer["error"]["kind"]) == (404, "HTTP")
            assert "; GET /api/openapi.json lists the requests" in answer["error"]["reason"]
        status, answer = await host.rest("GET", "/api/robots/robot_0/stop")
        assert (status, answer["error"]["reason"].rpartition("; ")[2]) == (405, "allowed: POST")
