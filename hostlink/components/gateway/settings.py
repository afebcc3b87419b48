"""Settings of the gateway, and the address that it offers to others. It is imported without a web server."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, NamedTuple
from urllib.parse import urlsplit

from hostlink.core.config import AT_ONCE, SerialConfig, TcpConfig, UdpConfig

# Connections reserved for requests, not for WebSockets and event streams: a stop needs one.
KEPT_FOR_REQUESTS: Final = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class TokenConfig:
    """API token: its name and its role."""

    name: str
    role: Literal["read", "drive"] = "read"
    token: str | None = field(default=None, repr=False)
    token_file: Path | None = None  # alternative to `token`


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiConfig:
    """API port, access and limits."""

    host: str = "127.0.0.1"
    port: int = 9090  # the default of rosbridge
    tokens: tuple[TokenConfig, ...] = field(default=(), metadata=AT_ONCE)
    origins: tuple[str, ...] = field(default=(), metadata=AT_ONCE)  # of other web pages that may use the API
    certificate: Path | None = None  # PEM; with `key`: TLS
    key: Path | None = None
    max_clients: int = 256  # WebSockets and event streams at once
    # TCP connections, including those of clients: half of the usual descriptor limit of a process.
    max_connections: int = 512
    max_connections_per_address: int = 320  # this computer is one address, and may have every client
    request_timeout_s: float = 10.0  # for the head of a request, and again for its body
    max_message_bytes: int = 1024 * 1024  # ten times the largest device frame in base64
    max_requests_s: float = 1000.0  # per address, and per WebSocket; ten robots driven at 100 Hz


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
