"""Access to the API: tokens on every entry point, pages of other origins, TLS, and rate limits."""

import asyncio
import json
import ssl
import subprocess
from pathlib import Path

import aiohttp
import pytest

from hostlink.client import connect
from hostlink.components.gateway.settings import ApiConfig, TokenConfig
from hostlink.core.config import Config
from hostlink.errors import ConfigError, HostlinkError
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import fake_device, robot_topics
from tests.support.rosbridge import Client
from tests.support.waiting import TIMEOUT_S

DRIVE, READ = "a-token-of-a-driver", "a-token-of-a-watcher"
GUARDED = Config().with_tables(
    api=ApiConfig(
        tokens=(
            TokenConfig(name="phone", role="drive", token=DRIVE),
            TokenConfig(name="wall", role="read", token=READ),
        )
    )
)


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


async def status(host: Daemon, method: str, path: str, body: bytes | None = None, **headers: str) -> int:
    async with host.session.request(method, host.url + path, data=body, headers=headers) as response:
        await response.read()
        return response.status


async def test_roles_on_the_websocket() -> None:
    async with daemon(GUARDED) as host, fake_device(host.tcp, robot_topics()) as device:
        with pytest.raises(aiohttp.WSServerHandshakeError) as refusal:
            await host.session.ws_connect(host.url)
        assert refusal.value.status == 401
        async with host.session.ws_connect(f"{host.url}/?token={READ}") as socket:
            watcher = Client(socket)
            await watcher.send(op="set_level", level="error")
            for op in ("publish", "advertise", "advertise_service", "unadvertise", "service_response"):
                await watcher.send(op=op, topic="/robot_0/velocity_commands", type="geometry_msgs/Twist", msg={})
                wanted = f"{op}: the token may only read; use one with the role drive"
                assert (await watcher.receive())["msg"] == wanted
            await watcher.send(op="drive", id=7, robot="robot_0", linear=0.1, angular=0.0)
            answer = await watcher.receive()
            assert [answer[key] for key in ("op", "id", "result", "kind")] == ["drive_result", 7, False, "NoRole"]
            await watcher.send(op="call_service", service="/rosapi/set_param", args={"name": "a", "value": "1"})
            assert (await watcher.receive())["result"] is False
            assert "/robot_0/odometry" in (await watcher.call("/rosapi/topics"))["topics"]
            assert host.hub.robots.find("robot_0").gate.owner_name is None
        async with host.session.ws_connect(host.url, headers=bearer(DRIVE)) as socket:
            await Client(socket).send(op="publish", topic="/robot_0/velocity_commands", msg={"linear": {"x": 0.2}})
            assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
            assert [client["token"] for client in await views(host)] == ["phone"]


async def views(host: Daemon) -> list[dict[str, object]]:
    async with host.session.get(host.url + "/api/clients", headers=bearer(READ)) as response:
        found: list[dict[str, object]] = (await response.json())["clients"]
        return found


async def test_daemon_without_tokens_on_a_public_address_does_not_start() -> None:
    with pytest.raises(ConfigError, match=r"set \[\[api.tokens\]\], or listen on 127.0.0.1"):
        async with daemon(Config().with_tables(api=ApiConfig(host="0.0.0.0"))):
            pytest.fail("it started")


async def test_too_many_clients() -> None:
    async with daemon(Config().with_tables(api=ApiConfig(max_clients=2))) as host:
        async with host.session.ws_connect(host.url), host.session.get(host.url + "/api/events"):
            with pytest.raises(aiohttp.WSServerHandshakeError) as refusal:
                await host.session.ws_connect(host.url)
            assert refusal.value.status == 503
            assert await status(host, "GET", "/api/events") == 503
            assert (await host.get("/api/clients"))["refused"] == 2
        async with asyncio.timeout(TIMEOUT_S), host.session.ws_connect(host.url):
            pass


async def test_a_message_too_large_closes_its_client_only() -> None:
    config = Config().with_tables(api=ApiConfig(max_message_bytes=4096))
    async with daemon(config) as host, host.session.ws_connect(host.url) as good:
        async with host.session.ws_connect(host.url) as bad:
            await bad.send_str(json.dumps({"op": "publish", "topic": "/a", "msg": "x" * 5000}))
            assert (await bad.receive(timeout=5)).data == aiohttp.WSCloseCode.MESSAGE_TOO_BIG
        assert "topics" in await Client(good).call("/rosapi/topics")


async def test_tls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    certificate, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    names = ["-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1"]
    make = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "rsa:2048",
        "-nodes",
        "-days",
        "2",
        "-out",
        certificate,
        "-keyout",
        key,
    ]
    await asyncio.to_thread(subprocess.run, [*make, *names], check=True, capture_output=True)
    trust = ssl.create_default_context(cafile=certificate)
    async with daemon(Config().with_tables(api=ApiConfig(certificate=certificate, key=key))) as host:
        assert host.url.startswith("https://")
        async with host.session.get(host.url + "/healthz", ssl=trust) as response:
            assert response.status == 200
        async with connect(host.url, ssl=trust) as program:
            assert await program.robots() == []
        with pytest.raises(HostlinkError, match="certificate"):
            async with connect(host.url):
                pytest.fail("it trusted a certificate that nobody knows")
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate))  # in the place of the system's certificates
        async with connect(host.url) as program:
            assert await program.robots() == []


async def test_a_refusal_is_in_the_words_of_a_person_not_of_the_api() -> None:
    async with daemon(GUARDED) as host, fake_device(host.tcp, robot_topics()):
        async with connect(host.url, token=READ) as program:
            with pytest.raises(HostlinkError) as caught:
                await program.robot("robot_0").unlock()
            assert str(caught.value) == "the token wall may only read, not drive; ask whoever runs it"
            with pytest.raises(HostlinkError) as caught:
                await program.get("/api/of_another_version")
            assert str(caught.value).startswith(f"hostlink at {host.url} is of another version than this one")
        async with connect(host.url, token=DRIVE) as program:
            await program.robot("robot_0").lock("somebody stands there")
            with pytest.raises(HostlinkError) as caught:
                await program.robot("robot_0").drive(0.1, 0.0)
            assert str(caught.value).endswith("somebody stands there; to drive it again: hostlink unlock robot_0")
    async with daemon(GUARDED) as host, host.session.get(host.url + "/api/robots") as response:
        assert not (await response.json())["error"]["reason"].startswith("GET")
