"""What Prometheus reads."""

import asyncio
import json
import math
import re
from pathlib import Path

import aiohttp
import promql_parser
import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families

from hostlink.api.owners import MAX_OWNERS
from hostlink.hub.deliveries import MAX_WAITING
from hostlink.hub.message import Message
from hostlink.messages.catalog import Catalog
from hostlink.protocol.frame import Id, encode
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import fake_device, pose, robot_topics, topic
from tests.support.rosbridge import client
from tests.support.waiting import expect


async def metrics(host: Daemon) -> dict[str, float]:
    """By name and labels, as Prometheus writes them."""
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
        await program.call("/rosapi/get_time")  # by now the subscription stands
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
        await host.rest("PUT", "/api/robots/robot_0/velocity", b'{"linear": 0.2, "angular": 0.5}')
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.5)
        observed = await metrics(host)
        assert observed["hostlink_command_to_device_seconds_count" + device_labels] >= 2  # the first is a zero
        assert 0 < observed["hostlink_command_to_device_seconds_sum" + device_labels] < 5
        assert observed["hostlink_robot_gate_total[('outcome', 'commands'), ('robot', 'robot_0')]"] == 1
        assert observed["hostlink_robot_gate_total[('outcome', 'forgotten_claims'), ('robot', 'robot_0')]"] == 0
        assert observed["process_open_fds[]"] > 3


async def test_an_empty_daemon_has_metrics_too() -> None:
    async with daemon() as host:
        observed = await metrics(host)
    assert observed["hostlink_links[]"] == 0
    assert observed["hostlink_client_lag_seconds[]"] == 0


async def test_late_answers_of_services() -> None:
    infos = [
        topic(Id.SERVICE_SERVER_PUBLISHER, 125, "/set_led", "std_srvs/SetBool"),
        topic(Id.SERVICE_SERVER_SUBSCRIBER, 100, "/set_led", "std_srvs/SetBool"),
    ]
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
BATTERY = topic(Id.PUBLISHER, 130, "/robot_0/battery", "sensor_msgs/BatteryState")


def named(expression: str) -> set[str]:
    """The metrics that a query of Prometheus names; it must be one."""
    promql_parser.parse(expression)
    return set(re.findall(r"\b(?:hostlink|process)_\w+", expression))


async def test_the_dashboard_and_the_alerts_name_metrics_that_exist() -> None:
    shown = {name for panel in DASHBOARD["panels"] for target in panel["targets"] for name in named(target["expr"])}
    alerted = {name for rule in RULES for name in named(rule["expr"])}
    async with daemon() as host, fake_device(host.tcp, [*robot_topics(), BATTERY]) as device:
        await device.send(b"\xff\xfe" + bytes(20) + pose(1.0, 2.0, 0.5) + battery(7.5))
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count == 1)
        host.hub.counts.refused["test"] += 1
        host.hub.isolation.crashes["test"] += 1
        observed = {name.partition("[")[0] for name in await metrics(host)}
    assert len(shown) > 10
    assert len(alerted) > 10
    assert (shown | alerted) - observed == set()


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


def battery(volts: float) -> bytes:
    """A sensor_msgs/BatteryState that says nothing else."""
    type_ = Catalog().message("sensor_msgs/BatteryState")
    assert type_ is not None
    return encode(130, type_.encode({"voltage": volts}))


async def test_how_a_robot_is_driven() -> None:
    async with daemon() as host, fake_device(host.tcp, [*robot_topics(), BATTERY]) as device:
        await expect(lambda: host.hub.robots.has("robot_0"))
        for number in range(3):
            await device.send(pose(0.1 * number) + battery(7.5))
            await asyncio.sleep(0.1)
        await host.rest("PUT", "/api/robots/robot_0/velocity", b'{"linear": 0.3, "angular": -0.5}')
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count == 3)
        found = await metrics(host)
        labels = "[('axis', '{}'), ('robot', 'robot_0')]"
        assert found["hostlink_robot_driven[('robot', 'robot_0')]"] == 1
        assert found["hostlink_robot_locked[('robot', 'robot_0')]"] == 0
        assert found["hostlink_robot_commanded_speed" + labels.format("linear")] == 0.3
        assert found["hostlink_robot_commanded_speed" + labels.format("angular")] == -0.5
        assert found["hostlink_robot_speed" + labels.format("linear")] == pytest.approx(1.0, rel=0.4)
        assert found["hostlink_robot_battery_volts[('robot', 'robot_0')]"] == 7.5
        await host.rest("POST", "/api/robots/robot_0/lock")
        found = await metrics(host)
        assert found["hostlink_robot_driven[('robot', 'robot_0')]"] == 0
        assert found["hostlink_robot_locked[('robot', 'robot_0')]"] == 1


async def test_the_battery_of_a_robot_that_is_gone_or_measures_none_is_no_figure() -> None:
    async with daemon() as host:
        async with fake_device(host.tcp, [*robot_topics(), BATTERY]) as device:
            await device.send(battery(6.0))
            await until_metric(host, "hostlink_robot_battery_volts[('robot', 'robot_0')]", 6.0)
            await device.send(battery(math.nan))
            await until_metric(host, "hostlink_robot_battery_volts[('robot', 'robot_0')]", None)
            await device.send(battery(5.0))
            await until_metric(host, "hostlink_robot_battery_volts[('robot', 'robot_0')]", 5.0)
        await until_metric(host, "hostlink_robot_battery_volts[('robot', 'robot_0')]", None)


async def until_metric(host: Daemon, name: str, value: float | None) -> None:
    async with asyncio.timeout(5):
        found = None if value is not None else math.inf
        while found != value:
            await asyncio.sleep(0.02)
            found = (await metrics(host)).get(name)
