"""Views of a micro-ROS board: its protocol, and findings by rules of its own."""

import asyncio
import socket

import pytest

from hostlink.core.config import Config, MicroRosConfig, MicroRosUdpConfig
from hostlink.core.link.serving import LinkEnd
from hostlink.core.protocol import link_evidence
from tests.integration.test_metrics import metrics
from tests.integration.test_micro_ros import CONFIG, address_of, robot_of
from tests.support.background import meanwhile
from tests.support.daemon import Daemon, daemon
from tests.support.waiting import expect
from tests.support.xrce_board import WRITE, sub
from tests.support.xrce_device import stock, udp_board


def codes(host: Daemon) -> set[str]:
    (link,) = host.hub.links.all()
    return {each.code for each in host.hub.diagnoses.of(link)}


async def test_protocol_and_findings_of_a_board_are_in_the_views() -> None:
    async with daemon(CONFIG) as host, udp_board(address_of(host, "udp"), stock(is_reliable=False)):
        name = await robot_of(host)
        await expect(lambda: "best_effort_too_long" in codes(host))
        (link,) = (await host.get("/api/links"))["links"]
        assert (link["robot"], link["transport"], link["protocol"]) == (name, "udp", "micro-ROS")
        (found,) = [each for each in link["diagnosis"] if each["code"] == "best_effort_too_long"]
        assert found["detail"] == "/odom/unfiltered: a message of at least 700 bytes, best effort takes 496"
        (device,) = (await host.get("/api/devices"))["devices"]
        assert device["protocol"] == "micro-ROS"
        assert not {"time_stopped", "unknown_ids", "buffer_too_small", "wrong_md5"} & codes(host)


async def test_board_in_the_session_of_its_agent_is_found_until_it_begins_one_here(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(link_evidence, "UNKNOWN_S", 0.1)
    message = b"\x81\x01\x05\x00" + sub(WRITE, bytes(8))
    async with daemon(CONFIG) as host:
        address = address_of(host, "udp")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as agents_board:
            for _ in range(4):
                agents_board.sendto(message, address)
                await asyncio.sleep(0.05)
            await expect(lambda: host.hub.counts.datagrams_dropped == {"not_micro_ros": 4})
            view = await host.get("/api/diagnosis")
            assert [(each["code"], each["detail"]) for each in view["findings"]] == [
                ("session_unknown", "127.0.0.1: 4 messages")
            ]
            assert [each["cause"] for each in view["arrivals"]] == ["other_session"]
        async with udp_board(address, stock()):
            await robot_of(host)
            assert (await host.get("/api/diagnosis"))["findings"] == []


async def test_board_that_only_listens_at_an_unverified_address_is_found_with_the_setting_that_helps() -> None:
    config = Config(micro_ros=MicroRosConfig(udp=MicroRosUdpConfig(port=0, trusted=())))
    async with daemon(config) as host, udp_board(address_of(host, "udp"), stock(period_s=1e6)):
        name, drive = await robot_of(host), b'{"linear": 0.2, "angular": 0}'

        async def command() -> None:
            while True:
                await host.drive(name, drive)
                await asyncio.sleep(0.02)

        def found() -> set[str]:
            return {each.code for each in host.hub.diagnoses.daemon_findings("")}

        async with meanwhile(command()):
            await expect(lambda: "address_unverified" in found())


async def test_lost_messages_of_a_board_are_in_the_views() -> None:
    async with daemon(CONFIG) as host, udp_board(address_of(host, "udp"), stock(is_reliable=False)):
        name = await robot_of(host)
        host.hub.links.all()[0].session.counts.lost_messages = 23
        (link,) = (await host.get("/api/links"))["links"]
        assert link["lost_messages"] == 23
        found = await metrics(host)
        assert found[f"hostlink_link_lost_messages_total[('peer', '127.0.0.1'), ('robot', '{name}')]"] == 23


async def test_protocol_of_a_link_that_has_ended_is_in_the_view() -> None:
    async with daemon(CONFIG) as host:
        async with udp_board(address_of(host, "udp"), stock()):
            await robot_of(host)
        host.hub.links.all()[0].end(LinkEnd.IDLE)
        await expect(lambda: len(host.hub.diagnoses.ended) == 1)
        assert [each["protocol"] for each in (await host.get("/api/links"))["ended"]] == ["micro-ROS"]
