"""Faults of networks, peers and certificates in a fleet: robots stop, names stay, read-only peers do not drive."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from hostlink.components.zenoh.fleet_messages import (
    MAX_ROBOTS,
    FleetCommand,
    FleetTopic,
    RobotMessage,
    State,
    TopicList,
    encode,
)
from hostlink.components.zenoh.lingering import ZENOHS, lingers
from hostlink.components.zenoh.settings import ZenohSettings
from hostlink.core.config import Config
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import HostlinkError
from tests.support.background import meanwhile
from tests.support.daemon import Daemon, daemon
from tests.support.driving import driven
from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.participants import subscribe
from tests.support.process import free_port
from tests.support.proxy import Line, Proxy, proxy
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import expect
from tests.support.zenoh_certificates import make_authority, make_certificate, write_rules
from tests.support.zenoh_fleet import drive, fleet, has_met, joined, port_of, robot, shown, subscriber_count
from tests.support.zenoh_fleet import zenoh as zenoh_settings

STILL, MOVING = (0.0, 0.0), (0.2, 0.0)


@contextlib.asynccontextmanager
async def apart() -> AsyncIterator[tuple[Daemon, Daemon, Proxy]]:
    """Two daemons, and the line between them."""
    async with contextlib.AsyncExitStack() as stack:
        (a,) = await stack.enter_async_context(fleet("a"))
        line = await stack.enter_async_context(proxy(("127.0.0.1", port_of(a))))
        b = await stack.enter_async_context(joined(int(line.url.rpartition(":")[2]), "b"))
        await has_met(a, 1)
        yield a, b, line


async def test_fleet_whose_port_is_in_use_is_joined_once_it_is_free() -> None:
    port = free_port()
    with socket.create_server(("127.0.0.1", port)) as taken:
        own = Config(component_settings={"zenoh": zenoh_settings("a", port)})
        async with daemon(own) as host, fake_device(host.tcp, robot_topics("robot_7")) as device:
            await expect(lambda: host.hub.diagnoses.own["zenoh"].code == "component_failed")
            await host.drive("robot_7", b'{"linear":0.2,"angular":0}')
            assert await device.velocity_other_than(STILL) == MOVING
            taken.close()
            async with joined(port, "b") as other:
                await shown(other, "robot_7")
            assert host.hub.diagnoses.own == {}


async def test_cut_network_ends_the_lease_and_remote_daemons_show_it() -> None:
    async with apart() as (a, b, line), fake_device(a.tcp, robot_topics("robot_7")) as device:
        before = (await shown(b, "robot_7")).link
        with contextlib.suppress(ExceptionGroup):  # the driver is told that it can no longer drive
            async with driven(b.hub, "robot_7", 0.2):
                assert await device.velocity_other_than(STILL) == MOVING
                line.set_line(Line.SWALLOWS)
                watch = Stopwatch()
                assert await device.velocity_other_than(MOVING) == STILL
                assert watch.seconds < 0.8 or a.was_paused  # a lease, and a step of the gate
                await asyncio.Event().wait()
        await expect(lambda: b.hub.robots.remote["robot_7"].link is None)
        assert watch.seconds < 2.0 or a.was_paused
        line.set_line(Line.WORKS)
        line.break_off()
        await expect(lambda: b.hub.robots.remote["robot_7"].link)
        assert b.hub.robots.remote["robot_7"].link != before  # every driver must drive again
        await expect(lambda: a.hub.counts.components["fleet"]()["met"] == 2)
        assert (await drive(b, "robot_7", 0.1))[0] == 200


@pytest.mark.parametrize("path", ["/api/stop", "/api/robots/robot_7/stop", "/api/robots/robot_7/lock"])
async def test_stop_or_lock_of_a_host_that_was_cut_off_is_503_and_in_force_when_it_is_seen_again(path: str) -> None:
    """A program at the robot's own daemon drives on meanwhile and ignores refusals."""
    async with apart() as (a, b, line), fake_device(a.tcp, robot_topics("robot_7")) as device:
        await shown(b, "robot_7")
        program = a.hub.join("program")

        async def go_on() -> None:
            while True:
                with contextlib.suppress(HostlinkError):
                    program.drive(a.hub.robots.find("robot_7"), PlanarVelocity(0.2))
                await asyncio.sleep(0.1)

        async with meanwhile(go_on()):
            await device.velocity_of(MOVING)
            line.set_line(Line.SWALLOWS)
            await expect(lambda: b.hub.robots.remote["robot_7"].link is None)
            status, answer = await b.rest("POST", path)
            assert (status, "a: has not answered" in str(answer)) == (503, True)
            assert a.hub.robots.find("robot_7").state(0.0).velocity.x_m_s == 0.2 or a.was_paused
            line.set_line(Line.WORKS)
            line.break_off()
            await device.velocity_of(STILL)
            is_locked = path.endswith("lock")
            for known in (a.hub.robots.find("robot_7"), b.hub.robots.remote["robot_7"]):
                await expect(lambda known=known: (known.state(0.0).lock_reason is not None) is is_locked)


