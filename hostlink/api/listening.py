"""Where devices connect, over REST: for a page that has no robot to show yet."""

import ipaddress
from collections.abc import Iterable
from typing import TypedDict

from aiohttp import web

from hostlink.api.replies import reply
from hostlink.api.routes import Route
from hostlink.config import Config, TcpConfig, UdpConfig
from hostlink.hub.hub import Hub, Listening

SIM = "hostlink sim"
SIM_CONNECTS_TO = ("127.0.0.1", 11411)  # without --connect
LOOPBACK = {4: "127.0.0.1", 6: "::1"}


class AddressView(TypedDict):
    """An address; `0.0.0.0` and `::` are all addresses of the computer."""

    host: str
    port: int


class SerialPortView(TypedDict):
    """A serial port that is opened when it is there, and the rates that are tried."""

    port: str
    bauds: list[int]


class ListeningView(TypedDict):
    """Where devices connect; `simulate`: what to run on the daemon's computer for a simulated robot, null: none may."""

    tcp: AddressView | None
    udp: AddressView | None
    serial: list[SerialPortView]
    simulate: str | None


class ListeningRoute:
    """`GET /api/listening`."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub

    def routes(self) -> list[Route]:
        """The path of this file."""
        return [Route("/api/listening", self._show, "Where devices connect", ListeningView)]

    async def _show(self, _: web.Request) -> web.Response:
        return reply(listening_view(self._hub.listening, self._hub.config))


def listening_view(listening: Listening, config: Config) -> ListeningView:
    """What a person has to know who brings a device."""
    return {
        "tcp": _address(listening.tcp),
        "udp": _address(listening.udp),
        "serial": [{"port": port.name, "bauds": list(port.bauds)} for port in config.serial],
        "simulate": _simulate(listening.tcp, config.tcp) or _simulate(listening.udp, config.udp, " --udp"),
    }


def _address(address: tuple[str, int] | None) -> AddressView | None:
    return None if address is None else {"host": address[0], "port": address[1]}


def _simulate(address: tuple[str, int] | None, config: TcpConfig | UdpConfig | None, option: str = "") -> str | None:
    """The command; None: nobody listens, or a robot of this computer is turned away, which has no key."""
    if address is None or config is None:
        return None
    bound = ipaddress.ip_address(address[0])
    host = LOOPBACK[bound.version] if bound.is_unspecified else str(bound)
    if (config.allow and not _is_in(host, config.allow)) or (config.key_file and not _is_in(host, config.keyless)):
        return None
    if (host, address[1]) == SIM_CONNECTS_TO:
        return SIM + option
    return f"{SIM}{option} --connect {f'[{host}]' if bound.version == 6 else host}:{address[1]}"  # noqa: PLR2004 - of IP


def _is_in(host: str, networks: Iterable[str]) -> bool:
    """Whether the address of this computer is within one of them; it is where its own connections come from."""
    return any(ipaddress.ip_address(host) in ipaddress.ip_network(network) for network in networks)
