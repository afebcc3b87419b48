"""Devices over UDP: a session an address, from its first whole frame until it falls silent."""

import asyncio
import contextlib
import random
import socket
import struct
import time
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from hostlink.core.config import Config, LinkConfig, UdpConfig
from hostlink.core.listeners.accepting import OPENED_A_SECOND
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import TOPICS_REQUEST, encode
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.robot.velocity_gate import ZEROS
from hostlink.core.transport.keyed import HELLO, MAGIC, RANDOM_BYTES, proof
from hostlink.core.transport.udp import MAX_DATAGRAM_BYTES, serve_udp
from hostlink.errors import ConfigError
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import fake_device, pose, repeating, robot_topics, topic
from tests.support.udp_device import GREETING, udp_device
from tests.support.waiting import TIMEOUT_S, expect

ROBOT, OTHER, VICTIM = "127.0.0.2", "127.0.0.3", "127.0.0.4"
KEY = b"a key of 16 bytes, or of more"
UDP = UdpConfig(trusted=("127.0.0.0/8",))
A_WHILE_S = 0.2
OTHER_BYTES = (16, 56)  # frames with the time, and with a velocity


@contextlib.asynccontextmanager
async def host_of(udp: UdpConfig = UDP, **parts: object) -> AsyncIterator[Daemon]:
    config = replace(Config(udp=replace(udp, host="127.0.0.1", port=0)), **parts)
    async with daemon(config) as host:
        assert host.udp is not None
        yield host


@contextlib.contextmanager
def blind_sockets(count: int, to: tuple[str, int], *, local_host: str = VICTIM) -> Iterator[list[socket.socket]]:
    """Open sockets on ports of their own, as forged sources have. Their answers are never read in between."""
    with contextlib.ExitStack() as opened:
        made = []
        for _ in range(count):
            each = opened.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            each.setblocking(False)
            each.bind((local_host, 0))
            each.connect(to)
            made.append(each)
        yield made


def came_back(sender: socket.socket) -> int:
    """Return the number of received bytes."""
    total = 0
    with contextlib.suppress(BlockingIOError):
        while True:
            total += len(sender.recv(65536))
    return total


