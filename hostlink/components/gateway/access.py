"""Access: tokens, roles and origins of the API. Every request is checked here.

Without tokens the API listens on loopback only, and web pages of other origins cannot use it through a browser on this
computer (Origin and Host are checked). With tokens it may listen on any address.
"""

import asyncio
import contextlib
import functools
import hmac
import ipaddress
import math
import ssl
from collections.abc import Container, Iterator
from typing import NamedTuple
from urllib.parse import SplitResult, urlsplit

import structlog
from aiohttp import web

from hostlink.components.gateway.settings import KEPT_FOR_REQUESTS, ApiConfig, TokenConfig
from hostlink.core.config import is_address
from hostlink.core.host import Role
from hostlink.core.runtime.logs import printable
from hostlink.core.runtime.text_file import read_text
from hostlink.errors import ConfigError

log = structlog.get_logger()

SHORTEST_TOKEN = 16  # characters: at least 80 random bits
MAX_LOGGED_ORIGINS = 4  # refused origins; a page may have any
_NO_ORIGIN = "open the page by http, not from a file: any page can have the origin null"
_HOW_TO_MAKE_ONE = "make one with  python3 -c 'import secrets; print(secrets.token_urlsafe(24))'"


class Grant(NamedTuple):
    """Role of a request, and the token that grants it."""

    who: str  # name of the token; empty: no tokens are configured
    role: Role


GRANT = web.RequestKey("grant", Grant)  # of the request that is being answered


class Access:
    """Access rules of one API server. A refusal is an HTTP error that names the next step."""

    def __init__(self, config: ApiConfig) -> None:
        """Check the settings.

        Raises:
            ConfigError: a setting is invalid, or would let the network drive a robot.
        """
        self._tokens = [(_secret(token), Grant(token.name, Role[token.role.upper()])) for token in config.tokens]
        self._origins = frozenset(origin.rstrip("/") for origin in config.origins)
        self._refused_origins: set[str] = set()  # already logged
        if len({secret for secret, _ in self._tokens}) < len(self._tokens):
            raise ConfigError("api.tokens", "two names have the same token: the driver would be unknown")
        for limit in ("max_clients", "max_message_bytes", "max_requests_s"):
            if not getattr(config, limit) >= 1:
                raise ConfigError(f"api.{limit}", "must be 1 or more")
        if not 0 < config.request_timeout_s < math.inf:
            raise ConfigError("api.request_timeout_s", "must be above 0, and finite")
        for limit in ("max_connections", "max_connections_per_address"):
            if getattr(config, limit) <= KEPT_FOR_REQUESTS:
                raise ConfigError(f"api.{limit}", f"must be more than {KEPT_FOR_REQUESTS}, which only requests may use")
        if not self._tokens and not is_loopback(config.host):
            raise ConfigError(
                f"api.host {config.host}",
                "every program on the network could drive the robots: set [[api.tokens]], or listen on 127.0.0.1",
            )
        if not self._tokens and "*" in self._origins:
            raise ConfigError("api.origins", '"*" would let every web page drive the robots: set [[api.tokens]] too')

    def revoked(self, new: "Access") -> set[str]:
        """Return the names of tokens that `new` lacks or gives another role; empty: requests without a token."""
        if not self.has_tokens:
            return {""} if new.has_tokens else set()
        return {grant.who for secret, grant in self._tokens if not new.has(secret, grant)}

    @property
    def has_tokens(self) -> bool:
        """Whether requests need a token."""
        return bool(self._tokens)

    def has(self, secret: bytes, grant: Grant) -> bool:
        """Whether this token grants this role."""
        return (secret, grant) in self._tokens

    def check_place(self, *, origin: str | None, host: str) -> None:
        """Refuse a request from a page of an unknown origin, or to an unknown host name.

        Raises:
            web.HTTPForbidden: the host or the origin is not allowed.
        """
        if not self._tokens and not _is_plain_address(host):  # a name that an attacker points here (DNS rebinding)
            raise web.HTTPForbidden(reason=f"host {host} refused: without tokens use http://localhost or an IP address")
        if origin is not None and _parts(origin).netloc != host and not self._origins & {origin.rstrip("/"), "*"}:
            self._log_refused(origin)
            raise web.HTTPForbidden(reason=f'origin {origin} refused: add "{origin}" to api.origins to allow its pages')

    def _log_refused(self, origin: str) -> None:
        """Log each refused origin once: the page does not learn the reason."""
        name = printable(origin)
        is_browsers = origin == "null" or "://" in origin  # other values do not come from a browser
        if is_browsers and name not in self._refused_origins and len(self._refused_origins) < MAX_LOGGED_ORIGINS:
            self._refused_origins.add(name)
            log.error("client.origin_refused", origin=name, allow=_NO_ORIGIN if name == "null" else f"--origin {name}")

    def grant(self, token: str | None) -> Grant:
        """Return what the token allows. Without configured tokens everything is allowed.

        Raises:
            web.HTTPUnauthorized: the token is missing or unknown.
        """
        if not self._tokens:
            return Grant("", Role.DRIVE)
        if not token:
            raise _unauthorized('a token is needed: "Authorization: Bearer ..." or ?token=...')
        given, found = token.encode(errors="surrogateescape"), None
        for secret, grant in self._tokens:  # all tokens, so that the duration reveals nothing
            if hmac.compare_digest(secret, given):
                found = grant
        if found is None:
            raise _unauthorized("this token is unknown")
        return found


