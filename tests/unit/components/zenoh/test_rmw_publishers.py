"""Publishers of ROS 2 as drivers, in virtual time and without a network."""

import asyncio
import struct
from collections import Counter
from dataclasses import dataclass, field
from typing import cast

import pytest
from structlog.testing import capture_logs

from hostlink.components.graphs.ros2_qos import Qos
from hostlink.components.graphs.ros2_types import Ros2Types
from hostlink.components.zenoh import rmw_bridge
from hostlink.components.zenoh.rmw_bridge import Publishers, RmwNode
from hostlink.components.zenoh.rmw_protocol import (
    Attachment,
    EndpointToken,
    NodeToken,
    RemoteGraph,
    TokenKind,
    gid_of,
)
from hostlink.components.zenoh.session import ZenohSession
from hostlink.core.hub.hub import Hub
from hostlink.core.mirror.log_once import LogOnce
from hostlink.core.robot.velocity import PlanarVelocity
from tests.support.fake_device import CATALOG
from tests.support.hosts import host_in
from tests.support.logs import logged
from tests.support.participants import ROBOT, Scene, play
from tests.support.virtual_loop import inside

CMD_VEL, TWIST = f"/{ROBOT}/cmd_vel", "geometry_msgs/msg/Twist"
NO_SESSION = cast("ZenohSession", None)  # publishers send nothing


@dataclass
class Remote:
    """ROS 2 as the bridge knows it."""

    hub: Hub
    counts: Counter[str] = field(default_factory=Counter)
    sent: int = 0

    def __post_init__(self) -> None:
        host, own = host_in(self.hub, "zenoh"), NodeToken(0, "ff", 0, "/", "hostlink")
        node = RmwNode(host, NO_SESSION, Ros2Types(CATALOG, "kilted"), own, self.counts)
        self.graph = RemoteGraph(0, self.counts)
        self.publishers = Publishers(node, self.graph, LogOnce(self.counts))

    def come(self, session: str, *, topic: str = CMD_VEL, type_name: str = TWIST) -> str:
        key = EndpointToken(
            TokenKind.PUBLISHER,
            NodeToken(0, session, 0, "/", f"driver_{session}"),
            1,
            topic,
            type_name,
            "RIHS01_0",
            Qos(),
        ).encode()
        token = self.graph.add(key)
        assert isinstance(token, EndpointToken)
        self.publishers.add(token, key)
        return key

    def go(self, key: str) -> None:
        removed = self.graph.remove(key)
        assert removed is not None
        self.publishers.remove(removed)

    def drive(self, gid: bytes, speed_m_s: float, *, source_s: float | None = None) -> None:
        self.sent += 1
        source_s = asyncio.get_running_loop().time() if source_s is None else source_s
        attachment = Attachment(self.sent, int(source_s * 1e9), gid)
        payload = struct.pack("<6d", speed_m_s, 0, 0, 0, 0, 0)
        self.publishers.publish(attachment, (CMD_VEL, TWIST), payload, topic=CMD_VEL)

    def owner(self) -> str | None:
        return self.hub.robots.find(ROBOT).gate.owner_name


@inside(play)
async def test_each_publisher_is_a_driver_of_its_own_and_leaves_with_its_token(scene: Scene) -> None:
    remote = Remote(scene.hub)
    first, second = remote.come("aa"), remote.come("bb")
    remote.drive(gid_of(first), 0.3)
    assert remote.owner() == "ros2 /driver_aa"
    remote.go(second)
    assert remote.owner() == "ros2 /driver_aa"
    remote.go(first)
    assert remote.owner() is None
    await asyncio.sleep(0.1)
    assert scene.speeds()[-1] == 0
    remote.drive(gid_of(first), 0.3)
    assert remote.counts["unidentified"] == 1
    assert remote.owner() is None
    await scene.neighbour_works()


