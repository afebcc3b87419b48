"""Gateway and recorder as components: their switches, their failures, and what the other one does meanwhile."""

import asyncio
import contextlib
import sys
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import aiohttp
import pytest

from hostlink.cli.serve import running
from hostlink.components.gateway import running as gateway
from hostlink.components.gateway.server import serve_api
from hostlink.components.gateway.settings import ApiAddress, ApiConfig, GatewaySettings, TokenConfig
from hostlink.components.recorder.recordings import Recordings
from hostlink.components.recorder.settings import BlackBoxConfig, RecordingConfig
from hostlink.core.config import Config, LinkConfig, TcpConfig
from hostlink.core.host import Host
from hostlink.core.hub.hub import Hub
from hostlink.core.robot.events import OWNER_LEFT
from hostlink.core.running import serving
from hostlink.errors import ConfigError
from tests.support.daemon import Daemon, daemon, stops_of
from tests.support.fake_device import fake_device, robot_topics
from tests.support.process import free_port
from tests.support.rosbridge import client
from tests.support.waiting import expect

ZERO, CURVE = (0.0, 0.0), (0.2, 0.5)
ALICE, BOB = (TokenConfig(name=name, role="drive", token=f"the-token-of-{name}-1") for name in ("alice", "bob"))


class Fault:
    """A fault that ends a run of a component when a test wants it."""

    def __init__(self) -> None:
        self.runs = 0
        self._wanted = asyncio.Event()

    def happen(self) -> None:
        self._wanted.set()
        self._wanted = asyncio.Event()

    async def raise_when_wanted(self) -> None:
        self.runs += 1
        await self._wanted.wait()
        raise ValueError("a fault of the test")


@pytest.fixture
def gateway_fault(monkeypatch: pytest.MonkeyPatch) -> Fault:
    fault = Fault()

    @contextlib.asynccontextmanager
    async def served(host: Host, settings: GatewaySettings) -> AsyncIterator[str]:
        async with serve_api(host, settings) as url:
            host.spawn(fault.raise_when_wanted(), name="fault")
            yield url

    monkeypatch.setattr(gateway, "serve_api", served)
    return fault


@pytest.fixture
def recorder_fault(monkeypatch: pytest.MonkeyPatch) -> Fault:
    fault, opened = Fault(), Recordings.open

    async def open_(recordings: Recordings) -> None:
        await opened(recordings)
        recordings._host.spawn(fault.raise_when_wanted(), name="fault")

    monkeypatch.setattr(Recordings, "open", open_)
    return fault


def findings(hub: Hub) -> dict[str, str]:
    return {part: found.code for part, found in hub.diagnoses.own.items()}


async def again(host: Daemon) -> None:
    """Wait until the gateway serves again, and use its new address."""
    await expect(lambda: host.hub.offered(ApiAddress))
    address = host.hub.offered(ApiAddress)
    assert address is not None
    host.url = address.url


# -- failures ---------------------------------------------------------------------------------------------------------


async def test_robot_of_a_gateway_that_fails_stops_and_is_driven_through_its_next_run(gateway_fault: Fault) -> None:
    twist = {"linear": {"x": 0.2}, "angular": {"z": 0.5}}
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        reasons = stops_of(host, "robot_0")
        for run in (1, 2):
            async with client(host) as program:
                await program.send(op="publish", topic="/robot_0/velocity_commands", msg=twist)
                assert await device.velocity_other_than(ZERO) == CURVE
                gateway_fault.happen()
                assert await device.velocity_other_than(CURVE) == ZERO
                await expect(lambda: findings(host.hub) == {"gateway": "component_failed"})
            assert host.hub.robots.find("robot_0").link is not None
            await expect(lambda: host.hub.counts.components["gateway"]()["failures"] == run)  # noqa: B023
            assert reasons == [OWNER_LEFT] * run or host.was_paused
            await again(host)
            assert findings(host.hub) == {}
            assert (await host.get("/api/robots/robot_0"))["holder"] is None


