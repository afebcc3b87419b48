"""The API server without a socket: heads, bodies, tokens, origins, WebSockets, the page and metrics."""

import asyncio
import json
import os
import struct
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from hostlink.components.gateway.server import url_of
from hostlink.components.gateway.settings import ApiConfig, TokenConfig
from hostlink.core.config import Config
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.transport.base import READ_BYTES
from tests.support.api_memory import Answer, ApiMemory, api_memory
from tests.support.participants import VELOCITY_ID
from tests.support.virtual_loop import run_virtual

VELOCITY = "/api/robots/robot_0/velocity"
LOCK = "/api/robots/robot_0/lock?wait_s=0"
FAST = json.dumps({"linear": 0.2, "angular": 0.5}).encode()
TOKENS = (
    TokenConfig(name="phone", token="a-token-that-drives", role="drive"),
    TokenConfig(name="wall", token="a-token-that-reads", role="read"),
)

Test = Callable[[ApiMemory], Awaitable[None]]


@pytest.fixture
def check(tmp_path: Path) -> Callable[..., None]:
    """Run a test with an API server in virtual time."""

    def run(test: Test, config: Config | None = None) -> None:
        async def run_test() -> None:
            async with api_memory(tmp_path, config) as api:
                await test(api)

        run_virtual(run_test())

    return run


def speeds(api: ApiMemory) -> list[tuple[float, float]]:
    """Return the velocities that the device received: forward and turn."""
    found = [struct.unpack("<6d", payload) for payload in api.device.payloads(VELOCITY_ID)]
    return [(each[0], each[5]) for each in found]