@inside(play)
async def test_a_driver_that_drew_its_gid_stops_with_any_of_its_kind(scene: Scene) -> None:
    remote = Remote(scene.hub)
    await asyncio.sleep(rmw_bridge.MATCH_S)
    keys = [remote.come(session) for session in ("aa", "bb")]
    remote.drive(b"1" * 16, 0.3)
    remote.drive(b"2" * 16, 0.0)
    assert remote.owner() == "ros2 /driver_aa"
    remote.go(keys[1])  # of those two it may be the one that drives
    assert remote.owner() is None
    remote.drive(b"1" * 16, 0.2)
    assert remote.owner() == "ros2 /driver_aa"
    await asyncio.sleep(0.6)
    assert remote.owner() is None


@pytest.mark.parametrize("away_s", [0.0, 5.0])
@inside(play)
async def test_stream_through_the_loss_of_its_token_drives_after_a_zero(scene: Scene, away_s: float) -> None:
    """Token that is lost and returns, as in a cut of the network."""
    remote = Remote(scene.hub)
    await asyncio.sleep(rmw_bridge.MATCH_S)
    key = remote.come("aa")
    remote.drive(gid_of(key), 0.3)
    assert remote.owner() == "ros2 /driver_aa"
    remote.go(key)
    await asyncio.sleep(away_s)
    remote.come("aa")
    for _ in range(20):
        remote.drive(gid_of(key), 0.3)
        assert remote.owner() is None
        await asyncio.sleep(0.1)
    remote.drive(gid_of(key), 0.0)
    remote.drive(gid_of(key), 0.3)
    assert remote.owner() == "ros2 /driver_aa"


