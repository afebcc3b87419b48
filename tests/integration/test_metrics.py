"""What Prometheus reads."""

import json
import re
from pathlib import Path

import aiohttp
from prometheus_client.parser import text_string_to_metric_families

from hostlink.api.owners import MAX_OWNERS
from hostlink.hub.deliveries import MAX_WAITING
from hostlink.hub.message import Message
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
                await expect(lambda count=count: host.hub.late_answers == count)
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


async def test_the_dashboard_shows_metrics_that_exist() -> None:
    wanted = {
        name
        for panel in DASHBOARD["panels"]
        for target in panel["targets"]
        for name in re.findall(r"\b(?:hostlink|process)_\w+", target["expr"])
    }
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await device.send(b"\xff\xfe" + bytes(20) + pose(1.0, 2.0, 0.5))
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count == 1)
        observed = {name.partition("[")[0] for name in await metrics(host)}
    assert len(wanted) > 10
    assert wanted - observed == set()