def test_request_without_origin_is_answered_without_cors_headers(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        answer = await api.request("GET", "/api/robots")
        assert (answer.status, json.loads(answer.body)["robots"][0]["name"]) == (200, "robot_0")
        assert not any(name.startswith("Access-Control") for name in answer.headers)

    check(test)


def test_listed_origin_is_answered_with_cors_headers(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        answer = await api.request("GET", "/api/robots", Origin="http://lab")
        assert (answer.status, answer.headers["Access-Control-Allow-Origin"]) == (200, "http://lab")
        assert answer.headers["Vary"] == "Origin"
        preflight = await api.request("OPTIONS", VELOCITY, Origin="http://lab")
        assert (preflight.status, preflight.body) == (204, b"")
        assert "PUT" in preflight.headers["Access-Control-Allow-Methods"]
        assert (await api.request("GET", "/api/robots", Origin="http://evil")).status == 403

    check(test, Config().with_tables(api=ApiConfig(origins=("http://lab",))))


def test_body_in_two_pieces_drives_the_robot(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        peer = api.connect()
        peer.send_head("PUT", VELOCITY, {"Host": "localhost", "Content-Length": str(len(FAST))})
        peer.send(FAST[:10])
        await asyncio.sleep(0.1)
        assert set(speeds(api)) == {(0.0, 0.0)}
        peer.send(FAST[10:])
        assert (await api.answer(peer)).status == 200
        assert speeds(api)[-1] == (0.2, 0.5)

    check(test)


def test_body_that_does_not_arrive_is_answered_408(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        peer = api.connect()
        peer.send_head("PUT", VELOCITY, {"Host": "localhost", "Content-Length": str(len(FAST))})
        assert (await api.answer(peer, timeout_s=3.0)).status == 408

    check(test, Config().with_tables(api=ApiConfig(request_timeout_s=2.0)))


def test_body_over_the_bound_of_its_route_is_answered_413(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        assert (await api.request("PUT", VELOCITY, bytes(2000))).status == 413
        chunked = api.connect()
        chunked.send_head("PUT", VELOCITY, {"Host": "localhost", "Transfer-Encoding": "chunked"})
        chunked.send(b"400\r\n" + bytes(0x400) + b"\r\n" + b"400\r\n" + bytes(0x400) + b"\r\n")
        assert (await api.answer(chunked)).status == 413

    check(test)


def test_large_bodies_share_a_budget_and_a_velocity_needs_none(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        share = api.hub.budget["bodies"]
        share.add(share.max_bytes)
        refused = await api.request("POST", "/api/recordings", b'{"robots": ["none"]}')
        assert (refused.status, refused.headers["Retry-After"]) == (503, "1")
        assert (await api.request("PUT", VELOCITY, FAST)).status == 200
        share.give(share.max_bytes)
        assert (await api.request("POST", "/api/recordings", b'{"robots": ["none"]}')).status == 404
        assert share.held_bytes == 0

    check(test)


def test_large_body_that_is_cut_off_gives_its_room_back(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        peer = api.connect()
        peer.send_head("POST", "/api/recordings", {"Host": "localhost", "Transfer-Encoding": "chunked"})
        await asyncio.sleep(0.05)
        assert api.hub.budget["bodies"].held_bytes > 0
        peer.transport.close()
        await asyncio.sleep(0.05)
        assert api.hub.budget["bodies"].held_bytes == 0

    check(test)


def test_openapi_document_has_every_path_and_needs_no_token(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        document = json.loads((await api.request("GET", "/api/openapi.json")).body)
        assert document["openapi"] == "3.1.0"
        paths = document["paths"]
        assert "description" in document["components"]["schemas"]["ErrorView"]
        velocity = paths["/api/robots/{name}/velocity"]["put"]
        assert velocity["operationId"] == "put_api_robots_name_velocity"
        assert velocity["parameters"] == [
            {"name": "name", "in": "path", "required": True, "schema": {"type": "string"}}
        ]
        assert velocity["requestBody"]["required"]
        assert {"401", "403", "429"} <= velocity["responses"].keys()
        assert velocity["responses"]["200"]["content"].keys() == {"application/json"}
        assert "security" not in velocity
        assert not paths["/api/recordings"]["post"]["requestBody"]["required"]
        health = paths["/healthz"]["get"]
        assert (health["security"], "401" in health["responses"], "parameters" in health) == ([{}], False, False)
        assert paths["/api/events"]["get"]["responses"]["200"]["content"] == {
            "text/event-stream": {"schema": {"type": "string"}}
        }

    check(test)


def test_revoked_token_ends_its_web_socket_and_stops_what_it_drives(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        peer = await api.web_socket("/?token=a-token-that-drives")
        reader = await api.web_socket("/?token=a-token-that-reads")
        await api.request("PUT", VELOCITY, FAST, Authorization="Bearer a-token-that-drives")
        peer.send_text(op="drive", id="1", robot="robot_0", linear=0.2, angular=0.0, take_over=True)
        await asyncio.sleep(0.05)
        assert speeds(api)[-1] == (0.2, 0.0)
        api.server._prepare_access(Config().with_tables(api=ApiConfig(tokens=TOKENS[1:])))()
        assert len(api.server._owners) == 0  # of REST
        await asyncio.sleep(0.05)
        assert speeds(api)[-1] == (0.0, 0.0)
        assert (peer.transport.is_closed, reader.transport.is_closed) == (True, False)
        assert (await api.request("GET", "/api/robots?token=a-token-that-drives")).status == 401

    check(test, Config().with_tables(api=ApiConfig(tokens=TOKENS)))


def test_odometry_events_begin_with_the_known_pose_and_continue_with_each_new_one(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        await api.move_to(1.0, 2.0, 0.5)
        peer = api.connect()
        peer.send_head("GET", "/api/robots/robot_0/odometry/events", {"Host": "localhost"})
        await asyncio.sleep(0.05)
        await api.move_to(1.5, 2.0, 0.5)
        await asyncio.sleep(1.0)
        answer = Answer(bytes(peer.transport.written))
        assert (answer.status, answer.headers["Content-Type"]) == (200, "text/event-stream")
        assert answer.headers["Hostlink-Role"] == "drive"
        poses = [json.loads(line[6:]) for line in answer.body.splitlines() if line.startswith(b"data: ")]
        assert [each["pose"]["x_m"] for each in poses] == [1.0, 1.5]
        assert [each["count"] for each in poses] == [1, 2]
        assert answer.body.count(b": alive") == 3
        (client,) = json.loads((await api.request("GET", "/api/clients")).body)["clients"]
        assert client["kind"] == "events"
        peer.transport.close()
        await asyncio.sleep(1.0)
        assert json.loads((await api.request("GET", "/api/clients")).body)["clients"] == []

    check(test)


def test_velocity_whose_body_arrived_a_lease_after_its_head_is_refused_and_a_zero_is_not(
    check: Callable[..., None],
) -> None:
    async def test(api: ApiMemory) -> None:
        for body, status in ((FAST, 409), (b'{"linear": 0, "angular": 0}', 200)):
            peer = api.connect()
            peer.send_head("PUT", VELOCITY, {"Host": "localhost", "Content-Length": str(len(body))})
            await asyncio.sleep(LEASE_S + 0.1)
            peer.send(body)
            assert (await api.answer(peer)).status == status
        assert set(speeds(api)) == {(0.0, 0.0)}

    check(test)


def test_stop_does_not_wait_for_its_body(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        await api.request("PUT", VELOCITY, FAST)
        peer = api.connect()
        peer.send_head("POST", "/api/stop", {"Host": "localhost", "Content-Length": "10"})
        await asyncio.sleep(0.05)
        assert speeds(api)[-1] == (0.0, 0.0)

    check(test)


def test_lock_waits_for_no_body_and_has_its_reason_when_the_body_arrives(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        gate, body = api.hub.robots.find_here("robot_0").gate, b'{"reason": "a hand"}'
        await api.request("PUT", VELOCITY, FAST)
        peer = api.connect()
        peer.send_head("POST", LOCK, {"Host": "localhost", "Content-Length": str(len(body))})
        peer.send(body[:10])
        await asyncio.sleep(0.05)
        assert gate.lock_reason == "emergency stop"
        assert speeds(api)[-1] == (0.0, 0.0)
        peer.send(body[10:])
        assert (await api.answer(peer)).status == 200
        assert gate.lock_reason == "a hand"

    check(test)


@pytest.mark.parametrize(("announced_bytes", "status"), [(20, 0), (10**9, 413)], ids=["cut off", "too large"])
def test_lock_without_its_body_holds(check: Callable[..., None], announced_bytes: int, status: int) -> None:
    async def test(api: ApiMemory) -> None:
        peer = api.connect()
        peer.send_head("POST", LOCK, {"Host": "localhost", "Content-Length": str(announced_bytes)})
        await asyncio.sleep(0.05)
        peer.transport.abort()
        assert Answer(bytes(peer.transport.written)).status == status
        assert (await api.request("PUT", VELOCITY, FAST)).status == 409
        assert api.hub.robots.find_here("robot_0").gate.lock_reason == "emergency stop"

    check(test)


def test_head_that_is_not_text_is_answered_400(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        peer = api.connect()
        peer.send(b"GET /api/robots HTTP/1.1\r\nHost: localhost\r\nOrigin: http://\xff\r\n\r\n")
        assert (await api.answer(peer)).status == 400

    check(test)


def test_tokens_decide_what_a_request_may_do(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        assert (await api.request("GET", "/api/robots")).status == 401
        assert (await api.request("GET", "/api/robots?token=a-token-that-reads")).status == 200
        assert (await api.request("PUT", VELOCITY, FAST, Authorization="Bearer a-token-that-reads")).status == 403
        assert (await api.request("PUT", VELOCITY, FAST, Authorization="Bearer a-token-that-drives")).status == 200
        assert (await api.request("GET", "/healthz")).status == 200
        assert (await api.request("GET", "/")).status == 200

    check(test, Config().with_tables(api=ApiConfig(tokens=TOKENS)))


def test_requests_over_the_rate_are_answered_429_and_a_stop_is_not(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        statuses = [(await api.request("GET", "/healthz")).status for _ in range(4)]
        assert statuses == [200, 200, 429, 429]
        assert (await api.request("POST", "/api/stop")).status == 200

    check(test, Config().with_tables(api=ApiConfig(max_requests_s=2.0)))


def test_page_is_served_with_its_policy_and_unknown_files_are_not(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        page = await api.request("GET", "/")
        assert (page.status, page.headers["Content-Type"]) == (200, "text/html")
        assert page.headers["Content-Security-Policy"].startswith("default-src 'none'")
        assert (await api.request("GET", "/web/icon.svg")).headers["Content-Type"] == "image/svg+xml"
        assert (await api.request("GET", "/web/..%2Findex.html")).status == 404

    check(test)


def test_web_socket_drives_the_robot_and_is_answered(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        peer = await api.web_socket()
        peer.send_text(op="drive", id="1", robot="robot_0", linear=0.1, angular=0.0)
        peer.send_text(op="drive", id="2", robot="robot_0", linear=0.2, angular=0.5)
        await asyncio.sleep(0.05)
        assert speeds(api)[-1] == (0.2, 0.5)
        assert [(each["op"], each["id"], each["result"]) for each in peer.texts()] == [
            ("drive_result", "1", True),
            ("drive_result", "2", True),
        ]
        peer.transport.close()
        await asyncio.sleep(0.05)
        assert speeds(api)[-1] == (0.0, 0.0)

    check(test)


def test_web_socket_receives_the_messages_of_one_turn_in_one_write(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        peer = await api.web_socket()
        peer.send_text(op="subscribe", topic="/robot_0/odometry")
        await asyncio.sleep(0.05)
        await api.move_to(1.0, 2.0, 0.5)
        (message,) = peer.texts()
        assert message["msg"] == {"x": 1.0, "y": 2.0, "theta": 0.5}

    check(test)


def test_web_socket_with_an_unknown_subprotocol_is_refused(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        peer = api.connect()
        headers = {"Host": "localhost", "Upgrade": "websocket", "Connection": "Upgrade"}
        peer.send_head("GET", "/", headers | {"Sec-WebSocket-Protocol": "odd.v1"})
        assert (await api.answer(peer)).status == 400

    check(test)


@pytest.mark.parametrize(
    ("changed", "wrong"),
    [
        ({"Connection": "close"}, "No CONNECTION upgrade hdr: close"),
        ({"Sec-WebSocket-Version": "12"}, "Unsupported version: 12"),
        ({"Sec-WebSocket-Key": "short"}, "Handshake error: 'short'"),
    ],
)
def test_failed_handshake_says_what_is_wrong_and_what_to_do(
    check: Callable[..., None], changed: dict[str, str], wrong: str
) -> None:
    async def test(api: ApiMemory) -> None:
        peer = api.connect()
        headers = {"Host": "localhost", "Upgrade": "websocket", "Connection": "Upgrade"}
        valid = {"Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": "MDEyMzQ1Njc4OWFiY2RlZg=="}
        peer.send_head("GET", "/", headers | valid | changed)
        answer = await api.answer(peer)
        assert (answer.status, json.loads(answer.body)["error"]["reason"]) == (
            400,
            f"the WebSocket handshake is invalid: {wrong}; use a client for WebSockets, and let a proxy pass the "
            "headers Upgrade and Connection",
        )

    check(test)


def test_metrics_have_robots_links_and_graphs(check: Callable[..., None]) -> None:
    async def test(api: ApiMemory) -> None:
        api.hub.counts.components["ros1"] = lambda: {"opened": 3}
        await api.move_to(1.0, 2.0, 0.5)
        await api.request("PUT", VELOCITY, FAST)
        lines = (await api.request("GET", "/metrics")).body.decode().splitlines()
        assert 'hostlink_robot_connected{robot="robot_0"} 1.0' in lines
        assert 'hostlink_robot_poses_total{robot="robot_0"} 1.0' in lines
        assert 'hostlink_robot_driven{robot="robot_0"} 1.0' in lines
        assert 'hostlink_graph_events_total{graph="ros1",what="opened"} 3.0' in lines
        assert "hostlink_links 1.0" in lines
        assert any(line.startswith("hostlink_link_frames_from_device_total{") for line in lines)
        assert any(line.startswith("hostlink_link_answer_seconds{") for line in lines)

    check(test)


def test_metrics_have_the_motion_and_the_lock_of_a_robot(check: Callable[..., None]) -> None:
    async def metrics(api: ApiMemory) -> dict[str, float]:
        lines = (await api.request("GET", "/metrics")).body.decode().splitlines()
        found = (
            line.removeprefix("hostlink_robot_").rsplit(" ", 1) for line in lines if "hostlink_robot_" in line[:15]
        )
        return {name: float(value) for name, value in found}

    async def test(api: ApiMemory) -> None:
        for number in range(3):
            await api.move_to(0.1 * number, 0.0, 0.0)  # within 0.05 s
        await api.request("PUT", VELOCITY, b'{"linear": 0.3, "linear_y_m_s": 0.1, "angular": -0.5}')
        found = await metrics(api)
        assert (found['driven{robot="robot_0"}'], found['locked{robot="robot_0"}']) == (1, 0)
        assert found['speed{axis="linear",robot="robot_0"}'] == pytest.approx(2.0)
        commanded = {"linear": 0.3, "linear_y": 0.1, "angular": -0.5}
        for axis, speed in commanded.items():
            assert found[f'commanded_speed{{axis="{axis}",robot="robot_0"}}'] == speed
        await api.request("POST", "/api/robots/robot_0/lock?wait_s=0")
        found = await metrics(api)
        assert (found['driven{robot="robot_0"}'], found['locked{robot="robot_0"}']) == (0, 1)

    check(test)


def test_recordings_are_listed_newest_first(check: Callable[..., None], tmp_path: Path) -> None:
    async def test(api: ApiMemory) -> None:
        for age_s, name in enumerate(("third", "second", "first")):
            (tmp_path / f"{name}.mcap").touch()
            os.utime(tmp_path / f"{name}.mcap", (1000 - age_s, 1000 - age_s))
        body = json.loads((await api.request("GET", "/api/recordings")).body)
        assert [each["file"] for each in body["files"]] == ["third.mcap", "second.mcap", "first.mcap"]
        assert body["recordings"] == []

    check(test)


@pytest.mark.parametrize(
    ("host", "has_tls", "url"),
    [
        ("127.0.0.1", False, "http://127.0.0.1:9090"),
        ("127.0.0.1", True, "https://127.0.0.1:9090"),
        ("::1", False, "http://[::1]:9090"),
    ],
)
def test_url_has_scheme_and_bracketed_address(host: str, has_tls: bool, url: str) -> None:
    assert url_of(host, 9090, has_tls=has_tls) == url


def test_request_held_back_on_a_closing_connection_logs_no_error(check: Callable[..., None]) -> None:
    """The handler is called before aiohttp is told that the connection is lost."""

    async def test(api: ApiMemory) -> None:
        errors: list[object] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: errors.append(context))
        peer = api.connect()
        await asyncio.sleep(0.05)
        peer.send(b"GET /api/robots HTTP/1.1\r\nHost: localhost\r\n\r\n" * (READ_BYTES // 40))
        assert peer.transport.is_paused  # the bytes are held back
        peer.transport.abort()
        await asyncio.sleep(0.05)
        assert errors == []

    check(test)
