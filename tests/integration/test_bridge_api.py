"""API that a bridge to another graph uses: the graph as it changes, bytes in both directions, no echo, services."""

import asyncio
import struct
from collections.abc import Mapping
from typing import Any

import pytest

from hostlink.client import Host, HostlinkError, connect
from hostlink.client.mailbox import Mailbox
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import encode
from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, robot_topics, topic
from tests.support.rosbridge import client
from tests.support.waiting import TIMEOUT_S, expect_never

Graphs = Mailbox[dict[str, Any]]


async def until(graphs: Graphs, is_so: Any) -> dict[str, Any]:
    """The first graph of which this is true."""
    async with asyncio.timeout(TIMEOUT_S):
        async for graph in graphs:
            if is_so(graph):
                return graph
    raise AssertionError


def by_name(graph: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    return {each["name"]: each for each in graph["topics"]}


async def test_a_robot_is_in_the_graph_with_the_topics_that_drive_it_also_while_its_device_is_away() -> None:
    async with daemon() as server, connect(server.url, group="other") as me:
        graphs = await me.watch_graph()
        async with fake_device(server.tcp, robot_topics()):
            graph = await until(graphs, lambda graph: graph["robots"])
            robot = graph["robots"][0]
            assert robot["name"] == "robot_0"
            assert robot["link"] == 1
            velocities = robot["velocity_topics"]
            assert velocities == {
                "/robot_0/velocity_commands": "geometry_msgs/Twist",
                "/robot_0/cmd_vel": "geometry_msgs/Twist",
                "/robot_0/cmd_vel_stamped": "geometry_msgs/TwistStamped",
            }
            topics = by_name(graph)
            assert topics["/robot_0/odom"]["published"]
            assert topics["/robot_0/odom"]["type"] == "nav_msgs/Odometry"
            assert topics["/robot_0/cmd_vel"]["velocity"]
            assert {"name": "/robot_0/lock", "type": "std_srvs/Trigger"} in graph["services"]
        left = await until(graphs, lambda graph: graph["robots"][0]["link"] is None)
        assert left["robots"][0]["velocity_topics"] == velocities
        assert {name for name in by_name(left) if "robot_0" in name} == velocities.keys()


async def test_the_graph_is_watched_on_after_the_connection_was_lost() -> None:
    async with daemon() as server, connect(server.url, group="a") as me:
        graphs = await me.watch_graph()
        await until(graphs, lambda _: True)
        assert me._connection._socket is not None
        await me._connection._socket.close()
        async with fake_device(server.tcp, robot_topics()):
            await until(graphs, lambda graph: graph["robots"])


async def test_bytes_come_as_the_device_sends_them_and_go_as_they_are() -> None:
    servo = topic(EndpointKind.SUBSCRIBER, 110, "/robot_0/servo", "std_msgs/Float64")
    async with (
        daemon() as server,
        connect(server.url) as me,
        fake_device(server.tcp, [*robot_topics(), servo]) as device,
    ):
        async with me.subscribe_raw("/robot_0/odometry") as messages:
            await me.settle()
            payload = struct.pack("<3d", 1.0, float("nan"), float("inf"))
            await device.send(encode(125, payload))
            async with asyncio.timeout(TIMEOUT_S):
                assert (await anext(messages)).payload == payload
        await me.publish_raw("/robot_0/servo", struct.pack("<d", float("-inf")))
        assert await device.frame(110) == struct.pack("<d", float("-inf"))


async def test_bytes_of_another_type_reach_no_device() -> None:
    servo = topic(EndpointKind.SUBSCRIBER, 110, "/robot_0/servo", "std_msgs/Float64")
    async with (
        daemon() as server,
        connect(server.url) as me,
        fake_device(server.tcp, [*robot_topics(), servo]) as device,
    ):
        await me.publish_raw("/robot_0/servo", bytes(5))
        with pytest.raises(HostlinkError, match="std_msgs/Float64"):
            await me.settle()
        await me.publish_raw("/robot_0/servo", struct.pack("<d", 2.0))
        assert await device.frame(110) == struct.pack("<d", 2.0)


@pytest.mark.parametrize("raw", ["?", 5, ["QQ=="], "QQ"])
async def test_invalid_base64_is_refused(raw: object) -> None:
    async with daemon() as server, client(server) as program:
        await program.send(op="publish", topic="/a", type="std_msgs/Empty", raw=raw, id=1)
        answer = await program.receive()
        assert "raw must be base64" in answer["msg"]


async def test_a_group_does_not_receive_what_it_publishes_and_others_do() -> None:
    async with (
        daemon() as server,
        connect(server.url, group="a") as me,
        connect(server.url) as other,
        me.subscribe("/chat", type_name="std_msgs/String") as own,
        other.subscribe("/chat", type_name="std_msgs/String") as theirs,
        connect(server.url, group="a") as same,
    ):
        await me.settle()
        await other.settle()
        await same.publish("/chat", {"data": "x"}, type_name="std_msgs/String")
        async with asyncio.timeout(TIMEOUT_S):
            assert await anext(theirs) == {"data": "x"}
        await expect_never(own.pop_all, for_s=0.1)
        await other.publish("/chat", {"data": "y"}, type_name="std_msgs/String")
        async with asyncio.timeout(TIMEOUT_S):
            assert await anext(own) == {"data": "y"}


async def add(request: Mapping[str, Any]) -> Mapping[str, Any]:
    if request["a"] < 0:
        raise HostlinkError("only positive ones")
    return {"sum": request["a"] + request["b"]}


async def call(host: Host, a: int) -> Any:
    return await host.call("/add", {"a": a, "b": 2})


async def test_a_service_of_a_program_is_answered_refused_and_gone_with_its_block() -> None:
    async with daemon() as server, connect(server.url) as me, connect(server.url) as other:
        async with me.serve("/add", "rospy_tutorials/AddTwoInts", add):
            await me.settle()
            assert await call(other, 1) == {"sum": 3}
            with pytest.raises(HostlinkError, match="only positive ones"):
                await call(other, -1)
        await me.settle()
        with pytest.raises(HostlinkError, match="no service named /add"):
            await call(other, 1)


async def test_a_service_is_offered_again_after_the_connection_was_lost() -> None:
    async with daemon() as server, connect(server.url) as me, connect(server.url) as other:
        changes = me.connection()
        async with me.serve("/add", "rospy_tutorials/AddTwoInts", add):
            assert me._connection._socket is not None
            await me._connection._socket.close()
            async with asyncio.timeout(TIMEOUT_S):
                while not (await anext(changes)).is_connected:
                    pass
            await me.settle()
            assert await call(other, 1) == {"sum": 3}


async def test_a_block_that_is_left_waits_for_no_answer_of_its_own() -> None:
    has_begun = asyncio.Event()

    async def never(_: Mapping[str, Any]) -> Mapping[str, Any]:
        has_begun.set()
        await asyncio.Event().wait()
        return {}

    async with daemon() as server, connect(server.url) as other, asyncio.TaskGroup() as tasks:
        async with (
            asyncio.timeout(TIMEOUT_S),
            connect(server.url) as me,
            me.serve("/add", "rospy_tutorials/AddTwoInts", never),
        ):
            await me.settle()
            calling = tasks.create_task(failed(other))
            await has_begun.wait()
        assert "/add" in await calling


async def failed(host: Host) -> str:
    with pytest.raises(HostlinkError) as found:
        await call(host, 1)
    return str(found.value)
