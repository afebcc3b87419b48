"""Metrics that Prometheus reads."""

import asyncio
import json
import math
import re
import resource
import threading
from pathlib import Path
from typing import Any

import aiohttp
import promql_parser
import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families
from structlog.testing import capture_logs

from hostlink.components.gateway import metrics as recording_metrics
from hostlink.components.gateway.rest import MAX_OWNERS
from hostlink.components.recorder.folder import DiskUsage, Folder
from hostlink.components.recorder.settings import BlackBoxConfig, RecordingConfig
from hostlink.core.config import Config
from hostlink.core.hub.message import Message
from hostlink.core.hub.topic import MAX_WAITING
from hostlink.core.protocol.rosserial.frame import encode
from tests.support.daemon import Daemon, daemon
from tests.support.device_reports import BATTERY, battery
from tests.support.fake_device import fake_device, pose, robot_topics, service_server
from tests.support.rosbridge import client
from tests.support.waiting import TIMEOUT_S, expect


async def metrics(host: Daemon) -> dict[str, float]:
    """Return the metrics by name and labels, as Prometheus writes them."""
    async with host.session.get(host.url + "/metrics") as response:
        assert response.status == 200
        text = await response.text()
    return {
        sample.name + str(sorted(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


async def test_links_robots_and_clients() -> None:
    device_labels = "[('peer', '127.0.0.1'), ('robot', 'robot_0')]"
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await program.send(op="subscribe", topic="/robot_0/odometry")
        await program.call("/rosapi/get_time")  # the answer follows the subscription
        await device.send(b"noise" + pose(1.0, 2.0, 0.5))
        await program.receive()
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count == 1)
        observed = await metrics(host)
        assert observed["hostlink_links[]"] == 1
        assert observed["hostlink_robot_connected[('robot', 'robot_0')]"] == 1
        assert observed["hostlink_robot_poses_total[('robot', 'robot_0')]"] == 1
        assert observed["hostlink_link_frames_from_device_total" + device_labels] == 6
        assert observed["hostlink_link_skipped_bytes_total" + device_labels] == 5
        assert observed["hostlink_clients[('kind', 'rosbridge')]"] == 1
        assert observed["hostlink_device_to_client_seconds_count[]"] == 2
        assert 0 < observed["hostlink_device_to_client_seconds_sum[]"] < 5
        assert observed["hostlink_client_dropped_total[]"] == 0
        await host.drive("robot_0", b'{"linear": 0.2, "angular": 0.5}')
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.5)
        observed = await metrics(host)
        assert observed["hostlink_command_to_device_seconds_count" + device_labels] >= 2  # the first is a zero
        assert 0 < observed["hostlink_command_to_device_seconds_sum" + device_labels] < 5
        assert observed["hostlink_robot_gate_total[('outcome', 'commands'), ('robot', 'robot_0')]"] == 1
        assert "hostlink_robot_gate_total[('outcome', 'refused_locked'), ('robot', 'robot_0')]" not in observed
        await host.rest("POST", "/api/robots/robot_0/lock")
        await host.rest("PUT", "/api/robots/robot_0/velocity", b'{"linear": 0.2, "angular": 0.5}')
        observed = await metrics(host)
        assert observed["hostlink_robot_gate_total[('outcome', 'refused_locked'), ('robot', 'robot_0')]"] == 1
        assert observed["process_open_fds[]"] > 3


async def test_an_empty_daemon_has_metrics_too() -> None:
    async with daemon() as host:
        observed = await metrics(host)
    assert observed["hostlink_links[]"] == 0
    assert observed["hostlink_client_lag_seconds[]"] == 0


async def test_late_answers_of_services() -> None:
    infos = service_server("/set_led", "std_srvs/SetBool")
    async with daemon() as host:
        assert (await metrics(host))["hostlink_service_late_answers_total[]"] == 0
        for count in (1, 2):  # of devices that are gone, too
            async with fake_device(host.tcp, infos) as device:
                await device.send(encode(125, b"\x01" + bytes(4)))
                await expect(lambda count=count: host.hub.links.late_answers == count)
        assert (await metrics(host))["hostlink_service_late_answers_total[]"] == 2


async def test_owners_of_rest_that_were_evicted() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()):
        await expect(lambda: host.hub.robots.find("robot_0").link)
        for number in range(1, MAX_OWNERS + 4):
            connector = aiohttp.TCPConnector(local_addr=(f"127.0.0.{number}", 0))
            async with (
                aiohttp.ClientSession(connector=connector) as session,
                session.put(f"{host.url}/api/robots/robot_0/velocity", data=b'{"linear": 0, "angular": 0}') as response,
            ):
                assert response.status == 200
        assert (await metrics(host))["hostlink_owners_evicted_total[]"] == 3