@inside(play)
async def test_a_token_that_was_forgotten_is_not_taken_for_a_new_one(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Over the bound on remembered tokens, each new token may be an earlier one."""
    monkeypatch.setattr(rmw_bridge, "MAX_GONE", 2)
    remote = Remote(scene.hub)
    await asyncio.sleep(rmw_bridge.MATCH_S)
    keys = [remote.come(session) for session in ("aa", "bb", "cc")]
    for key in keys:
        remote.go(key)
    for session in ("aa", "bb", "cc"):
        remote.come(session)
    remote.sent = 100
    for key in keys:
        remote.drive(gid_of(key), 0.3)
        assert remote.owner() is None
    remote.sent = 0
    remote.drive(gid_of(remote.come("dd")), 0.3)
    assert remote.owner() == "ros2 /driver_dd"


@inside(play)
async def test_velocity_that_waited_for_a_lease_moves_no_robot(scene: Scene) -> None:
    remote = Remote(scene.hub)
    gid = gid_of(remote.come("aa"))
    for _ in range(5):
        remote.drive(gid, 0.0)
        await asyncio.sleep(0.1)
    at_s = asyncio.get_running_loop().time()
    remote.drive(gid, 0.3, source_s=at_s - 0.2)
    assert remote.owner() is not None
    await asyncio.sleep(2)
    remote.drive(gid, 0.3, source_s=at_s + 1)
    assert remote.owner() is None
    assert remote.counts["late"] == 1


@pytest.mark.parametrize("what_began", ["bridge", "subscription"])
@inside(play)
async def test_stream_from_before_drives_after_a_zero(scene: Scene, what_began: str) -> None:
    """The bridge joins it: it began here just now, or the robot's device connected."""
    remote = Remote(scene.hub)
    if what_began == "subscription":
        await asyncio.sleep(rmw_bridge.MATCH_S)
    gid = gid_of(remote.come("aa"))
    remote.sent = 100
    if what_began == "subscription":
        remote.publishers.join((CMD_VEL, TWIST))
    await asyncio.sleep(rmw_bridge.MATCH_S - 0.1)
    for _ in range(20):
        remote.drive(gid, 0.3)
        assert remote.owner() is None
        await asyncio.sleep(0.1)
    remote.drive(gid, 0.0)
    remote.drive(gid, 0.3)
    assert remote.owner() == "ros2 /driver_aa"


@pytest.mark.parametrize("is_first", [False, True])
@inside(play)
async def test_publisher_of_before_whose_motion_begins_now_drives(scene: Scene, *, is_first: bool) -> None:
    """Two ways to be new: a first sequence number, or silence until every earlier stream would have arrived."""
    remote = Remote(scene.hub)
    gid = gid_of(remote.come("aa"))
    remote.publishers.join((CMD_VEL, TWIST))
    if not is_first:
        remote.sent = 100
        await asyncio.sleep(rmw_bridge.MATCH_S + 0.1)
    remote.drive(gid, 0.3)
    assert remote.owner() == "ros2 /driver_aa"


@inside(play)
async def test_a_clock_that_is_set_back_by_an_hour_drives_on(scene: Scene) -> None:
    remote = Remote(scene.hub)
    gid = gid_of(remote.come("aa"))
    for number in range(20):
        at_s = asyncio.get_running_loop().time() + (7200 if number < 10 else 3600)
        remote.drive(gid, 0.3, source_s=at_s)
        assert remote.owner() is not None
        await asyncio.sleep(0.1)
    assert not remote.counts["late"]


@inside(play)
async def test_a_refused_velocity_is_counted_and_in_both_logs_now_and_then(scene: Scene) -> None:
    remote = Remote(scene.hub)
    gid = gid_of(remote.come("aa"))
    teleop = scene.hub.join("teleop", priority=60)
    lines: list[dict[str, object]] = []
    scene.neighbour.subscribe("/rosout", lambda message: lines.append(message.decoded))
    with capture_logs() as logs:
        for _ in range(150):
            teleop.drive(scene.hub.robots.find(ROBOT), PlanarVelocity(0.1))
            remote.drive(gid, 0.3)
            await asyncio.sleep(0.1)
    assert remote.counts["refused"] == 150
    refused = [log for log in logs if log["event"] == "ros2.refused"]
    assert len(refused) == 2
    assert refused[0]["count"] == 1
    assert 99 <= refused[1]["count"] <= 101
    assert refused[0]["kind"] == "held"
    assert "teleop" in refused[0]["reason"]
    assert [(line["name"], line["level"]) for line in lines] == [("/hostlink", 4)] * 2
    assert str(lines[0]["msg"]).startswith(f"{CMD_VEL} of ros2 /driver_aa is refused (held): {ROBOT}: teleop drives")


@inside(play)
async def test_publishers_of_one_process_are_bounded(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rmw_bridge, "MAX_PUBLISHERS_OF_SESSION", 3)
    remote = Remote(scene.hub)
    keys = [remote.come("aa", topic=f"/topic_{number}") for number in range(5)]
    driver = remote.come("bb")
    assert remote.counts["crowded_publishers"] == 2
    remote.drive(gid_of(driver), 0.2)
    assert remote.owner() == "ros2 /driver_bb"
    for key in keys:
        remote.go(key)
    remote.come("aa", topic="/again")
    assert remote.counts["crowded_publishers"] == 2


@inside(play)
async def test_publisher_that_waited_for_room_drives_after_a_zero(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Publisher that waited for room: it may have streamed for long."""
    monkeypatch.setattr(rmw_bridge, "MAX_PUBLISHERS_OF_SESSION", 1)
    remote = Remote(scene.hub)
    await asyncio.sleep(rmw_bridge.MATCH_S)
    first, driver = remote.come("aa", topic="/topic"), remote.come("aa")
    remote.sent = 100
    await asyncio.sleep(rmw_bridge.NEW_S + 0.1)
    remote.drive(gid_of(driver), 0.3)
    assert remote.counts["unidentified"] == 1
    remote.go(first)
    remote.drive(gid_of(driver), 0.3)
    assert remote.owner() is None
    remote.drive(gid_of(driver), 0.0)
    remote.drive(gid_of(driver), 0.3)
    assert remote.owner() == "ros2 /driver_aa"


@inside(play)
async def test_topics_of_every_node_for_tools_are_left_out(scene: Scene) -> None:
    remote = Remote(scene.hub)
    with capture_logs() as logs:
        remote.come("aa", topic="/parameter_events", type_name="rcl_interfaces/msg/ParameterEvent")
        remote.come("aa", topic="/rosout", type_name="rcl_interfaces/msg/Log")
        remote.come("aa", topic="/drive/_action/feedback", type_name="x/msg/Y")
    assert logged(logs) == []
    assert scene.hub.topics.find_or_none("/parameter_events") is None
