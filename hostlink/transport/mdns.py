"""mDNS advertisement of the device port as `_rosserial._tcp` (Bonjour, Avahi)."""

import contextlib
import ipaddress
import socket
from collections.abc import AsyncIterator

from hostlink.config import TcpConfig
from hostlink.errors import LibraryMissing

SERVICE = "_rosserial._tcp.local."


@contextlib.asynccontextmanager
async def advertised(config: TcpConfig, address: tuple[str, int]) -> AsyncIterator[None]:
    """Advertise the port until the block is left, if `config.mdns` is set."""
    if not config.mdns:
        yield
        return
    try:
        import ifaddr  # noqa: PLC0415 - an optional dependency
        import zeroconf  # noqa: PLC0415
        from zeroconf.asyncio import AsyncZeroconf  # noqa: PLC0415
    except ImportError as error:
        raise LibraryMissing("tcp.mdns", "zeroconf", "mdns") from error
    listens_on, port = address
    is_any = ipaddress.ip_address(listens_on).is_unspecified
    addresses = (
        _reachable([str(ip.ip) for adapter in ifaddr.get_adapters() for ip in adapter.ips if ip.is_IPv4])
        if is_any
        else [listens_on]
    )
    host = socket.gethostname().split(".")[0]
    info = zeroconf.ServiceInfo(
        SERVICE, f"hostlink on {host}.{SERVICE}", port=port, parsed_addresses=addresses, server=f"{host}.local."
    )
    network = AsyncZeroconf(interfaces=zeroconf.InterfaceChoice.All if is_any else addresses)
    try:
        await (await network.async_register_service(info, allow_name_change=True))  # another host may use the name
        yield
    finally:
        await network.async_unregister_all_services()
        await network.async_close()


def _reachable(addresses: list[str]) -> list[str]:
    """Return the addresses that another computer can reach; all addresses if none is reachable."""
    return [address for address in addresses if not ipaddress.ip_address(address).is_loopback] or addresses
