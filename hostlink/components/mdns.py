"""The device port in the local network, by multicast DNS: boards and programs find it by its service type."""

import asyncio
import importlib.util
import ipaddress
import socket
from dataclasses import dataclass

from hostlink.core.host import Component, Host
from hostlink.errors import ConfigError, LibraryMissing

SERVICE = "_rosserial._tcp.local."


@dataclass(frozen=True, kw_only=True)
class MdnsSettings:
    """No settings: what is announced is the address of [tcp]."""


class Mdns(Component[MdnsSettings]):
    """`[tcp] mdns = true`, or `mdns = true` in [components]."""

    name = "mdns"
    settings_type = MdnsSettings

    def check(self) -> tuple[str, ...]:
        """Check that its libraries are installed."""
        if not all(map(importlib.util.find_spec, ("ifaddr", "zeroconf"))):
            raise LibraryMissing("tcp.mdns", "zeroconf", "mdns")
        return ()

    def describe(self) -> str:
        """Return one line for --check-config."""
        return f"the port for devices is announced as {SERVICE}"

    async def run(self, host: Host) -> None:
        """Announce the port until cancelled."""
        try:
            import ifaddr  # noqa: PLC0415 - an optional dependency
            import zeroconf  # noqa: PLC0415
            from zeroconf.asyncio import AsyncZeroconf  # noqa: PLC0415
        except ImportError as error:
            raise LibraryMissing("tcp.mdns", "zeroconf", "mdns") from error
        if host.listening.tcp is None:
            raise ConfigError("components.mdns", "there is no TCP port for devices to announce")
        listens_on, port = host.listening.tcp
        is_any = ipaddress.ip_address(listens_on).is_unspecified
        addresses = (
            _reachable([str(ip.ip) for adapter in ifaddr.get_adapters() for ip in adapter.ips if ip.is_IPv4])
            if is_any
            else [listens_on]
        )
        computer = socket.gethostname().split(".")[0]
        info = zeroconf.ServiceInfo(
            SERVICE,
            f"hostlink on {computer}.{SERVICE}",
            port=port,
            parsed_addresses=addresses,
            server=f"{computer}.local.",
        )
        network = AsyncZeroconf(interfaces=zeroconf.InterfaceChoice.All if is_any else addresses)
        try:
            await (await network.async_register_service(info, allow_name_change=True))  # another host may use the name
            await asyncio.Event().wait()
        finally:
            await network.async_unregister_all_services()
            await network.async_close()


def _reachable(addresses: list[str]) -> list[str]:
    """Return the addresses that another computer can reach; all addresses if none is reachable."""
    return [address for address in addresses if not ipaddress.ip_address(address).is_loopback] or addresses