class TestSession:
    async def test_a_robot_is_read_and_driven(self) -> None:
        async with host_of() as host, udp_device(host.udp, robot_topics()) as device:
            await device.send(pose(1.5))
            await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 1)
            status, _ = await host.rest("PUT", "/api/robots/robot_0/velocity", b'{"linear": 0.2, "angular": 0.1}')
            assert status == 200
            assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.1)
            assert await device.velocity_other_than((0.2, 0.1)) == (0.0, 0.0)  # the lease has ended

    async def test_a_velocity_topic_whose_announcement_was_lost_whole_is_requested(self) -> None:
        """The last id of a row leaves no gap."""
        topics = robot_topics()[:2]
        async with host_of() as host, udp_device(host.udp, topics[:1]) as device, repeating(device, pose(0.0)):
            await device.announce(topics)
            await expect(lambda: host.hub.robots.find("robot_0").link)

    async def test_the_api_shows_that_it_is_over_udp(self) -> None:
        async with host_of() as host, udp_device(host.udp, robot_topics()) as device:
            shown = (await host.get("/api/links"))["links"]
            assert [(link["transport"], link["peer"]) for link in shown] == [("udp", "{}:{}".format(*device.address))]

    async def test_two_ports_of_an_address_are_two_devices(self) -> None:
        async with (
            host_of() as host,
            udp_device(host.udp, robot_topics("a")) as first,
            udp_device(host.udp, robot_topics("b")) as second,
        ):
            await first.send(pose(1.0))
            await second.send(pose(2.0))
            for name in ("a", "b"):
                await expect(lambda name=name: host.hub.topics.find(f"/{name}/odometry").messages == 1)
            assert len(host.hub.links.all()) == 2

    async def test_silence_ends_the_session_after_a_last_zero_and_the_next_frame_begins_another(self) -> None:
        link = LinkConfig(silence_timeout_s=0.3, idle_timeout_s=0.3)
        async with host_of(link=link) as host, udp_device(host.udp, robot_topics()) as device:
            async with repeating(device, pose(0.0), interval_s=0.05):  # until it is driven, however long that takes
                await expect(host.hub.robots.all)
                robot = host.hub.robots.find("robot_0")
                await host.drive("robot_0", b'{"linear": 0.2, "angular": 0}')
            await expect(lambda: robot.link is None)  # the device's datagrams have ceased
            assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
            assert await device.velocity_other_than((0.2, 0.0)) == (0.0, 0.0)
            status, _ = await host.rest("PUT", "/api/robots/robot_0/velocity", b'{"linear": 0.2, "angular": 0}')
            assert status == 503
            await expect(lambda: not host.hub.links.all())
            await device.send(pose(1.0))
            await device.announce(robot_topics())
            await expect(lambda: robot.link is not None)

    async def test_robot_that_reboots_to_another_port_keeps_its_name(self) -> None:
        async with host_of() as host:
            async with udp_device(host.udp, robot_topics(), local=(ROBOT, 0)) as before:
                await before.send(pose(1.0))
            async with udp_device(host.udp, robot_topics(), local=(ROBOT, 0)):
                await expect(lambda: len(host.hub.links.all()) == 1)
                assert [robot.name for robot in host.hub.robots.all()] == ["robot_0"]

    async def test_a_frame_is_a_datagram_and_a_longer_one_is_several(self) -> None:
        buffer_bytes = 3 * MAX_DATAGRAM_BYTES
        blob = topic(EndpointKind.SUBSCRIBER, 102, "/blob", "std_msgs/UInt8MultiArray", buffer_bytes=buffer_bytes)
        async with host_of() as host, udp_device(host.udp, [*robot_topics(), blob]) as device:
            program = host.hub.join("a program")
            program.advertise("/blob", "std_msgs/UInt8MultiArray")
            await expect(lambda: host.hub.topics.find("/blob").devices)
            long = struct.pack("<III", 0, 0, 2 * MAX_DATAGRAM_BYTES) + bytes(2 * MAX_DATAGRAM_BYTES)
            short = struct.pack("<III", 0, 0, 3) + bytes(3)
            for payload, sizes in ((long, [MAX_DATAGRAM_BYTES, MAX_DATAGRAM_BYTES, 20]), (short, [23])):
                program.publish("/blob", payload)
                came: list[bytes] = []
                while encode(102, payload) not in b"".join(came):
                    came.append(await asyncio.get_running_loop().sock_recv(device.socket, 65536))
                assert [len(each) for each in came if len(each) not in OTHER_BYTES] == sizes

    async def test_closed_device_port_ends_the_session_of_its_device_alone(self) -> None:
        async with host_of() as host, udp_device(host.udp, robot_topics("stays"), local=(ROBOT, 0)) as stays:
            async with udp_device(host.udp, robot_topics("goes"), local=(OTHER, 0)) as goes:
                await goes.send(pose(0.0))
                await expect(lambda: len(host.hub.robots.all()) == 2)
            gone = host.hub.robots.find("goes")
            for _ in range(5):  # the device's kernel answers that its port is closed
                await host.rest("PUT", "/api/robots/goes/velocity", b'{"linear": 0.2, "angular": 0}')
                await asyncio.sleep(0.02)
            await expect(lambda: gone.link is None)
            await stays.send(pose(1.0))
            await expect(lambda: host.hub.topics.find("/stays/odometry").messages == 1)
            assert host.hub.robots.find("stays").link is not None

    async def test_datagram_larger_than_any_device_frame_is_dropped(self) -> None:
        async with host_of() as host, udp_device(host.udp, robot_topics()) as device:
            await device.send(bytes(20_000))
            await device.send(b"")
            await device.send(pose(1.0))
            await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 1)
            assert host.hub.counts.datagrams_dropped == {"too_large": 1}

    async def test_a_device_on_tcp_and_one_on_udp_are_two_robots(self) -> None:
        async with (
            host_of() as host,
            fake_device(host.tcp, robot_topics("by_tcp")),
            udp_device(host.udp, robot_topics("by_udp")),
        ):
            await expect(lambda: len(host.hub.robots.all()) == 2)
            kinds = [link["transport"] for link in (await host.get("/api/links"))["links"]]
            assert kinds == ["tcp", "udp"]


