"""LocalNode: calls of other nodes with their retries and bounds, its tasks, and the address that the master has."""

import asyncio
import socket
import threading
import time
from typing import Any

import aiohttp
import pytest
from structlog.testing import capture_logs

from hostlink.components.ros1.local_node import THREAD_BYTES, Rpc
from hostlink.components.ros1.xml_rpc import CallRefused, Unreachable, decode_call, encode_answer, reason_of
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from tests.support.fake_device import CATALOG
from tests.support.participants import Scene, play
from tests.support.ros1.wireless import local_node
from tests.support.virtual_loop import inside


class AnsweredRpc(Rpc):
    """Rpc whose posts are answered by the test: bodies, or errors."""

    def __init__(self, *answers: bytes | Exception) -> None:
        super().__init__()
        self.posts: list[tuple[str, bytes]] = []
        self._answers = list(answers)

    async def _post(self, uri: str, body: bytes) -> bytes:
        self.posts.append((uri, body))
        answer = self._answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


async def test_rpc_call_returns_the_value_of_the_answer() -> None:
    rpc = AnsweredRpc(encode_answer(1, "", ["TCPROS", "here", 7]))
    assert await rpc.call("http://there/", "requestTopic", "/a", "/b") == ["TCPROS", "here", 7]
    ((uri, body),) = rpc.posts
    assert (uri, decode_call(body)) == ("http://there/", ("requestTopic", ("/a", "/b")))


async def test_rpc_call_is_repeated_once_after_a_closed_connection() -> None:
    lost = aiohttp.ServerDisconnectedError()
    rpc = AnsweredRpc(lost, encode_answer(1, "", 7))
    assert (await rpc.call("http://there/", "getPid"), len(rpc.posts)) == (7, 2)
    rpc = AnsweredRpc(lost, lost)
    with pytest.raises(Unreachable):
        await rpc.call("http://there/", "getPid")
    assert len(rpc.posts) == 2


@pytest.mark.parametrize("error", [TimeoutError(), aiohttp.ClientError("odd"), ValueError("odd"), OSError("odd")])
async def test_rpc_call_without_an_answer_is_unreachable(error: Exception) -> None:
    with pytest.raises(Unreachable, match=r"odd|no answer within 3 s"):
        await AnsweredRpc(error).call("http://there/", "getPid")


async def test_closed_rpc_opens_no_connection() -> None:
    rpc = Rpc()
    await rpc.aclose()
    with pytest.raises(Unreachable, match="the node has ended"):
        await rpc.call("http://there/", "getPid")
    assert rpc._session is None


async def test_small_body_is_parsed_at_once() -> None:
    assert await Rpc().parse(lambda _: threading.get_ident(), bytes(THREAD_BYTES)) == threading.get_ident()


async def test_large_bodies_are_parsed_beside_the_loop_one_at_a_time() -> None:
    running, most, threads = 0, 0, set()

    def decode(body: bytes) -> int:
        nonlocal running, most
        running += 1
        most = max(most, running)
        threads.add(threading.get_ident())
        time.sleep(0.01)
        running -= 1
        return len(body)

    parser = Rpc()
    async with asyncio.TaskGroup() as tasks:
        parsing = [tasks.create_task(parser.parse(decode, bytes(THREAD_BYTES + size))) for size in range(1, 6)]
    assert [each.result() for each in parsing] == [THREAD_BYTES + size for size in range(1, 6)]
    assert threading.get_ident() not in threads
    assert most == 1


async def test_error_of_the_decoder_is_raised() -> None:
    def decode(_: bytes) -> None:
        raise ValueError("none")

    with pytest.raises(ValueError, match="none"):
        await Rpc().parse(decode, bytes(2 * THREAD_BYTES))


NO_KEY: Any = None  # of a connection


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (aiohttp.ClientConnectorError(NO_KEY, ConnectionRefusedError(111, "x")), "Connection refused"),
        (aiohttp.ClientConnectorError(NO_KEY, socket.gaierror(-2, "Name not known")), "Name not known"),
        (TimeoutError(), "no answer within 3 s"),
        (OSError("odd"), "odd"),
    ],
)
def test_reason_of_a_failed_call_is_for_people(error: Exception, reason: str) -> None:
    assert reason_of(error) == reason


@inside(play)
async def test_master_is_called_with_the_name_of_the_node(scene: Scene) -> None:
    node, rpc = local_node(scene.hub, scene.tasks)
    rpc.answer = lambda _uri, _method: "http://here:1/"
    assert await node.find_own_uri() == "http://here:1/"
    assert rpc.calls == [(node.master_uri, "lookupNode", ("/hostlink", "/hostlink"))]


@inside(play)
async def test_master_without_an_address_of_the_node_is_none_and_an_odd_one_is_unreachable(scene: Scene) -> None:
    node, rpc = local_node(scene.hub, scene.tasks)

    def refuse(_uri: str, _method: str) -> Any:
        raise CallRefused("unknown node")

    rpc.answer = refuse
    assert await node.find_own_uri() is None
    rpc.answer = lambda _uri, _method: 7
    with pytest.raises(Unreachable):
        await node.find_own_uri()


async def test_crash_of_a_task_ends_nothing_else_and_the_end_cancels_the_others() -> None:
    ended: list[str] = []

    async def wait() -> None:
        try:
            await asyncio.sleep(1e6)
        finally:
            ended.append("cancelled")

    async def crash() -> None:
        raise ZeroDivisionError

    hub = Hub(Config(), CATALOG, reraises=False)
    with capture_logs() as logs:
        async with asyncio.TaskGroup() as tasks:
            node, _ = local_node(hub, tasks)
            waiting, crashing = node.spawn(wait(), name="wait"), node.spawn(crash(), name="crash")
            await asyncio.wait([crashing])
            assert (waiting.done(), ended) == (False, [])
            await node.aclose()
    assert (waiting.cancelled(), ended) == (True, ["cancelled"])
    assert any(each["event"].endswith(".crashed") for each in logs)