async def test_messages_that_were_delivered_before_their_turn() -> None:
    async with daemon() as host:
        many = host.hub.join("many")

        def answer(_: Message) -> None:
            for _ in range(MAX_WAITING + 10):
                many.publish("/answer", b"")

        many.subscribe("/question", answer)
        many.subscribe("/answer", lambda _: None)
        assert (await metrics(host))["hostlink_messages_out_of_order_total[]"] == 0
        many.publish("/question", b"")
        assert (await metrics(host))["hostlink_messages_out_of_order_total[]"] == 10


DASHBOARD = json.loads(Path("docs/grafana.json").read_text(encoding="utf-8"))
RULES = yaml.safe_load(Path("docs/prometheus-alerts.yml").read_text(encoding="utf-8"))["groups"][0]["rules"]


def named(expression: str) -> set[str]:
    """The metrics that a query of Prometheus names; it must be one."""
    promql_parser.parse(expression)
    return set(re.findall(r"\b(?:hostlink|process)_\w+", expression))


async def test_the_dashboard_and_the_alerts_name_metrics_that_exist(tmp_path: Path) -> None:
    shown = {name for panel in DASHBOARD["panels"] for target in panel["targets"] for name in named(target["expr"])}
    alerted = {name for rule in RULES for name in named(rule["expr"])}
    config = Config().with_tables(recording=RecordingConfig(folder=tmp_path))
    async with daemon(config) as host, fake_device(host.tcp, [*robot_topics(), BATTERY]) as device:
        await device.send(b"\xff\xfe" + bytes(20) + pose(1.0, 2.0, 0.5) + battery(7.5))
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count == 1)
        host.hub.counts.refused["test"] += 1
        host.hub.isolation.crashes["test"] += 1
        observed = {name.partition("[")[0] for name in await metrics(host)}
    assert len(shown) > 10
    assert len(alerted) > 10
    assert (shown | alerted) - observed == set()


def test_dashboard_lists_which_robots_are_connected_driven_locked_and_silent() -> None:
    (table,) = (panel for panel in DASHBOARD["panels"] if panel["title"] == "Robots")
    shown = {name for target in table["targets"] for name in named(target["expr"])}
    states = ("connected", "driven", "locked", "odometry_age_seconds")
    assert {f"hostlink_robot_{state}" for state in states} <= shown


def test_each_alert_says_what_is_wrong_and_what_to_do() -> None:
    for rule in RULES:
        assert set(rule["annotations"]) == {"summary", "next"}
        assert rule["labels"]["severity"] in ("info", "warning", "critical")


def test_the_panels_do_not_overlap() -> None:
    places = set()
    for panel in DASHBOARD["panels"]:
        grid = panel["gridPos"]
        for x in range(grid["x"], grid["x"] + grid["w"]):
            for y in range(grid["y"], grid["y"] + grid["h"]):
                assert (x, y) not in places, panel["title"]
                places.add((x, y))


async def test_battery_of_a_robot_that_is_disconnected_or_has_none_is_not_a_metric() -> None:
    async with daemon() as host:
        async with fake_device(host.tcp, [*robot_topics(), BATTERY]) as device:
            await device.send(battery(6.0))
            await until_metric(host, "hostlink_robot_battery_volts[('robot', 'robot_0')]", 6.0)
            await device.send(battery(math.nan))
            await until_metric(host, "hostlink_robot_battery_volts[('robot', 'robot_0')]", None)
            await device.send(battery(5.0))
            await until_metric(host, "hostlink_robot_battery_volts[('robot', 'robot_0')]", 5.0)
        await until_metric(host, "hostlink_robot_battery_volts[('robot', 'robot_0')]", None)


def recorded_in(folder: Path, **box: Any) -> Config:
    recording = RecordingConfig(folder=folder, max_disk_mb=3.0, min_free_disk_mb=0.0)
    return Config().with_tables(
        recording=recording, black_box=BlackBoxConfig(max_memory_mb=2.0, after_s=0.0, max_disk_mb=1.0, **box)
    )


