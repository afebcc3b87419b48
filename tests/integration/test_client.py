"""hostlink.client against a daemon: what it does for a script, and its errors."""

import asyncio
import contextlib
import struct
import time
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest
from aiohttp import web

from hostlink.client import connect
from hostlink.client.connection import waits
from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import Config
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.control import Log
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.errors import CommandRefused, HostlinkError
from tests.support.daemon import daemon
from tests.support.device_codec import encode_log
from tests.support.fake_device import fake_device, pose, robot_topics, service_server, topic
from tests.support.tcp_server import http_server
from tests.support.waiting import TIMEOUT_S, expect

ZERO = (0.0, 0.0)
LED = topic(EndpointKind.SUBSCRIBER, 100, "/led", "std_msgs/Bool")
TRIGGER = service_server("/trigger", "std_srvs/Trigger", 125, 101)


@contextlib.asynccontextmanager
async def serving(answer: Callable[[web.Request], Awaitable[web.StreamResponse]]) -> AsyncIterator[str]:
    """Run an HTTP server that is not hostlink."""
    app = web.Application()
    app.router.add_get("/{path:.*}", answer)
    async with http_server(app, shutdown_timeout_s=0.1) as url:
        yield url


# -- driving ----------------------------------------------------------------------------------------------------------


async def test_a_robot_is_driven_until_the_block_is_left() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        async with connect(host.url) as me:
            robot = me.robot("robot_0")
            async with asyncio.timeout(TIMEOUT_S):
                while not robot.is_driven:
                    with contextlib.suppress(CommandRefused):  # a busy machine has sent it late
                        await robot.drive(0.2, 0.5)
            assert await device.velocity_other_than(ZERO) == (0.2, 0.5)
            assert (await robot.state())["name"] == "robot_0"
        assert await device.velocity_other_than((0.2, 0.5)) == ZERO
        assert host.hub.robots.find("robot_0").gate.owner_name is None


# -- reading ----------------------------------------------------------------------------------------------------------


async def test_odometry_gives_each_new_pose_once() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, connect(host.url) as me:
        observed: list[float] = []
        async with asyncio.timeout(TIMEOUT_S):
            async with asyncio.TaskGroup() as tasks:

                async def send_poses() -> None:
                    await expect(lambda: len(host.hub.robots.find("robot_0").followers) == 2)
                    for number in range(1, 6):
                        await device.send(pose(float(number)))
                        await expect(lambda number=number: len(observed) == number)

                sending = tasks.create_task(send_poses())
                async for odometry in me.robot("robot_0").odometry():
                    observed.append(odometry["pose"]["x_m"])
                    if len(observed) == 5:
                        break
                await sending
    assert observed == [1.0, 2.0, 3.0, 4.0, 5.0]


async def test_odometry_of_an_unknown_robot_is_an_error() -> None:
    async with daemon() as host, connect(host.url) as me:
        with pytest.raises(HostlinkError, match="no robot named nobody"):
            await anext(aiter(me.robot("nobody").odometry()))


async def test_watch_gives_what_the_daemon_shows_as_it_changes() -> None:
    async with daemon() as host, connect(host.url) as me:
        observed: dict[str, object] = {}
        async with asyncio.timeout(TIMEOUT_S), contextlib.aclosing(me.watch()) as events:
            async for event in events:
                observed[event.name] = event.data
                if len(observed) == 3:
                    break
            assert observed.keys() == {"robots", "links", "clients"}
            async with fake_device(host.tcp, robot_topics()) as device:
                async for event in events:
                    if event.name == "robots" and event.data["robots"]:
                        assert event.data["robots"][0]["name"] == "robot_0"
                        break
                await device.send(encode(Id.LOG, encode_log(Log(2, "warm"))))
                async for event in events:
                    if event.name == "log":
                        assert event.data["msg"] == "warm"
                        break
        await expect(lambda: host.hub.topics.find("/rosout").subscribers == ())


async def test_watch_that_is_refused_raises_the_reason() -> None:
    async with daemon(Config().with_tables(api=ApiConfig(max_clients=1))) as host, connect(host.url) as me:
        with pytest.raises(HostlinkError, match="1 clients are connected"):
            await anext(aiter(me.watch()))


# -- topics and services ----------------------------------------------------------------------------------------------