async def test_gateway_opens_its_port_again_and_refuses_a_token_that_a_reload_has_withdrawn(
    gateway_fault: Fault, tmp_path: Path
) -> None:
    port = free_port()
    config = Config(
        tcp=TcpConfig(host="127.0.0.1", port=0), components={"recorder": False}, guardian=False
    ).with_tables(api=ApiConfig(port=port, tokens=(ALICE, BOB)))
    withdrawn = config.with_tables(api=replace(config.table("api", ApiConfig), tokens=(BOB,)))
    url = f"http://127.0.0.1:{port}"
    async with running(config, read=lambda: withdrawn) as (hub, addresses), aiohttp.ClientSession() as session:

        async def status(token: str | None) -> int:
            async with session.get(f"{url}/api/robots", params={"token": token or ""}) as response:
                return response.status

        assert addresses.api == url
        assert [await status(each.token) for each in (ALICE, BOB)] == [200, 200]
        await hub.reloader.reload()
        assert [await status(each.token) for each in (ALICE, BOB)] == [401, 200]
        gateway_fault.happen()
        await expect(lambda: gateway_fault.runs == 2)
        assert [await status(each.token) for each in (ALICE, BOB)] == [401, 200]


async def test_recorder_that_fails_ends_its_files_and_records_again(recorder_fault: Fault, tmp_path: Path) -> None:
    config = Config().with_tables(
        recording=RecordingConfig(folder=tmp_path, min_free_disk_mb=0.0), black_box=BlackBoxConfig(after_s=0.0)
    )
    async with daemon(config, has_black_box=True) as host, fake_device(host.tcp, robot_topics()):
        await expect(lambda: host.hub.robots.has("robot_0"))
        for run in (1, 2):
            status, view = await host.rest("POST", "/api/recordings", b'{"name": "run_%d"}' % run)
            assert (status, view["files"]) == (200, [f"run_{run}.mcap"])
            recorder_fault.happen()
            await expect(lambda: findings(host.hub) == {"recorder": "component_failed"})
            for method, path in (
                ("GET", "/api/recordings"),
                ("POST", "/api/recordings"),
                ("GET", "/api/drives"),
                ("GET", "/api/incidents"),
            ):
                status, body = await host.rest(method, path)
                assert (status, body["error"]["kind"]) == (503, "ComponentGone")
                assert "the recorder does not run" in body["error"]["reason"]
            assert (await host.get("/api/robots/robot_0/history"))["poses"] == []
            async with host.session.get(f"{host.url}/metrics") as response:
                assert "hostlink_recordings_running" not in await response.text()
            await expect(lambda: host.hub.offered(Recordings))
        listed = await host.get("/api/recordings")
        assert {each["file"]: each["is_open"] for each in listed["files"]} == {"run_1.mcap": False, "run_2.mcap": False}
        assert (await host.rest("POST", "/api/incidents", b'{"robot": "robot_0", "reason": "x"}'))[0] == 200
        await expect(lambda: (tmp_path / "incidents").exists() and list((tmp_path / "incidents").iterdir()))
        async with host.session.get(f"{host.url}/metrics") as response:
            assert 'hostlink_graph_events_total{graph="recorder",what="failures"} 2.0' in await response.text()
    assert all((tmp_path / f"run_{run}.mcap").read_bytes().endswith(b"\x89MCAP0\r\n") for run in (1, 2))


@pytest.mark.parametrize("has_black_box", [True, False])
async def test_robots_are_held_without_a_recorder_that_cannot_begin(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, has_black_box: bool
) -> None:
    async def fail(_: Recordings) -> None:
        raise ValueError("a fault of the test")

    monkeypatch.setattr(Recordings, "open", fail)
    config = Config().with_tables(recording=RecordingConfig(folder=tmp_path))
    async with daemon(config, has_black_box=has_black_box) as host, fake_device(host.tcp, robot_topics()):
        await expect(lambda: host.hub.robots.has("robot_0"))
        assert findings(host.hub) == {"recorder": "component_failed"}
        assert [each["name"] for each in (await host.get("/api/robots"))["robots"]] == ["robot_0"]