async def test_recordings_and_their_disk_are_counted_also_after_their_end(tmp_path: Path) -> None:
    async with daemon(recorded_in(tmp_path / "there")) as host, fake_device(host.tcp, robot_topics()) as device:
        observed = await metrics(host)  # there is no folder yet
        assert observed["hostlink_recordings_running[]"] == observed["hostlink_recording_messages_total[]"] == 0
        assert observed["hostlink_disk_used_bytes[('folder', 'recordings')]"] == 0
        assert observed["hostlink_disk_free_bytes[('folder', 'recordings')]"] > 1_000_000
        for name in ("first", "second"):
            await host.rest("POST", "/api/recordings", f'{{"name": "{name}"}}'.encode())
            for number in range(20):
                await device.send(pose(0.1 * number))
            await until_metric(host, "hostlink_recordings_running[]", 1 + (name == "second"))
        observed = await metrics(host)
        assert observed["hostlink_recordings_running[]"] == 2
        views = [(await host.rest("POST", f"/api/recordings/{name}/stop"))[1] for name in ("first", "second")]
        observed = await metrics(host)
        assert observed["hostlink_recordings_running[]"] == 0
        assert observed["hostlink_recording_messages_total[]"] == sum(view["messages"] for view in views)
        assert observed["hostlink_recording_bytes_total[]"] == sum(view["bytes"] for view in views) > 0
        assert observed["hostlink_recording_dropped_total[]"] == 0
        assert observed["hostlink_recordings_failed_total[]"] == 0
    async with daemon(recorded_in(tmp_path / "there")) as host:
        observed = await metrics(host)
        assert observed["hostlink_disk_used_bytes[('folder', 'recordings')]"] == sum(view["bytes"] for view in views)
        assert observed["hostlink_disk_budget_bytes[('folder', 'recordings')]"] == 3_000_000
        assert observed["hostlink_disk_min_free_bytes[('folder', 'recordings')]"] == 0


async def test_a_recording_that_fails_and_a_full_budget_are_counted(tmp_path: Path) -> None:
    for number in range(2):
        (tmp_path / f"old_{number}.mcap").write_bytes(bytes(2_000_000))
    async with daemon(recorded_in(tmp_path)) as host:
        assert (await host.rest("POST", "/api/recordings", b'{"name": "new"}'))[0] == 200
        assert (await metrics(host))["hostlink_recordings_removed_total[]"] == 1
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))  # the kernel lets no file of this process grow
        try:
            with capture_logs():  # the log of a test may be a file of this process, too
                await until_metric(host, "hostlink_recordings_failed_total[]", 1)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


async def test_incidents_and_the_black_box_are_counted(tmp_path: Path) -> None:
    async with (
        daemon(recorded_in(tmp_path, before_s=60.0), has_black_box=True) as host,
        fake_device(host.tcp, robot_topics()) as device,
    ):
        await device.send(pose(1.0))
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count == 1)
        observed = await metrics(host)
        assert 0 < observed["hostlink_black_box_bytes[]"] < observed["hostlink_black_box_max_bytes[]"] == 2_000_000
        assert observed["hostlink_black_box_keep_seconds[]"] == 60
        assert observed["hostlink_disk_budget_bytes[('folder', 'incidents')]"] == 1_000_000
        assert observed["hostlink_black_box_dropped_total[]"] == 0
        assert observed["hostlink_incidents_total[('outcome', 'saved')]"] == 0
        assert (await host.rest("POST", "/api/incidents", b'{"robot": "robot_0"}'))[0] == 200
        await until_metric(host, "hostlink_incidents_total[('outcome', 'saved')]", 1)
        assert (await metrics(host))["hostlink_incidents_pending[]"] == 0
        (tmp_path / "incidents").rename(tmp_path / "gone")
        (tmp_path / "incidents").write_bytes(b"no folder")
        await host.rest("POST", "/api/incidents", b'{"robot": "robot_0"}')
        await until_metric(host, "hostlink_incidents_total[('outcome', 'failed')]", 1)
    async with daemon(recorded_in(tmp_path)) as host:  # without a black box
        observed = await metrics(host)
        assert observed["hostlink_black_box_max_bytes[]"] == observed["hostlink_black_box_keep_seconds[]"] == 0


async def test_a_disk_that_does_not_answer_leaves_its_figures_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    is_back, usage = threading.Event(), Folder.usage

    def usage_when_back(folder: Folder) -> DiskUsage:
        is_back.wait()
        return usage(folder)

    monkeypatch.setattr(Folder, "usage", usage_when_back)
    monkeypatch.setattr(recording_metrics, "DISK_TIMEOUT_S", 0.1)
    async with daemon(recorded_in(tmp_path)) as host:
        try:
            for _ in range(3):
                observed = await metrics(host)
            assert not any(name.startswith("hostlink_disk_") for name in observed)
            assert observed["hostlink_recordings_running[]"] == 0
        finally:
            is_back.set()
        await until_metric(host, "hostlink_disk_budget_bytes[('folder', 'recordings')]", 3_000_000)


async def test_clients_of_every_kind_are_counted() -> None:
    async with daemon() as host, host.session.ws_connect(host.url, protocols=("foxglove.sdk.v1",)):
        assert (await metrics(host))["hostlink_clients[('kind', 'foxglove')]"] == 1


async def until_metric(host: Daemon, name: str, value: float | None) -> None:
    async with asyncio.timeout(TIMEOUT_S):
        found = None if value is not None else math.inf
        while found != value:
            await asyncio.sleep(0.02)
            found = (await metrics(host)).get(name)