async def test_publish_subscribe_and_advertise() -> None:
    async with (
        daemon() as host,
        connect(host.url) as other,
        connect(host.url) as me,
        me.subscribe("/chat", type_name="std_msgs/String") as messages,
    ):
        await me.settle()
        async with other.advertise("/chat", "std_msgs/String"):
            await other.settle()
            assert next(each for each in await me.topics() if each["name"] == "/chat")["publishers"] == 1
            await other.publish("/chat", {"data": "hello"})
            assert await anext(messages) == {"data": "hello"}
        await other.settle()
        assert next(each for each in await me.topics() if each["name"] == "/chat")["publishers"] == 0


async def test_subscribed_bytes_have_their_time() -> None:
    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics()) as device,
        connect(host.url) as me,
        me.subscribe_raw("/robot_0/odometry") as messages,
    ):
        await me.settle()
        before_ns = time.time_ns()
        await device.send(pose(1.0, 2.0, 0.5))
        message = await anext(aiter(messages))
    assert message.payload == struct.pack("<3d", 1.0, 2.0, 0.5)
    assert before_ns <= message.stamp_ns <= time.time_ns()


async def test_two_subscriptions_of_one_topic_live_apart() -> None:
    async with daemon() as host, connect(host.url) as me:
        async with me.subscribe("/chat", type_name="std_msgs/String") as first:
            async with me.subscribe("/chat") as second:
                await me.publish("/chat", {"data": "1"})
                assert (await anext(first), await anext(second)) == ({"data": "1"}, {"data": "1"})
            await me.publish("/chat", {"data": "2"})
            assert await anext(first) == {"data": "2"}
        await me.settle()
        assert host.hub.topics.find_or_none("/chat") is None


async def test_a_reader_that_is_too_slow_loses_the_oldest_and_can_count_them() -> None:
    async with (
        daemon() as host,
        connect(host.url) as me,
        me.subscribe("/count", type_name="std_msgs/Int32") as messages,
    ):
        for number in range(300):
            await me.publish("/count", {"data": number})
        await me.settle()
        assert messages.dropped == 44
        assert await anext(messages) == {"data": 44}


async def test_refusals_reach_their_sender() -> None:
    async with daemon() as host, fake_device(host.tcp, [LED]), connect(host.url) as me:
        await me.publish("/led", {"dta": True})
        with pytest.raises(HostlinkError, match="dta"):
            await me.settle()
        await me.settle()
        await me.publish("/led", {"dta": True})
        await me.call("/rosapi/get_time")
        with pytest.raises(HostlinkError, match="dta"):
            await me.publish("/led", {"data": True})
        async with me.subscribe("/led", type_name="std_msgs/Int32") as messages:
            with pytest.raises(HostlinkError, match="/led: wanted std_msgs/Bool, got std_msgs/Int32"):
                await anext(messages)


async def test_call() -> None:
    async with daemon() as host, fake_device(host.tcp, TRIGGER) as device, connect(host.url) as me:
        async with asyncio.TaskGroup() as tasks:
            calling = tasks.create_task(me.call("/trigger", {}))
            await device.frame(101)
            await device.send(encode(125, b"\x01" + struct.pack("<I", 2) + b"ok"))
        assert calling.result() == {"success": True, "message": "ok"}
        with pytest.raises(HostlinkError, match="no service named /nope"):
            await me.call("/nope", {})


async def test_exception_in_the_block_is_raised_unchanged() -> None:
    async with daemon() as host:
        with pytest.raises(ZeroDivisionError):
            async with connect(host.url):
                raise ZeroDivisionError
        with pytest.raises(ExceptionGroup) as caught:
            async with connect(host.url):
                raise ExceptionGroup("mine", [ZeroDivisionError()])
        assert caught.value.message == "mine"


# -- getting in -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("change", ["{}", "{}/", "ws{1}", "{2}"])
async def test_addresses_may_be_written_in_many_ways(change: str) -> None:
    async with daemon() as host:
        url = change.format(host.url, host.url.removeprefix("http"), host.url.removeprefix("http://"))
        async with connect(url) as me:
            assert (me.url, await me.robots()) == (host.url, [])


async def test_every_request_carries_the_token() -> None:
    observed: list[tuple[str, str]] = []

    async def answer(request: web.Request) -> web.StreamResponse:
        observed.append((request.path, request.headers.get("Authorization", "")))
        if request.path == "/":
            socket = web.WebSocketResponse()
            await socket.prepare(request)
            async for _ in socket:
                pass
            return socket
        return web.json_response({"robots": []})

    async with serving(answer) as url:
        async with connect(url, token="secret") as me:
            await me.robots()
        async with connect(f"{url}/?token=other"):
            pass
    # On a machine that pauses the client connects again, with the same token.
    secret = [each for each in observed if each[1] == "Bearer secret"]
    assert set(secret) == {("/", "Bearer secret"), ("/api/robots", "Bearer secret")}
    assert observed[len(secret) :] == [("/", "Bearer other")] * (len(observed) - len(secret)) != []


