"""micro-ROS boards at a whole daemon, over UDP, TCP and serial ports."""

import asyncio
import contextlib
import os
import socket
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from hostlink.cli.doctor import report_lines
from hostlink.cli.inspect import Inspection
from hostlink.cli.probe import probe_capture
from hostlink.core.config import Config, MicroRosConfig, MicroRosTcpConfig, MicroRosUdpConfig, SerialConfig
from hostlink.core.link import capture_buffer
from hostlink.core.listeners.accepting import UdpAcceptor
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import TOPICS_REQUEST, Id, encode
from hostlink.core.runtime.capture_file import load_reads
from hostlink.core.transport.udp import CREDIT_BYTES
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import robot_topics
from tests.support.process import free_port
from tests.support.pty_pair import pty_pair
from tests.support.waiting import expect
from tests.support.xrce_device import Device, serial_board, stock, tcp_board, udp_board

TIME_REQUEST = encode(Id.TIME, bytes(8))
CONFIG = Config(micro_ros=MicroRosConfig(udp=MicroRosUdpConfig(port=0), tcp=MicroRosTcpConfig(port=0)))


def address_of(host: Daemon, scheme: str) -> tuple[str, int]:
    """The address for micro-ROS boards."""
    (url,) = [each for each in host.hub.listening.micro_ros if each.startswith(scheme)]
    name, _, port = url.removeprefix(f"{scheme}://").rpartition(":")
    return name, int(port)


async def robot_of(host: Daemon) -> str:
    """The name of the only robot, when it is there."""
    await expect(lambda: len(host.hub.robots.here()) == 1)
    return host.hub.robots.here()[0].name


async def check_drives(host: Daemon, device: Device) -> None:
    """Drive the board, and see its odometry."""
    name = await robot_of(host)
    await host.drive(name, b'{"linear": 0.2, "angular": 0}')
    await expect(lambda: any(speed > 0.1 for _, speed in device.stock.taken))
    view = await host.get(f"/api/robots/{name}")
    assert view["odometry"]["pose"]["x_m"] == 0.5, view


async def test_board_over_udp_is_a_robot_that_drives() -> None:
    async with daemon(CONFIG) as host, udp_board(address_of(host, "udp")) as device:
        await device.is_at_work()
        await check_drives(host, device)


async def test_board_over_tcp_is_a_robot_that_drives() -> None:
    async with daemon(CONFIG) as host, tcp_board(address_of(host, "tcp"), stock()) as device:
        await device.is_at_work()
        await check_drives(host, device)


async def test_two_equal_boards_with_equal_keys_are_two_robots_named_by_their_node() -> None:
    async with daemon(CONFIG) as host:
        address = address_of(host, "udp")
        async with udp_board(address) as first, udp_board(address) as second:
            await first.is_at_work()
            await second.is_at_work()
            names = ["linorobot_base_node", "linorobot_base_node_2"]
            await expect(lambda: sorted(each.name for each in host.hub.robots.here()) == names)
            await host.drive(host.hub.robots.here()[1].name, b'{"linear": 0.2, "angular": 0}')
            await expect(lambda: any(speed > 0.1 for each in (first, second) for _, speed in each.stock.taken))
            driven = [any(speed > 0.1 for _, speed in each.stock.taken) for each in (first, second)]
            assert sorted(driven) == [False, True]


async def test_board_at_an_unverified_address_gets_no_more_bytes_than_it_sends_and_drives() -> None:
    config = Config(micro_ros=MicroRosConfig(udp=MicroRosUdpConfig(port=0, trusted=())))
    async with daemon(config) as host, udp_board(address_of(host, "udp")) as device:
        await device.is_at_work()
        await check_drives(host, device)
        (link,) = host.hub.links.all()
        assert link.session.counts.bytes_to_device <= CREDIT_BYTES + link.session.counts.bytes_from_device


async def test_ping_is_answered_without_a_session_and_only_to_allowed_networks() -> None:
    async with daemon(CONFIG) as host:
        address = address_of(host, "udp")
        assert await pinged(address)
        assert not host.hub.links.all()
    config = Config(micro_ros=MicroRosConfig(udp=MicroRosUdpConfig(port=0, allow=("10.0.0.0/8",))))
    async with daemon(config) as host:
        assert not await pinged(address_of(host, "udp"))
        assert host.hub.counts.refused == {"not_allowed": 1}


async def test_other_datagrams_open_nothing() -> None:
    async with daemon(CONFIG) as host:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as connection:
            for data in (b"hello", bytes(600), b"\xff\xfe\0\0\xff\0\0\xff"):
                connection.sendto(data, address_of(host, "udp"))
            await expect(lambda: host.hub.counts.datagrams_dropped == {"not_micro_ros": 3})
        assert not host.hub.links.all()


@contextlib.contextmanager
def serial_port() -> Iterator[tuple[int, str]]:
    """The device's end of a port, which does not block, and the port's path."""
    with pty_pair() as (descriptor, path):
        os.set_blocking(descriptor, False)
        yield descriptor, path


@pytest.mark.parametrize("protocol", ["auto", "micro-ros"])
async def test_board_at_a_serial_port_is_a_robot_that_drives(protocol: str) -> None:
    with serial_port() as (descriptor, path):
        config = Config(serial=(SerialConfig(path=path, baud=115200, protocol=protocol),))
        async with daemon(config) as host, serial_board(descriptor) as device:
            await device.is_at_work()
            await check_drives(host, device)
            assert host.hub.links.all()[0].session.protocol == "micro-ROS"
            assert not host.hub.diagnoses.ended