def check_role(grant: Grant, needed: Role) -> None:
    """Refuse a request that the role does not allow.

    Raises:
        web.HTTPForbidden: the role is too low.
    """
    if grant.role < needed:
        raise web.HTTPForbidden(reason=f"the token {grant.who} may only {grant.role.name.lower()}, not drive")


def token_of(request: web.Request) -> str | None:
    """Return the token of a request: from its header, or from its URL, because a browser's WebSocket has no headers."""
    scheme, _, token = request.headers.get("Authorization", "").partition(" ")
    return token.strip() if scheme.lower() == "bearer" else request.query.get("token")


def caller_name(request: web.Request) -> str:
    """Return the name of the token of a request; without tokens the client's address."""
    return request[GRANT].who or request.remote or ""


def tls_context(config: ApiConfig) -> ssl.SSLContext | None:
    """Return the TLS context; None without TLS.

    Raises:
        ConfigError: a file is missing or invalid.
    """
    if config.certificate is None and config.key is None:
        return None
    if config.certificate is None or config.key is None:
        raise ConfigError("api", "TLS needs both certificate and key")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(config.certificate, config.key)
    except (OSError, ssl.SSLError) as error:
        raise ConfigError(f"api.certificate {config.certificate}, key {config.key}", str(error)) from error
    return context


def _secret(token: TokenConfig) -> bytes:
    where = f"api.tokens {token.name}"
    if (token.token is None) == (token.token_file is None):
        raise ConfigError(where, "needs either token or token_file")
    secret = token.token
    if token.token_file is not None:
        try:
            secret = read_text(token.token_file).strip()
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(where, f"token_file: {error}") from error
    if not secret or len(secret) < SHORTEST_TOKEN:
        raise ConfigError(where, f"a token needs at least {SHORTEST_TOKEN} characters; {_HOW_TO_MAKE_ONE}")
    return secret.encode()


def _unauthorized(reason: str) -> web.HTTPUnauthorized:
    return web.HTTPUnauthorized(reason=reason, headers={"WWW-Authenticate": 'Bearer realm="hostlink"'})


def is_loopback(host: str) -> bool:
    """Whether only this computer can reach the address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


@functools.lru_cache(maxsize=64)  # the few names by which programs call this server
def _is_plain_address(host: str) -> bool:
    """Whether a Host header names this computer without DNS."""
    name = _parts(f"//{host}").hostname or ""
    return name == "localhost" or name.endswith(".localhost") or is_address(name)


def _parts(url: str) -> SplitResult:
    try:
        return urlsplit(url)
    except ValueError:  # unbalanced brackets
        return urlsplit("")


Answering = asyncio.Task[object]


class Grants:
    """Tasks that answer requests, by grant. The task of a WebSocket runs while it is open."""

    def __init__(self) -> None:
        self._tasks: dict[Answering, Grant] = {}

    @contextlib.contextmanager
    def using(self, grant: Grant) -> Iterator[None]:
        """Register the current task under the grant within the block."""
        task = asyncio.current_task()
        assert task is not None  # noqa: S101 - called in a coroutine
        self._tasks[task] = grant
        try:
            yield
        finally:
            del self._tasks[task]

    def end(self, revoked: Container[str]) -> None:
        """Cancel the tasks of revoked tokens, except the current one. What they drive stops."""
        present = asyncio.current_task()
        for task, grant in self._tasks.items():
            if grant.who in revoked and task is not present:
                task.cancel()