class TestDamage:
    @pytest.mark.parametrize("seed", range(3))
    async def test_lost_doubled_reordered_merged_and_cut_datagrams_cost_only_what_they_carried(self, seed: int) -> None:
        dice = random.Random(seed)
        poses = [pose(float(number)) for number in range(200)]
        whole = set()
        async with host_of() as host, udp_device(host.udp, robot_topics()) as device:
            messages: list[float] = []
            program = host.hub.join("a program")
            program.subscribe(
                "/robot_0/odometry", lambda message: messages.append(struct.unpack_from("<d", message.payload)[0])
            )
            pending: list[tuple[bytes, set[int]]] = []
            at = 0
            while at < len(poses):
                count = dice.randint(1, 4)
                numbers = set(range(at, min(at + count, len(poses))))
                data = b"".join(poses[number] for number in sorted(numbers))
                at += count
                fate = dice.choice(["whole", "whole", "lost", "doubled", "cut", "late"])
                if fate == "cut":
                    middle = dice.randint(1, len(data) - 1)
                    pending += [(data[:middle], set()), (data[middle:], set())]
                elif fate != "lost":
                    pending += [(data, numbers)] * (2 if fate == "doubled" else 1)
                if fate == "late" and len(pending) > 1:
                    pending[-1], pending[-2] = pending[-2], pending[-1]
            for data, numbers in pending:
                await device.send(data)
                whole |= numbers
                await asyncio.sleep(0)
            await expect(lambda: whole <= set(messages))
            assert set(messages) <= set(map(float, range(200)))

    async def test_random_datagrams_into_a_session_break_nothing(self) -> None:
        dice = random.Random(7)
        async with host_of() as host, udp_device(host.udp, robot_topics()) as device:
            for _ in range(500):
                await device.send(
                    dice.randbytes(dice.randint(0, 200)) + dice.choice([b"", b"\xff\xfe", TOPICS_REQUEST])
                )
            await device.send(pose(3.0))
            await device.send(pose(4.0))
            await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages >= 1)
            assert not host.hub.isolation.crashes