async def test_rosserial_and_micro_ros_take_turns_at_one_port_that_stays_open() -> None:
    with serial_port() as (descriptor, path), capture_logs() as lines:
        async with daemon(Config(serial=(SerialConfig(path=path, baud=115200),))) as host:
            for count in (1, 2):
                async with serial_board(descriptor) as device:
                    await device.is_at_work()
                    await expect(lambda: protocols_of_robots(host) == ["micro-ROS"])
                rosserial = asyncio.get_running_loop()
                rosserial.add_reader(descriptor, announce, descriptor)
                await expect(lambda: protocols_of_robots(host) == ["rosserial"])
                rosserial.remove_reader(descriptor)
                found = [line["protocol"] for line in lines if line["event"] == "serial.protocol_found"]
                assert found == ["micro-ROS", "rosserial"] * count
        assert not [line for line in lines if line["event"] == "serial.waiting"]


@pytest.mark.parametrize("way", ["udp", "tcp", "serial"])
@pytest.mark.parametrize("is_beginning_lost", [False, True])
async def test_capture_of_a_board_is_read_by_doctor_and_inspect(
    way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, is_beginning_lost: bool
) -> None:
    if is_beginning_lost:
        monkeypatch.setattr(capture_buffer, "CAPTURE_BYTES", 8192)
    with serial_port() as (descriptor, path):
        async with daemon(replace(CONFIG, serial=(SerialConfig(path=path, baud=115200),))) as host:
            boards = {
                "udp": lambda: udp_board(address_of(host, "udp")),
                "tcp": lambda: tcp_board(address_of(host, "tcp")),
                "serial": lambda: serial_board(descriptor),
            }
            async with boards[way]() as device:
                await expect(lambda: len(device.stock.published) > 80)
                (number,) = [each.number for each in host.hub.links.all() if each.session.topics]
                async with host.session.get(f"{host.url}/api/links/{number}/capture") as response:
                    lines = await response.read()
    file = tmp_path / "capture.jsonl"
    file.write_bytes(lines)
    assert (b'"event":"topics"' in lines) is is_beginning_lost
    (link,) = probe_capture(file, ())["links"]
    assert (link["topics"], link["protocol"]) == (3, "micro-ROS"), link
    assert "capture.jsonl micro-ROS  (" in report_lines({"findings": [], "links": [link]})[0]
    inspection = Inspection(Catalog())
    inspection.add_all(load_reads(file))
    view = inspection.view()
    assert {each["name"] for each in view["topics"]} == {"/cmd_vel", "/odom/unfiltered", "/imu/data"}
    assert view["messages"]["/odom/unfiltered"]["last"]["pose"]["pose"]["position"]["x"] == 0.5
    assert view["skipped_bytes"] == 0
    assert view["protocols"] == ["micro-ROS"]


def protocols_of_robots(host: Daemon) -> list[str]:
    """The protocol of each connected robot."""
    return [each.link.session.protocol for each in host.hub.robots.here() if each.link is not None]


def announce(descriptor: int) -> None:
    """Announce the topics of a rosserial device, when the host asks for them."""
    if TOPICS_REQUEST in os.read(descriptor, 4096):
        topics = (encode(each.kind, encode_topic_info(each)) for each in robot_topics())
        os.write(descriptor, b"".join((TIME_REQUEST, *topics, TIME_REQUEST)))


async def pinged(address: tuple[str, int]) -> bool:
    """Whether a host at this address answers a ping within half a second."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as connection:
        connection.setblocking(False)
        connection.connect(address)
        connection.send(bytes.fromhex("80000000 02010800 000AFFFD 02000000"))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.5):
                return b"\x06\x01" in await asyncio.get_running_loop().sock_recv(connection, 100)
    return False


@pytest.mark.parametrize("peer", ["927.0.0.1:5000", "127.0.0.1:99999", "127.0.0.1:-1", "board"])
async def test_remembered_board_at_no_address_is_forgotten(peer: str) -> None:
    key = f"micro-ROS udp {peer}"
    with capture_logs() as logs:
        async with daemon(CONFIG) as host:
            host.hub.links.memories.restore({key: "{}"})
            acceptor = UdpAcceptor(host.hub, MicroRosUdpConfig().listening())
            await acceptor.resume([])
            assert not host.hub.links.memories.texts
    assert [each["peer"] for each in logs if each["event"] == "boards.damaged"] == [peer]


async def test_stranger_at_the_address_of_a_remembered_board_gets_no_robot() -> None:
    port = free_port()
    async with daemon(CONFIG) as host:
        address = address_of(host, "udp")
        async with udp_board(address, local_port=port) as device:
            await device.is_at_work()
            memories = host.hub.links.memories
            await expect(lambda: memories.texts)
        await expect(lambda: not host.hub.links.all())
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as connection:
            connection.bind(("127.0.0.1", port))
            for data in (b"hello", bytes.fromhex("81010000 07010800 0015 0007 00000000"), bytes(40)):
                connection.sendto(data, address)
            await expect(
                lambda: [each.session.counts.bytes_from_device >= 61 for each in host.hub.links.all()] == [True]
            )
            await asyncio.sleep(0.2)
            assert not [each for each in host.hub.robots.here() if each.link is not None]
        async with udp_board(address, stock(key=b"anew"), local_port=port) as device:
            await device.is_at_work()
            await expect(lambda: protocols_of_robots(host) == ["micro-ROS"])
