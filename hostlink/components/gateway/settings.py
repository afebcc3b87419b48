"""Settings of the gateway, and the address that it offers to others. It is imported without a web server."""

from dataclasses import dataclass, field
from typing import Final, NamedTuple
from urllib.parse import urlsplit

from hostlink.core.config import ApiConfig, SerialConfig, TcpConfig, UdpConfig

# Connections reserved for requests, not for WebSockets and event streams: a stop needs one.
KEPT_FOR_REQUESTS: Final = 16


@dataclass(frozen=True, kw_only=True)
class GatewaySettings:
    """The table [api], and where devices connect, for people who ask the gateway."""

    api: ApiConfig = field(default_factory=ApiConfig)
    tcp: TcpConfig = field(default_factory=TcpConfig)
    udp: UdpConfig | None = None
    serial: tuple[SerialConfig, ...] = ()


class ApiAddress(NamedTuple):
    """Address at which programs reach the gateway of this daemon."""

    url: str


def is_origin(text: str) -> bool:
    """Whether a browser could send `text` as a page's origin; "*" is every origin, "file://" a program's own page."""
    try:
        parts = urlsplit(text)
    except ValueError:  # brackets that do not match
        return False
    return text in ("*", "file://") or (bool(parts.scheme and parts.netloc) and parts.path in ("", "/"))