async def test_no_link_of_a_fleet_is_closed_with_waiting() -> None:
    """A close that waits 10 s for a host that vanished makes the daemon deaf to all others (tools/netns_fleet.py)."""
    async with fleet("a", "b") as hosts:  # in one process, each finds the sockets of both
        await expect(lambda: sum(host.hub.counts.components["zenoh"]()["links"] for host in hosts) >= 2)
        await expect(lambda: all(linger != ZENOHS for linger in lingers().values()))


async def test_delayed_commands_move_no_robot() -> None:
    async with apart() as (a, b, line), fake_device(a.tcp, robot_topics("robot_7")) as device:
        found = await shown(b, "robot_7")
        participant = b.hub.join("driver")
        participant.drive(found, PlanarVelocity(x_m_s=0.2))
        assert await device.velocity_other_than(STILL) == MOVING
        line.set_line(Line.STALLS)
        participant.drive(found, PlanarVelocity(x_m_s=0.3))
        assert await device.velocity_other_than(MOVING) == STILL
        await asyncio.sleep(
            0.2
        )  # so that it is over a lease late; Zenoh gives the connection up a second after the stall
        refused = a.hub.counts.components["fleet"]()["refused"]
        line.set_line(Line.WORKS)
        await expect(lambda: a.hub.counts.components["fleet"]()["refused"] > refused or a.was_paused)
        assert a.hub.robots.find_here("robot_7").gate.owner is None


async def test_delayed_first_command_moves_no_robot() -> None:
    async with apart() as (a, b, line), fake_device(a.tcp, robot_topics("robot_7")):
        found = await shown(b, "robot_7")
        await asyncio.sleep(1.2)  # a state has come, by which the other clock is known
        line.set_line(Line.STALLS)
        b.hub.join("driver").drive(found, PlanarVelocity(x_m_s=0.3))
        await asyncio.sleep(0.7)
        line.set_line(Line.WORKS)
        await expect(lambda: a.hub.counts.components["fleet"]()["refused"] or a.was_paused)
        assert a.hub.robots.find_here("robot_7").gate.counts.commands == 0


# -- a peer that lies -------------------------------------------------------------------------------------------------


class Liar:
    """A peer that speaks the fleet's protocol, and sends what it likes."""

    def __init__(self, session: Any, name: str = "liar") -> None:
        self.session, self.name, self.zid = session, name, str(session.info.zid())
        self._token = session.liveliness().declare_token(f"hostlink/alive/{name}/{self.zid}")

    def put(self, verb: str, payload: bytes, *, to: str = "") -> None:
        self.session.put("/".join(filter(None, ("hostlink", verb, to, self.name, self.zid))), payload)

    def claim(self, *names: str, topics: int = 0) -> None:
        self.put("state", encode(State(sent_s=0.0, topics=topics, robots=tuple(map(_claimed, names)))))


def _claimed(name: str) -> RobotMessage:
    return RobotMessage(
        name=name,
        link=1,
        velocity_topic=f"/{name}/cmd_vel",
        odometry_topic=f"/{name}/odometry",
        odometry_type="nav_msgs/Odometry",
    )


@contextlib.asynccontextmanager
async def lied_to() -> AsyncIterator[tuple[Daemon, Daemon, Liar]]:
    """Two daemons, and a peer that is connected to both."""
    async with fleet("a", "b") as (a, b):
        config = zenoh.Config()
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("listen/endpoints", "[]")
        config.insert_json5("connect/endpoints", str([f"tcp/127.0.0.1:{port_of(host)}" for host in (a, b)]))
        session = await asyncio.to_thread(zenoh.open, config)
        try:
            yield a, b, Liar(session)
        finally:
            await asyncio.to_thread(session.close)


