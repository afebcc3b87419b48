"""Node of ROS 1: its addresses, waiting for the master's name, and why it ended."""

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from structlog.testing import capture_logs

from hostlink.components.ros1 import node as module
from hostlink.components.ros1.connections import Port
from hostlink.components.ros1.local_node import Ros1Counts
from hostlink.components.ros1.node import CRASHED, RETRY_S, Ros1, find_host
from hostlink.components.ros1.settings import Ros1Config
from hostlink.core.components import supervise
from hostlink.core.config import Config
from hostlink.core.host import Host
from hostlink.core.hub.hub import Hub
from hostlink.core.runtime.cancellation import meanwhile
from hostlink.errors import ConfigError
from tests.support.fake_device import CATALOG
from tests.support.virtual_loop import run_virtual

CONFIG = Ros1Config(master="http://master:11311/")


@pytest.mark.parametrize(
    ("host", "listens_on", "spelled"),
    [
        ("127.0.0.1", "127.0.0.1", "127.0.0.1"),
        ("127.0.1.1", "127.0.1.1", "127.0.1.1"),
        ("localhost", "127.0.0.1", "localhost"),
        ("::1", "::1", "[::1]"),
        ("10.0.0.1", "0.0.0.0", "10.0.0.1"),
        ("fd00::1", "::", "[fd00::1]"),
        ("robot", "0.0.0.0", "robot"),
    ],
)
def test_node_listens_on_loopback_only_for_a_loopback_host(host: str, listens_on: str, spelled: str) -> None:
    assert (module._listening_address(host), module.spelled(host, 1)) == (listens_on, f"{spelled}:1")


def test_configured_host_is_not_looked_up() -> None:
    config = Ros1Config(master="http://master:11311/", host="10.0.0.1")
    assert run_virtual(find_host(config)) == "10.0.0.1"


def test_own_address_is_looked_up_again_until_the_masters_name_has_one(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []

    async def find(master_uri: str) -> str:
        assert master_uri == CONFIG.master
        asked.append(asyncio.get_running_loop().time())
        if len(asked) < 3:
            raise socket.gaierror(-2, "Name or service not known")
        return "10.0.0.7"

    monkeypatch.setattr(module, "_own_address", find)
    with capture_logs() as logs:
        assert run_virtual(find_host(CONFIG)) == "10.0.0.7"
    assert asked == [0.0, RETRY_S, 2 * RETRY_S]
    assert [(each["event"], each["reason"]) for each in logs] == [("ros1.master_lost", "Name or service not known")]


class FakeMember:
    """Member that is shut down at once."""

    def __init__(self, reason: str) -> None:
        self.ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self.ended.set_result(reason)

    async def keep_registered(self) -> None:
        await asyncio.sleep(1e6)


@pytest.mark.parametrize(
    ("failure", "reason", "code"),
    [
        (None, "another node has the name", "component_troubled"),
        (ConfigError("ros1.port 7", "is in use"), "ros1.port 7 is in use", "component_troubled"),
        (ZeroDivisionError(), CRASHED, "component_failed"),
    ],
)
def test_end_of_the_node_is_reported_and_a_node_that_crashed_is_started_again(
    monkeypatch: pytest.MonkeyPatch, failure: Exception | None, reason: str, code: str
) -> None:
    @asynccontextmanager
    async def serving(_node: object, _names: object, host: str) -> AsyncIterator[Any]:
        assert host == "10.0.0.1"
        if failure is not None:
            raise failure
        yield FakeMember("another node has the name")

    monkeypatch.setattr(module, "_serving", serving)
    reasons: list[str] = []

    async def run() -> None:
        hub = Hub(Config(), CATALOG, reraises=False)
        hub.on_end_request = reasons.append
        config = Ros1Config(master="http://master:11311/", host="10.0.0.1")
        async with meanwhile(("ros1", supervise(hub, "ros1", lambda: Ros1(config)))):
            await asyncio.sleep(0.5)
            assert len(reasons) == 1
            assert [found.code for found in hub.diagnoses.own.values()] == [code]
            await asyncio.sleep(1.0)
            assert len(reasons) == (2 if reason == CRASHED else 1)

    with capture_logs() as logs:
        run_virtual(run())
    assert {each.replace(":", "") for each in reasons} == {reason}
    lines = [each for each in logs if each["event"] == "ros1.ended"]
    assert [line["reason"] for line in lines] == reasons


def test_end_of_the_daemon_reports_no_end_of_the_node(monkeypatch: pytest.MonkeyPatch) -> None:
    async def forever(_host: Host, _config: Ros1Config) -> str:
        await asyncio.sleep(1e6)
        return ""

    monkeypatch.setattr(module, "run_node", forever)
    reasons: list[str] = []

    async def run() -> None:
        hub = Hub(Config(), CATALOG)
        hub.on_end_request = reasons.append
        async with meanwhile(("ros1", supervise(hub, "ros1", lambda: Ros1(CONFIG)))):
            await asyncio.sleep(1.0)

    run_virtual(run())
    assert reasons == []


def test_port_that_is_in_use_is_named_by_its_setting(monkeypatch: pytest.MonkeyPatch) -> None:
    async def bind(_self: Port, host: str, number: int) -> int:
        assert host == "127.0.0.1"
        if number == 7:
            raise OSError(98, "Address already in use")
        return number

    monkeypatch.setattr(Port, "bind", bind)
    port = Port(Ros1Counts(), allow=(), max_connections=1)
    assert run_virtual(module._bound(port, "127.0.0.1", 8, "ros1.port")) == 8
    with pytest.raises(ConfigError, match=r"ros1\.port 7"):
        run_virtual(module._bound(port, "127.0.0.1", 7, "ros1.port"))
