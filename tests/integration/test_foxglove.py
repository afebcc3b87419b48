"""The requests of Foxglove's rosbridge player: no types, raw payloads, the graph again and again."""

import asyncio
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hostlink.core.protocol.rosserial.control import Log
from hostlink.core.protocol.rosserial.frame import Id, encode
from tests.support.daemon import Daemon, daemon
from tests.support.device_codec import encode_log
from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.rosbridge import Client, client
from tests.support.waiting import TIMEOUT_S, expect

NODES = "/rosapi/nodes"


async def read_graph(player: Client) -> dict[str, tuple[str, str]]:
    """Name -> type and definition, as it asks for them every three seconds."""
    raw = await player.call("/rosapi/topics_and_raw_types")
    columns = (raw["topics"], raw["types"], raw["typedefs_full_text"])
    return {name: (type_name, text) for name, type_name, text in zip(*columns, strict=True)}


def reader_of(graph: dict[str, tuple[str, str]]) -> Any:
    """A reader that knows nothing but what the player is told."""
    store = get_typestore(Stores.EMPTY)
    for type_name, text in graph.values():
        package, name = type_name.split("/")
        store.register(get_types_from_msg(text, f"{package}/msg/{name}"))
    return store


async def subscribed(host: Daemon, names: list[str]) -> None:
    def is_so() -> bool:
        keys = [[str(subscriber.key) for subscriber in host.hub.topics.find(name).subscribers] for name in names]
        return all("client 1" in found for found in keys)

    await expect(is_so)


async def test_a_player_shows_a_robot_by_the_protocol_alone() -> None:
    wanted = ["/robot_0/odometry", "/robot_0/odom", "/tf", "/rosout"]
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host, level="none") as player:
        graph = await read_graph(player)
        assert "rosgraph_msgs/Log" in {type_name for type_name, _ in graph.values()}  # how it knows ROS 1
        assert "/clock" not in graph
        reader = reader_of(graph)
        for name in wanted:
            await player.send(op="subscribe", id=f"subscribe:{name}:1", topic=name, compression="cbor-raw")
        await subscribed(host, wanted)
        await device.send(pose(1.0, 2.0, 0.5) + encode(Id.LOG, encode_log(Log(2, "warm"))))
        read = {}
        for _ in wanted:
            frame = await player.receive_binary()
            package, name = graph[frame["topic"]][0].split("/")
            read[frame["topic"]] = reader.deserialize_ros1(frame["msg"]["bytes"], f"{package}/msg/{name}")
            assert frame["msg"]["secs"] > 1_700_000_000
    assert (read["/robot_0/odometry"].x, read["/robot_0/odom"].pose.pose.position.x) == (1.0, 1.0)
    assert read["/tf"].transforms[0].child_frame_id == "robot_0/base_link"
    assert (read["/rosout"].level, read["/rosout"].msg) == (4, "warm")


async def test_the_graph_is_read_while_messages_flow() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host, level="none") as player:
        await player.send(op="subscribe", topic="/robot_0/odometry", compression="cbor-raw")
        await subscribed(host, ["/robot_0/odometry"])
        for number in range(3):
            for service, args in (
                ("/rosapi/topics_and_raw_types", {}), (NODES, {}), ("/rosapi/node_details", {"node": "/robot_0"}),
                ("/rosapi/service_type", {"service": NODES}),
            ):  # fmt: skip
                await player.send(op="call_service", id=f"{service}:{number}", service=service, args=args)
            await device.send(pose(float(number)))
        async with asyncio.timeout(TIMEOUT_S):
            frames = [await player.socket.receive() for _ in range(15)]
        answers = [frame.json() for frame in frames if frame.type.name == "TEXT"]
    assert all(answer["result"] for answer in answers)
    by_service = {answer["service"]: answer["values"] for answer in answers}
    assert {"/hostlink", "/robot_0", "/client_1"} <= set(by_service[NODES]["nodes"])
    assert by_service["/rosapi/node_details"]["publishing"] == ["/robot_0/odometry"]
    assert by_service["/rosapi/service_type"] == {"type": "rosapi/Nodes"}
    assert len(frames) - len(answers) == 3


async def test_a_topic_that_appears_during_a_query_is_in_the_next_one() -> None:
    async with daemon() as host, client(host, level="none") as player:
        await player.send(op="subscribe", topic="/robot_0/odometry", compression="cbor-raw")
        assert set(await read_graph(player)) == {"/diagnostics", "/rosout"}
        async with fake_device(host.tcp, robot_topics()) as device:
            assert (await read_graph(player))["/robot_0/odometry"][0] == "geometry_msgs/Pose2D"
            await device.send(pose(7.0))
            assert (await player.receive_binary())["topic"] == "/robot_0/odometry"
