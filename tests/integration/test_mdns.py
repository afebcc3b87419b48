"""The device port in the local network: found by its service type, gone with the daemon."""

import asyncio
import importlib.util
import sys
from dataclasses import replace

import pytest
from zeroconf import ServiceStateChange, Zeroconf
from zeroconf.asyncio import AsyncServiceBrowser, AsyncServiceInfo, AsyncZeroconf

from hostlink.cli.check import check
from hostlink.components.mdns import SERVICE
from hostlink.core.config import Config, TcpConfig
from hostlink.errors import ConfigError
from tests.support.daemon import daemon
from tests.support.waiting import TIMEOUT_S, expect

MDNS = TcpConfig(host="127.0.0.1", mdns=True)


async def test_a_daemon_is_found_by_its_service_and_no_longer_when_it_has_stopped() -> None:
    news: asyncio.Queue[tuple[ServiceStateChange, str]] = asyncio.Queue()

    def note(zeroconf: Zeroconf, service_type: str, name: str, state_change: ServiceStateChange) -> None:
        news.put_nowait((state_change, name))

    network = AsyncZeroconf(interfaces=["127.0.0.1"])
    browser = AsyncServiceBrowser(network.zeroconf, SERVICE, handlers=[note])
    try:
        async with asyncio.timeout(TIMEOUT_S):
            async with daemon(Config(tcp=MDNS)) as host:
                change, name = await news.get()
                assert change is ServiceStateChange.Added
                found = AsyncServiceInfo(SERVICE, name)
                assert await found.async_request(network.zeroconf, 3000)
                assert (found.parsed_addresses(), found.port) == (["127.0.0.1"], host.tcp[1])
            change, gone = await news.get()
            assert (change, gone) == (ServiceStateChange.Removed, name)
    finally:
        await browser.async_cancel()
        await network.async_close()


def without_zeroconf(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zeroconf", None)  # as where it is not installed
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "zeroconf" else found(name))


async def test_without_the_library_it_prints_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    without_zeroconf(monkeypatch)
    wanted = r"tcp.mdns: needs zeroconf, of the extra 'mdns': run  .* -m pip install 'ifaddr<"
    with pytest.raises(ConfigError, match=wanted):
        await check(Config(tcp=replace(MDNS, port=0)), descriptors=4096)
    async with daemon(Config(tcp=MDNS)) as host:
        await expect(lambda: "needs zeroconf" in host.hub.diagnoses.own["mdns"].detail)


async def test_daemon_without_mdns_setting_announces_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    without_zeroconf(monkeypatch)
    await check(Config(tcp=TcpConfig(port=0)), descriptors=4096)
    async with daemon(Config(tcp=replace(MDNS, mdns=False))) as host:
        assert "mdns" not in host.hub.counts.components