class TestStrangers:
    async def test_bytes_without_a_frame_get_no_session_and_no_answer(self) -> None:
        dice = random.Random(1)
        async with host_of(UdpConfig()) as host:
            with blind_sockets(20, host.udp) as senders:
                for sender in senders:
                    for data in (b"x", dice.randbytes(1000), GREETING[:-1], b"\xff\xfe" * 100, HELLO):
                        sender.send(data)
                await expect(lambda: host.hub.counts.datagrams_dropped["not_rosserial"] == 100)
                await asyncio.sleep(A_WHILE_S)
                assert [came_back(sender) for sender in senders] == [0] * 20
            assert not host.hub.links.all()
            text = (await (await host.session.get(host.url + "/metrics")).read()).decode()
            assert 'hostlink_datagrams_dropped_total{cause="not_rosserial"} 100.0' in text

    async def test_an_address_that_is_not_verified_is_sent_no_more_than_it_has_sent(self) -> None:
        """However it is begun: by one frame, by topics that are a robot's, with a program that drives it."""
        infos = b"".join(encode(info.kind, encode_topic_info(info)) for info in robot_topics("forged"))
        attacks = [
            [GREETING],
            [GREETING, infos],
            [GREETING + infos],
            [infos, GREETING, GREETING],
            [encode(6, b"\0" * 9)],
        ]
        config = {"parameters": {"a": "x" * 500}}
        with capture_logs() as lines:
            async with host_of(UdpConfig(), **config) as host:
                with blind_sockets(len(attacks), host.udp) as senders:
                    for sender, attack in zip(senders, attacks, strict=True):
                        for data in attack:
                            sender.send(data)
                    for _ in range(15):
                        for robot in host.hub.robots.all():
                            body = b'{"linear": 0.2, "angular": 0}'
                            await host.rest("PUT", f"/api/robots/{robot.name}/velocity", body)
                        await asyncio.sleep(0.1)
                    back = [came_back(sender) for sender in senders]
                    sent = [len(b"".join(attack)) for attack in attacks]
                assert all(0 < each <= most for each, most in zip(back, sent, strict=True)), (back, sent)
        assert [line["cause"] for line in lines if line["event"] == "connection.refused"][:1] == ["unverified"]

    async def test_a_robot_that_is_not_verified_is_driven_as_far_as_it_sends(self) -> None:
        async with (
            host_of(UdpConfig()) as host,
            udp_device(host.udp, robot_topics()) as device,
            repeating(device, pose(0.0)),
        ):
            await host.drive("robot_0", b'{"linear": 0.2, "angular": 0}')
            assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
            assert await device.velocity_other_than((0.2, 0.0)) == (0.0, 0.0)
            assert device.received_bytes <= device.sent_bytes

    async def test_velocity_that_could_not_be_sent_is_not_sent_after_a_stop(self) -> None:
        async with host_of(UdpConfig()) as host, udp_device(host.udp, robot_topics()) as device:
            await expect(host.hub.robots.all)
            robot, program = host.hub.robots.find("robot_0"), host.hub.join("a program")
            for number in range(20):  # more than it has sent
                program.drive(robot, PlanarVelocity(x_m_s=0.1 + number / 100))
                await asyncio.sleep(0.01)
            device.read_waiting()
            program.drive(robot, PlanarVelocity(x_m_s=0.5))
            await asyncio.sleep(0.05)
            assert set(device.read_waiting()) <= {TOPICS_REQUEST}  # due after 2 s, and allowed: it is short
            robot.stop()
            await asyncio.sleep(0.3)  # longer than the zeros of a stop take
            outbox = host.hub.links.all()[0].session.outbox
            came: list[float] = []

            def read_velocities() -> None:
                velocities = [each for each in device.read_waiting() if len(each) == OTHER_BYTES[1]]
                came.extend(struct.unpack_from("<d", each, 7)[0] for each in velocities)

            async with asyncio.timeout(TIMEOUT_S):
                while not came or host.hub.gates._active or outbox.has_waiting:
                    await device.send(pose(0.0))
                    await asyncio.sleep(0.01)
                    read_velocities()
                read_velocities()
            assert len(came) >= ZEROS  # a zero that waits is not replaced by the next: a radio may lose one
            assert set(came) == {0.0}
            assert device.received_bytes <= device.sent_bytes

    async def test_forged_sources_neither_end_a_working_robot_nor_keep_a_trusted_one_out(self) -> None:
        udp = UdpConfig(trusted=(f"{ROBOT}/32",), max_connections=8)
        async with host_of(udp) as host, udp_device(host.udp, robot_topics("works"), local=(ROBOT, 0)) as works:
            await works.send(pose(0.0))
            infos = b"".join(encode(info.kind, encode_topic_info(info)) for info in robot_topics("works"))
            with blind_sockets(60, host.udp) as forged:
                for sender in forged:
                    sender.send(GREETING + infos)
                    sender.send(GREETING)
                    await works.send(pose(0.0))
                await expect(lambda: host.hub.counts.refused.total() >= 1)
                assert len(host.hub.links.all()) <= 1 + 4
                async with udp_device(host.udp, robot_topics("late"), local=(ROBOT, 0)) as late:
                    await late.send(pose(0.0))
                    await expect(lambda: host.hub.robots.find("late").link is not None)
            works_link = host.hub.robots.find("works").link
            assert works_link is not None
            assert works_link.peer == "{}:{}".format(*works.address)

    async def test_session_that_repeats_a_robots_names_from_its_address_does_not_replace_it(self) -> None:
        async with host_of(UdpConfig()) as host, udp_device(host.udp, robot_topics(), local=(ROBOT, 0)) as robot:
            infos = b"".join(encode(info.kind, encode_topic_info(info)) for info in robot_topics())
            with blind_sockets(1, host.udp, local_host=ROBOT) as (forged,):
                for _ in range(30):
                    await robot.send(pose(0.0))
                    forged.send(GREETING + infos)
                    await asyncio.sleep(0.02)
            link = host.hub.robots.find("robot_0").link
            assert link is not None
            assert link.peer == "{}:{}".format(*robot.address)

    async def test_sessions_are_opened_at_a_bounded_rate(self) -> None:
        async with host_of(UdpConfig()) as host:
            began_s = time.monotonic()
            async with asyncio.timeout(TIMEOUT_S):
                while not host.hub.counts.refused["too_fast"]:  # a slow machine reads fewer than that in a second
                    with blind_sockets(64, host.udp) as senders:
                        for sender in senders:
                            sender.send(GREETING)
                        await asyncio.sleep(0.05)
            took_s = time.monotonic() - began_s
            assert len(host.hub.links.all()) <= OPENED_A_SECOND * (1 + took_s) + 5

    async def test_an_address_that_is_not_allowed_gets_nothing(self) -> None:
        async with host_of(UdpConfig(allow=(f"{ROBOT}/32",))) as host:
            with blind_sockets(1, host.udp, local_host=OTHER) as (refused,):
                refused.send(GREETING)
                await expect(lambda: host.hub.counts.refused == {"not_allowed": 1})
                async with udp_device(host.udp, robot_topics(), local=(ROBOT, 0)):
                    await expect(host.hub.robots.all)
                assert came_back(refused) == 0