async def _until_heard(host: Daemon, liar: Liar, *names: str) -> None:
    def is_heard() -> bool:
        liar.claim(*names)
        return names[-1] in host.hub.robots.remote

    await expect(is_heard)


async def test_a_robot_s_topics_stay_below_its_name() -> None:
    async with lied_to() as (a, _, liar):
        topics = TopicList(
            number=1,
            topics=(
                FleetTopic(robot="robot_66", name="/tf", type="tf2_msgs/TFMessage", is_published=True),
                FleetTopic(robot="robot_66", name="/robot_7/cmd_vel", type="geometry_msgs/Twist", is_velocity=True),
                FleetTopic(robot="robot_66", name="/robot_66/odom", type="nav_msgs/Odometry", is_published=True),
                FleetTopic(robot="robot_66", name="/robot_66/x", type="none/Unknown", is_published=True),
            ),
        )
        key = f"hostlink/topics/liar/{liar.zid}"
        liar.session.declare_queryable(key, lambda query: query.reply(key, encode(topics)))
        await _until_heard(a, liar, "robot_66")
        await expect(lambda: a.hub.topics.find_or_none("/robot_66/odom"))
        assert a.hub.topics.find_or_none("/tf") is None
        assert a.hub.topics.find_or_none("/robot_7/cmd_vel") is None
        assert a.hub.counts.components["fleet"]()["foreign_topics"] >= 2
        assert a.hub.counts.components["fleet"]()["refused_topics"] >= 1


async def test_malformed_payload_is_counted_and_ignored() -> None:
    payload = b'{"robots":1}'
    async with lied_to() as (a, b, liar), fake_device(b.tcp, robot_topics("robot_7")):
        await shown(a, "robot_7")
        counts, me = b.hub.counts.components["fleet"](), _zid_of(a, "robot_7")
        await _until_heard(b, liar, "robot_66")
        before = counts["malformed"]
        for verb in ("state", "stop"):
            liar.put(verb, payload)
        for verb in ("drive", "answer"):
            liar.put(verb, payload, to=me)
        await expect(lambda: counts["malformed"] >= before + 4)
        assert (await drive(a, "robot_7", 0.2))[0] == 200
        assert b.hub.isolation.crashes.total() == 0


def _zid_of(host: Daemon, name: str) -> str:
    return str(host.hub.robots.remote[name].place)


async def test_payload_over_the_limit_is_dropped() -> None:
    async with lied_to() as (a, b, liar), fake_device(b.tcp, robot_topics("robot_7")):
        await shown(a, "robot_7")
        await _until_heard(b, liar, "robot_66")

        def oversized() -> int:
            return b.hub.counts.components["zenoh"]().get("oversized", 0)

        for verb, size_bytes, to in (("state", 300 * 1024, ""), ("drive", 8192, _zid_of(a, "robot_7"))):
            before = oversized()

            def is_dropped() -> bool:
                liar.put(verb, b" " * size_bytes, to=to)  # noqa: B023 - called in this turn of the loop only
                return oversized() > before  # noqa: B023

            await expect(is_dropped)


async def test_flood_of_commands_delays_no_stop() -> None:
    async with lied_to() as (a, b, liar), fake_device(b.tcp, robot_topics("robot_7")) as device:
        found = await shown(a, "robot_7")
        await _until_heard(b, liar, "robot_66")
        place = _zid_of(a, "robot_7")
        flood = encode(
            FleetCommand(
                number=1,
                sent_s=1.0,
                robot="robot_9",
                owner=1,
                owner_name="x",
                velocity=(0.1,) + (0.0,) * 5,
                priority=50,
            )
        )
        stop = asyncio.Event()

        def pour() -> None:
            while not stop.is_set():
                for _ in range(100):
                    liar.put("drive", flood, to=place)

        async with asyncio.TaskGroup() as tasks:
            pouring = tasks.create_task(asyncio.to_thread(pour))
            try:
                await expect(lambda: b.hub.counts.components["zenoh"]()["dropped"] > 100)
                participant = a.hub.join("driver")
                participant.drive(found, PlanarVelocity(x_m_s=0.2))
                assert await device.velocity_other_than(STILL) == MOVING
                watch = Stopwatch()
                participant.leave()
                assert await device.velocity_other_than(MOVING) == STILL
                assert watch.seconds < 0.45 or b.was_paused  # sooner than the lease
            finally:
                stop.set()
                await pouring


