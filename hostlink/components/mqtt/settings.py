"""Settings of the table [mqtt]."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hostlink.errors import ConfigError

LOCAL: Final = frozenset({"127.0.0.1", "localhost", "::1"})
PLAIN_PORT, TLS_PORT = 1883, 8883  # as registered at IANA
MAX_PORT: Final = 0xFFFF
MAX_TEXT: Final = 200  # characters of a host, a user name or a prefix
CLIENT_ID = re.compile(r"[0-9A-Za-z._-]{0,100}")
PREFIX = re.compile(r"[^+#$\x00-\x20/][^+#\x00-\x20/]*(/[^+#\x00-\x20/]+)*")


@dataclass(frozen=True, kw_only=True)
class MqttSettings:
    """The table [mqtt] of hostlink.toml."""

    host: str = "127.0.0.1"
    port: int = PLAIN_PORT
    username: str = ""
    password_file: Path | None = None
    client_id: str = ""
    tls: bool = False
    ca: Path | None = None
    certificate: Path | None = None
    key: Path | None = None
    keepalive_s: int = 15
    prefix: str = "hostlink"
    interval_s: float = 1.0
    forget_after_s: float = 600.0
    drive: bool = False
    max_age_s: float = 1.0
    unlock: bool = True
    discovery: bool = True
    discovery_prefix: str = "homeassistant"

    @property
    def broker(self) -> str:
        """Address for people."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'mqtts' if self.tls else 'mqtt'}://{host}:{self.port}"

    def check(self) -> tuple[str, ...]:
        """Return warnings.

        Raises:
            ConfigError: a setting cannot work.
        """
        self._check_values()
        self._check_tls()
        return tuple(self._warnings())

    def _check_values(self) -> None:
        if not self.host or len(self.host) > MAX_TEXT or re.search(r"[\s/]", self.host):
            raise ConfigError(
                "mqtt.host", f"{self.host!r} is not a host name or an address; the port has a key of its own"
            )
        if not 0 < self.port <= MAX_PORT:
            raise ConfigError("mqtt.port", f"{self.port} is not a port; the usual ones are 1883, and 8883 with TLS")
        if len(self.username) > MAX_TEXT or "\0" in self.username:
            raise ConfigError("mqtt.username", f"must be a text of at most {MAX_TEXT} characters")
        if self.password_file is not None and not self.username:
            raise ConfigError("mqtt.password_file", "needs username: a broker takes no password without a name")
        if not CLIENT_ID.fullmatch(self.client_id):
            raise ConfigError("mqtt.client_id", "must be at most 100 letters, digits, '.', '_' or '-'")
        for key, prefix in (("prefix", self.prefix), ("discovery_prefix", self.discovery_prefix)):
            if len(prefix) > MAX_TEXT or not PREFIX.fullmatch(prefix):
                advice = "use names joined by '/', without '+', '#', spaces, and '$' or '/' at the beginning"
                raise ConfigError(f"mqtt.{key}", f"{prefix!r} is not the beginning of a topic; {advice}")
        _check_range("keepalive_s", self.keepalive_s, 2, 600)
        _check_range("interval_s", self.interval_s, 0.1, 3600)
        _check_range("forget_after_s", self.forget_after_s, 1, 31e6)
        _check_range("max_age_s", self.max_age_s, 0.1, 10)

    def _check_tls(self) -> None:
        for key, file in (("ca", self.ca), ("certificate", self.certificate), ("key", self.key)):
            if file is not None and not self.tls:
                raise ConfigError(f"mqtt.{key}", "is for a connection with TLS: set tls = true")
        if (self.certificate is None) != (self.key is None):
            raise ConfigError("mqtt.certificate", "certificate and key belong together: set both, or neither")

    def _warnings(self) -> list[str]:
        warnings = []
        is_local = self.host in LOCAL
        has_login = bool(self.username or self.certificate)
        if self.drive and not has_login:
            warnings.append("drive = true without username: every program that reaches the broker may drive the robots")
        elif not is_local and not has_login:
            warnings.append("without username: every program that reaches the broker may stop and lock the robots")
        if not is_local and not self.tls:
            also = ", also the password," if self.password_file else ""
            warnings.append(f"tls = false: everything{also} crosses the network to {self.host} in the clear")
        if self.username and self.password_file is None:
            warnings.append("username without password_file: the broker gets a name without a password")
        if self.tls and self.port == PLAIN_PORT:
            warnings.append(f"port = {PLAIN_PORT}, the usual one without TLS; with TLS it is {TLS_PORT}")
        if not self.tls and self.port == TLS_PORT:
            warnings.append(f"port = {TLS_PORT}, the usual one with TLS: set tls = true, or port = {PLAIN_PORT}")
        return warnings


def _check_range(key: str, value: float, least: float, most: float) -> None:
    if not math.isfinite(value) or not least <= value <= most:
        raise ConfigError(f"mqtt.{key}", f"{value:g} is out of range; choose {least:g} to {most:g}")