class TestInvitation:
    async def test_a_device_that_waits_for_the_host_is_sent_a_request_for_its_topics(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind((ROBOT, 0))
            local = free.getsockname()
        udp = UdpConfig(devices=("{}:{}".format(*local),))
        async with host_of(udp) as host, udp_device(host.udp, local=local) as device:
            await device.announce(robot_topics())
            await expect(host.hub.robots.all)
            assert host.hub.links.all()[0].peer == "{}:{}".format(*local)

    @pytest.mark.parametrize("text", ["192.168.4.2", "robot:11411", "192.168.4.2:0", "192.168.4.2:65536", ":11411"])
    def test_invalid_address_is_refused(self, text: str) -> None:
        with pytest.raises(ValueError, match=r"HOST:PORT|does not appear to be"):
            UdpConfig(devices=(text,))


class TestKey:
    @pytest.fixture
    def keyed(self, tmp_path: Path) -> UdpConfig:
        (tmp_path / "hostlink.key").write_bytes(KEY)
        return UdpConfig(key_file=tmp_path / "hostlink.key")

    async def test_a_device_with_the_key_is_verified(self, keyed: UdpConfig) -> None:
        async with host_of(keyed) as host, udp_device(host.udp) as device:
            loop = asyncio.get_running_loop()
            await device.send(HELLO)
            challenge = await loop.sock_recv(device.socket, 100)
            assert challenge.startswith(MAGIC)
            assert len(challenge) == len(HELLO)  # no more than it had sent
            await device.send(HELLO)  # it was impatient
            ours, theirs = bytes(range(RANDOM_BYTES)), challenge[len(MAGIC) :]
            await device.send(MAGIC + ours + proof(KEY, b"device", theirs, ours))
            assert await loop.sock_recv(device.socket, 100) == proof(KEY, b"host", theirs, ours)
            await device.announce(robot_topics())
            await expect(host.hub.robots.all)
            assert not host.hub.counts.refused

    async def test_a_device_without_it_is_sent_nothing_and_counted(self, keyed: UdpConfig) -> None:
        async with host_of(keyed) as host, udp_device(host.udp) as device:
            await device.greet()
            await expect(lambda: host.hub.counts.datagrams_dropped == {"not_rosserial": 1})
            await device.send(HELLO)
            await asyncio.get_running_loop().sock_recv(device.socket, 100)
            await device.send(MAGIC + bytes(range(RANDOM_BYTES)) + bytes(32))
            await expect(lambda: host.hub.counts.refused == {"wrong_key": 1})
            await expect(lambda: not host.hub.links.all())
            assert device.read_waiting() == []

    async def test_a_key_that_cannot_be_read_is_refused_by_name(self, tmp_path: Path) -> None:
        with pytest.raises(ConfigError, match=r"udp\.key_file"):
            async with host_of(UdpConfig(key_file=tmp_path / "missing")):
                raise AssertionError("it runs")


async def test_a_port_in_use_is_named_and_no_second_host_shares_it() -> None:
    async with host_of() as host:
        with pytest.raises(ConfigError, match=r"^UDP 127.0.0.1:\d+: is in use, .*--udp HOST:PORT"):
            async with serve_udp(
                UdpConfig(host="127.0.0.1", port=host.udp[1]), host.hub.counts.datagrams_dropped, lambda _port, _: False
            ):
                raise AssertionError("two hosts on one port")


async def test_a_port_that_the_guardian_of_a_killed_daemon_has_for_a_moment_is_waited_for() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as held:
        held.bind(("127.0.0.1", 0))
        config = UdpConfig(host="127.0.0.1", port=held.getsockname()[1])
        asyncio.get_running_loop().call_later(0.3, held.close)
        async with serve_udp(config, Counter(), lambda _port, _: False) as ports:
            assert ports[0].address[1] == config.port


async def test_a_device_over_ipv6_is_served() -> None:
    udp = UdpConfig(host="::1", port=0, trusted=("::1/128",))
    async with daemon(Config(udp=udp)) as host:
        with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as device:
            device.setblocking(False)
            device.connect(host.udp)
            device.send(GREETING)
            loop = asyncio.get_running_loop()
            assert await loop.sock_recv(device, 100) == TOPICS_REQUEST
            assert [link.peer for link in host.hub.links.all()] == [f"[::1]:{device.getsockname()[1]}"]