async def test_a_peer_with_many_robots_keeps_the_loop_for_no_stop() -> None:
    """Changes of 256 robots are processed in slices, so that other tasks run in between."""
    async with lied_to() as (a, _, liar):
        await _until_heard(a, liar, "robot_66")
        names = [f"claimed_{number}" for number in range(MAX_ROBOTS)]
        shown: set[int] = set()

        async def watch() -> None:
            while True:
                shown.add(len(a.hub.robots.remote))
                await asyncio.sleep(0)

        async with asyncio.TaskGroup() as tasks:
            watching = tasks.create_task(watch())
            liar.claim(*names)
            await expect(lambda: a.hub.robots.remote.keys() >= set(names))
            watching.cancel()
        assert len(shown) > 3  # of one slice there would be two: none and all
        assert a.hub.isolation.crashes.total() == 0


# -- certificates -----------------------------------------------------------------------------------------------------


def _secured(folder: Path, name: str, port: int, *others: int, **settings: Any) -> Config:
    certificate, key = make_certificate(folder, name)
    return Config(
        component_settings={
            "zenoh": ZenohSettings(
                name=name,
                listen=(f"tls/127.0.0.1:{port}",),
                connect=tuple(f"tls/127.0.0.1:{other}" for other in others),
                multicast=False,
                ca=folder / "ca.pem",
                certificate=certificate,
                key=key,
                **settings,
            )
        }
    )


async def test_a_certificate_that_may_only_read_reads_and_stops_and_does_not_drive(tmp_path: Path) -> None:
    make_authority(tmp_path)
    rules = write_rules(tmp_path / "rules.json5", drivers=["host-b"], readers=["host-c"])
    ports = [free_port() for _ in range(3)]
    async with (
        daemon(_secured(tmp_path, "host-a", ports[0], file=rules)) as a,
        daemon(_secured(tmp_path, "host-b", ports[1], ports[0])) as b,
        daemon(_secured(tmp_path, "host-c", ports[2], ports[0])) as c,
        fake_device(a.tcp, robot_topics("robot_7")) as device,
    ):
        await shown(b, "robot_7")
        await shown(c, "robot_7")
        assert (await drive(b, "robot_7", 0.2))[0] == 200
        assert await device.velocity_other_than(STILL) == MOVING
        status, answer = await drive(c, "robot_7", 0.3)
        assert (status, answer["error"]["kind"]) == (503, "DeviceGone")
        assert "host-a does not answer" in answer["error"]["reason"]
        assert (await robot(c, "robot_7"))["holder"] != "program (127.0.0.1) at host-c"
        assert (await c.rest("POST", "/api/robots/robot_7/lock"))[0] == 200
        assert a.hub.robots.find_here("robot_7").gate.lock_reason is not None
        assert (await c.rest("POST", "/api/robots/robot_7/unlock"))[0] == 503


# -- a router ---------------------------------------------------------------------------------------------------------


async def test_a_router_carries_a_fleet_of_clients() -> None:
    port = free_port()
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')

    def client(name: str) -> Config:
        there = (f"tcp/127.0.0.1:{port}",)
        return Config(
            component_settings={"zenoh": ZenohSettings(name=name, mode="client", connect=there, multicast=False)}
        )

    async with contextlib.AsyncExitStack() as stack:
        router = await asyncio.to_thread(zenoh.open, config)
        a, b = [await stack.enter_async_context(daemon(client(name))) for name in "ab"]
        stack.push_async_callback(asyncio.to_thread, router.close)
        device = await stack.enter_async_context(fake_device(b.tcp, robot_topics("robot_7")))
        await shown(a, "robot_7")
        received: list[bytes] = []
        await expect(lambda: a.hub.topics.find_or_none("/robot_7/odometry"))
        before = await subscriber_count(b, "/robot_7/odometry")
        subscribe(a.hub, "/robot_7/odometry", lambda message: received.append(message.payload))
        await expect(lambda: len(b.hub.topics.find("/robot_7/odometry").subscribers) == before + 1)
        await device.send(pose(2.5))
        await expect(lambda: received)
        assert (await drive(a, "robot_7", 0.2))[0] == 200
        assert await device.velocity_other_than(STILL) == MOVING
        assert (await a.rest("POST", "/api/stop"))[0] == 200
        assert await device.velocity_other_than(MOVING) == STILL