async def test_port_of_the_gateway_in_use_at_the_start_ends_the_daemon_before_a_device_connects() -> None:
    listening = False

    def note() -> None:
        nonlocal listening
        listening = True

    async with daemon() as host:
        port = int(host.url.rpartition(":")[2])
        config = Config(tcp=TcpConfig(host="127.0.0.1", port=0)).with_tables(api=ApiConfig(port=port))
        with pytest.raises(ConfigError, match="is in use by another hostlink"):
            async with running(config, on_listening=note):
                pass
    assert not listening


async def test_robots_are_stopped_before_the_gateway_ends_and_the_recorder_ends_last(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    order: list[str] = []
    shutdown, aclose = Hub.shutdown, Recordings.aclose

    async def stop_robots(hub: Hub) -> None:
        await shutdown(hub)
        order.append("robots are stopped")

    @contextlib.asynccontextmanager
    async def served(host: Host, settings: GatewaySettings) -> AsyncIterator[str]:
        try:
            async with serve_api(host, settings) as url:
                yield url
        finally:
            order.append("gateway has ended")

    async def end(recordings: Recordings) -> None:
        order.append("recorder ends")
        await aclose(recordings)

    monkeypatch.setattr(Hub, "shutdown", stop_robots)
    monkeypatch.setattr(gateway, "serve_api", served)
    monkeypatch.setattr(Recordings, "aclose", end)
    async with daemon() as host, fake_device(host.tcp, robot_topics()):
        await expect(lambda: host.hub.robots.has("robot_0"))
    assert order == ["robots are stopped", "gateway has ended", "recorder ends"]


# -- switches ---------------------------------------------------------------------------------------------------------


async def test_daemon_holds_robots_without_gateway_and_recorder(tmp_path: Path) -> None:
    config = Config(
        tcp=TcpConfig(host="127.0.0.1", port=0),
        link=LinkConfig(silence_timeout_s=None, idle_timeout_s=None),
        components={"gateway": False, "recorder": False},
        guardian=False,
    ).with_tables(api=ApiConfig(port=free_port()), recording=RecordingConfig(folder=tmp_path / "recordings"))
    async with running(config) as (hub, addresses), fake_device(addresses.tcp, robot_topics()):
        await expect(lambda: hub.robots.has("robot_0"))
        assert addresses.api == ""
        with pytest.raises(OSError, match=r"."):
            await asyncio.open_connection("127.0.0.1", config.table("api", ApiConfig).port)
    assert not (tmp_path / "recordings").exists()


async def test_gateway_without_a_recorder_says_so() -> None:
    async with daemon(Config(components={"recorder": False})) as host:
        status, body = await host.rest("GET", "/api/recordings")
        assert (status, body["error"]["kind"]) == (503, "ComponentGone")
        assert "[components] switches it off" in body["error"]["reason"]
        async with host.session.get(f"{host.url}/api/events") as response:
            text = b""
            while b"event: recordings" not in text:
                text += await response.content.readany()
        assert findings(host.hub) == {}


async def test_python_program_with_the_core_has_a_gateway_if_its_settings_say_so() -> None:
    port = free_port()
    config = Config(tcp=TcpConfig(host="127.0.0.1", port=0), components={"gateway": True}, guardian=False).with_tables(
        api=ApiConfig(port=port)
    )
    async with serving(config) as host, aiohttp.ClientSession() as session:
        assert host.offered(ApiAddress) == ApiAddress(f"http://127.0.0.1:{port}")
        async with session.get(f"http://127.0.0.1:{port}/api/robots") as response:
            assert await response.json() == {"robots": []}


async def test_daemon_without_gateway_and_recorder_imports_no_web_server_and_no_numpy() -> None:
    text = "import sys, hostlink.cli.serve; print(*sys.modules)"
    process = await asyncio.create_subprocess_exec(sys.executable, "-c", text, stdout=asyncio.subprocess.PIPE)
    modules = (await process.communicate())[0].decode().split()
    assert "hostlink.core.running" in modules
    assert {"aiohttp", "prometheus_client", "numpy", "hostlink.components.recorder"} & set(modules) == set()