async def test_a_daemon_of_another_version_drives_nothing_that_the_program_does_not_know_of() -> None:
    """The daemon's answer lacks a field that this client needs: `drive` raises, and the client repeats nothing."""

    async def answer(request: web.Request) -> web.StreamResponse:
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        async for message in socket:
            asked = message.json()
            if asked["op"] == "drive":
                await socket.send_json({"op": "drive_result", "id": asked["id"], "result": True, "link": 1})
        return socket

    async with serving(answer) as url, connect(url) as me:
        robot = me.robot("robot_0")
        with pytest.raises(HostlinkError, match=r"is of another version than this one: its answer has no 'velocity'"):
            await robot.drive(0.2, 0.0)
        assert not robot.is_driven


@pytest.mark.parametrize(
    ("status", "advice"),
    [
        (401, "hostlink at {} refuses: it wants a token that it knows: connect(url, token=...)"),
        (403, "hostlink at {} refuses: this token, or this place, may not do that"),
        (404, "no hostlink at {}: what answers there (HTTP 404) is no hostlink"),
        (200, "no hostlink at {}: what answers there (HTTP 200) is no hostlink"),
    ],
)
async def test_a_refused_connection_raises_with_advice(status: int, advice: str) -> None:
    async def answer(_: web.Request) -> web.StreamResponse:
        return web.Response(status=status)

    async with serving(answer) as url:
        with pytest.raises(HostlinkError) as caught:
            async with connect(url):
                pass
        assert str(caught.value).startswith(advice.format(url))
        with pytest.raises(HostlinkError) as caught:
            async with connect(url, token="of yesterday"):
                pass
        of_token = f"hostlink at {url} refuses: it does not know this token"
        assert str(caught.value).startswith(of_token if status == 401 else advice.format(url))


async def test_a_token_with_the_end_of_a_line_is_told_so() -> None:
    with pytest.raises(HostlinkError, match="the token has a character that is not printable"):
        async with connect("http://127.0.0.1:1", token="secret\r"):
            pass


@pytest.mark.parametrize(
    ("url", "advice"),
    [
        (
            "http://127.0.0.1:1",
            "no hostlink at http://127.0.0.1:1: is `hostlink serve` running there? Nothing listens;",
        ),
        ("ftp://127.0.0.1", "url: 'ftp://127.0.0.1' is not an address of a hostlink: write it as http://HOST:9090"),
        ("9191", "url: '9191' is not an address of a hostlink: write it as http://127.0.0.1:9191"),
        (":9191", "url: ':9191' is not an address of a hostlink: write it as http://127.0.0.1:9191"),
        ("http://", "url: 'http://' is not an address of a hostlink"),
        ("127.0.0.1:909o", "url: '127.0.0.1:909o' is not an address of a hostlink"),
        ("http://[::1", "url: 'http://[::1' is not an address of a hostlink"),
        ("http://robot..local", "url: 'http://robot..local' is not an address of a hostlink"),
        ("127.0.0.77", "no hostlink at http://127.0.0.77:9090: "),
        ("http://127.0.0.1:1/", "no hostlink at http://127.0.0.1:1: "),
    ],
)
async def test_an_address_without_hostlink_raises_with_advice(url: str, advice: str) -> None:
    with pytest.raises(HostlinkError) as caught:
        async with connect(url):
            pass
    assert str(caught.value).startswith(advice)


async def test_connect_to_the_device_port_raises_with_advice() -> None:
    async with daemon() as host:
        with pytest.raises(HostlinkError, match="what answers there speaks no HTTP: devices have port 11411"):
            async with connect("http://{}:{}".format(*host.tcp)):
                pass


async def test_tls_where_there_is_none_raises_with_advice() -> None:
    async with daemon() as host:
        url = host.url.replace("http:", "https:")
        with pytest.raises(HostlinkError, match="it does not speak TLS there: begin the address with http://"):
            async with connect(url):
                pass


def test_reconnection_attempts_are_at_most_a_second_apart_and_spread() -> None:
    first = [wait_s for wait_s, _ in zip(waits(), range(50), strict=False)]
    second = [wait_s for wait_s, _ in zip(waits(), range(50), strict=False)]
    assert max(first) <= 1.0
    assert first[0] <= 0.05
    assert min(first[10:]) >= 0.5
    assert first != second
