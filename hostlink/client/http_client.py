"""HttpClient: HTTP to one hostlink, its JSON and its server-sent events. Its errors say what to do."""

import asyncio
import ssl
import weakref
from collections.abc import AsyncIterator, Iterator, Mapping
from http import HTTPStatus
from typing import Any, cast
from urllib.parse import SplitResult, parse_qs, urlsplit

import aiohttp
import msgspec

from hostlink.client.callers import Callers, boot_s
from hostlink.client.views import Event
from hostlink.core.robot.standstill import Standstill, StandstillState
from hostlink.core.robot.views import CommandEndpointView
from hostlink.errors import ConfigError, HostlinkError, Refused

DEFAULT_PORT = 9090  # of an address that is a host alone
REQUEST_TIMEOUT_S = 5.0
CLOSE_TIMEOUT_S = 1.0

# -- JSON -------------------------------------------------------------------------------------------------------------


def encode(message: Any) -> bytes:
    """The JSON of a message.

    Raises:
        HostlinkError: something in it has no JSON.
    """
    try:
        return _ENCODER.encode(message)
    except TypeError as error:  # a key that is not a string
        raise HostlinkError(f"a message cannot contain this: {error}") from error


def _plain(value: Any) -> Any:
    """Convert numpy's scalars and arrays to Python's."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise HostlinkError(f"a message cannot contain a {type(value).__name__}: numbers, texts, lists and dicts are fine")


_ENCODER = msgspec.json.Encoder(enc_hook=_plain)


# -- server-sent events -----------------------------------------------------------------------------------------------


class EventStream:
    """Parser of hostlink's events: one `event` line and one `data` line of JSON each; comments are skipped."""

    def __init__(self) -> None:
        self.last_id = ""  # of the newest event that has one: a later stream continues after it
        self._pending = bytearray()
        self._name = ""

    def begin(self) -> None:
        """Forget half an event of a lost connection."""
        self._pending.clear()
        self._name = ""

    def feed(self, data: bytes) -> Iterator[Event]:
        """The events that are complete with these bytes."""
        self._pending += data
        if b"\n" not in data:
            return
        *lines, self._pending = self._pending.split(b"\n")
        for line in lines:
            key, _, value = bytes(line).partition(b": ")
            if key == b"event":
                self._name = value.decode()
            elif key == b"id":
                self.last_id = value.decode()
            elif key == b"data":
                yield Event(self._name, msgspec.json.decode(value))


# -- http client ------------------------------------------------------------------------------------------------------

_SCHEMES = {"http": "http", "https": "https", "ws": "http", "wss": "https"}
_NOT_KNOWN = "it does not know this token, or not any more: ask whoever runs it for one"
_JSON = {"Content-Type": "application/json"}
_ADVICE = {
    HTTPStatus.UNAUTHORIZED: "it wants a token that it knows: connect(url, token=...), or --token of a command",
    HTTPStatus.FORBIDDEN: "this token, or this place, may not do that: ask whoever runs it",
    HTTPStatus.TOO_MANY_REQUESTS: "ask less often, or raise max_requests_s in its configuration",
    HTTPStatus.SERVICE_UNAVAILABLE: "it is not ready, or has its max_clients already: try again later",
}


class HttpClient:
    """Requests, and the WebSocket. Every error is a HostlinkError."""

    def __init__(self, url: str, token: str | None, context: ssl.SSLContext | None) -> None:
        """`url` may be http, https, ws or wss, or a host with or without a port, and may end in `?token=...`.

        Raises:
            HostlinkError: the address or the token is invalid.
        """
        parts = _parts(url)
        port = f":{DEFAULT_PORT}" if "://" not in url and parts.port is None else ""
        self.url = f"{_SCHEMES[parts.scheme]}://{parts.netloc}{port}{parts.path.rstrip('/')}"
        token = token or parse_qs(parts.query).get("token", [""])[0]
        if not token.isprintable():
            raise HostlinkError("the token has a character that is not printable, such as the end of a line: remove it")
        self._has_token = bool(token)
        if context is None:  # aiohttp's own may have no certificates: hostlink.cli.start
            is_secure = parts.scheme in ("https", "wss")
            context = ssl.create_default_context() if is_secure else ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        self._session = aiohttp.ClientSession(
            timeout=aiohttp.ClientTimeout(total=REQUEST_TIMEOUT_S),
            headers={"Authorization": f"Bearer {token}"} if token else None,
            connector=aiohttp.TCPConnector(ssl=context),
        )
        self.callers = Callers(boot_s)
        self._streams: weakref.WeakSet[aiohttp.ClientResponse] = weakref.WeakSet()

    async def aclose(self) -> None:
        """Close every connection."""
        await self._session.close()

    def cut_streams(self) -> None:
        """The network is cut: `events` ends now, and not when TCP finds out."""
        for response in list(self._streams):
            response.close()

    async def open_socket(self, group: str = "", name: str = "") -> aiohttp.ClientWebSocketResponse:
        """A new WebSocket; its pings and pongs are the caller's. `group` and `name`: as of `connect`.

        Raises:
            HostlinkError: it is refused, or not answered.
        """
        timeout = aiohttp.ClientWSTimeout(ws_close=CLOSE_TIMEOUT_S)
        try:
            return await self._session.ws_connect(
                f"{self.url}/",
                params={key: value for key, value in (("group", group), ("name", name)) if value},
                autoping=False,
                timeout=timeout,
                max_msg_size=0,
            )
        except aiohttp.WSServerHandshakeError as error:
            raise HostlinkError(self._refusal(error.status)) from error
        except (aiohttp.ClientError, OSError, ValueError) as error:
            raise HostlinkError(self._explain(error)) from error

    async def request(
        self, method: str, path: str, body: Mapping[str, Any] | None = None, *, timeout_s: float = REQUEST_TIMEOUT_S
    ) -> dict[str, Any]:
        """A request of the REST API, and its JSON.

        Raises:
            HostlinkError: the daemon refuses, with its reason; or it was not reached.
        """
        data = None if body is None else encode(body)
        headers = None if body is None else _JSON
        self.callers.note()
        try:
            async with (
                asyncio.timeout(timeout_s),
                self._session.request(method, self.url + path, data=data, headers=headers) as response,
            ):
                return self._read(response.status, await response.read())
        except TimeoutError as error:
            raise HostlinkError(f"hostlink at {self.url} did not answer within {timeout_s:g} s") from error
        except (aiohttp.ClientError, OSError) as error:
            raise HostlinkError(self._explain(error)) from error
        finally:
            self.callers.note()

    async def measure(self, path: str, wait_s: float) -> Standstill:
        """Measure a robot after a stop. Without an answer the state is unknown; the stop remains valid."""
        try:
            answer = await self.request("GET", f"{path}?wait_s={wait_s:g}", timeout_s=wait_s + REQUEST_TIMEOUT_S)
        except HostlinkError as error:
            return Standstill(StandstillState.UNKNOWN, reason=str(error))
        return measured(answer)

    async def download(self, path: str) -> AsyncIterator[bytes]:
        """The pieces of a file.

        Raises:
            HostlinkError: the daemon refuses, with its reason; it was not reached, or the connection is lost.
        """
        timeout = aiohttp.ClientTimeout(total=None, sock_connect=REQUEST_TIMEOUT_S, sock_read=REQUEST_TIMEOUT_S)
        try:
            async with self._session.get(self.url + path, timeout=timeout) as response:
                if response.status != HTTPStatus.OK:
                    self._read(response.status, await response.read())
                async for piece in response.content.iter_chunked(64 * 1024):
                    self.callers.note()
                    yield piece
                    self.callers.note()
        except (aiohttp.ClientError, OSError) as error:
            raise HostlinkError(self._explain(error)) from error

    async def events(self, path: str, stream: EventStream) -> AsyncIterator[Event]:
        """The server-sent events of a path, since the last one that `stream` has read.

        Raises:
            HostlinkError: the daemon refuses it, or the connection is lost.
        """
        timeout = aiohttp.ClientTimeout(total=None, sock_connect=REQUEST_TIMEOUT_S)
        last = {"Last-Event-ID": stream.last_id} if stream.last_id else {}
        try:
            async with self._session.get(self.url + path, timeout=timeout, headers=last) as response:
                if response.status != HTTPStatus.OK:
                    self._read(response.status, await response.read())
                self._streams.add(response)
                stream.begin()
                async for chunk in response.content.iter_any():
                    for event in stream.feed(chunk):
                        self.callers.note()
                        yield event
                        self.callers.note()
        except (aiohttp.ClientError, OSError) as error:
            raise HostlinkError(self._explain(error)) from error

    def _read(self, status: int, body: bytes) -> dict[str, Any]:
        try:
            answer: Any = msgspec.json.decode(body)
        except msgspec.DecodeError as error:
            raise HostlinkError(self._refusal(status)) from error
        if not isinstance(answer, dict):
            raise HostlinkError(self._refusal(status))
        if "error" in answer:
            told = answer["error"]
            kind, reason = (told.get("kind"), told.get("reason")) if isinstance(told, dict) else ("", told)
            raise Refused(str(kind), self._reason(str(kind), reason, status), answer)
        return answer

    def _reason(self, kind: str, reason: Any, status: int) -> str:
        """The daemon's own words, and what to do where they do not say it."""
        match status:
            case HTTPStatus.UNAUTHORIZED:
                return self._refusal(status)
            case HTTPStatus.FORBIDDEN:
                return f"{reason}; ask whoever runs it"
            case HTTPStatus.NOT_FOUND if kind == "HTTP":  # it has no such path
                return f"hostlink at {self.url} is of another version than this one, and does not know what is wanted"
        return str(reason)

    def _refusal(self, status: int) -> str:
        """Return the error of an answer that has no words of a hostlink."""
        if status not in _ADVICE:
            what = f"what answers there (HTTP {status}) is no hostlink, or an older one"
            return f"no hostlink at {self.url}: {what}: look at the address and the port"
        is_unknown = status == HTTPStatus.UNAUTHORIZED and self._has_token
        return f"hostlink at {self.url} refuses: {_NOT_KNOWN if is_unknown else _ADVICE[HTTPStatus(status)]}"

    def _explain(self, error: Exception) -> str:
        match error:
            case aiohttp.ClientConnectorCertificateError():
                cause = f"its certificate is not trusted ({error.certificate_error}): connect(url, ssl=...) takes yours"
            case aiohttp.ClientSSLError():
                cause = "it does not speak TLS there: begin the address with http://"
            case aiohttp.ClientConnectorDNSError():
                cause = "no computer of that name: look at the address, or write its number"
            case aiohttp.ServerDisconnectedError():
                cause = "it closed the connection: what answers there may be no hostlink, or want https://"
            case TimeoutError():
                cause = f"no answer within {REQUEST_TIMEOUT_S:g} s: look at the address, the network and its firewalls"
            case aiohttp.ClientResponseError():
                cause = "what answers there speaks no HTTP: devices have port 11411, programs 9090"
            case aiohttp.ClientConnectorError() if isinstance(error.os_error, ConnectionRefusedError):
                cause = "is `hostlink serve` running there? Nothing listens; `hostlink demo` runs one with a robot"
            case aiohttp.ClientConnectorError() if error.os_error.strerror:
                cause = f"there is no way to it ({error.os_error.strerror}): check the address and the network"
            case _:
                cause = f"is `hostlink serve` running there? ({error})"
        return f"no hostlink at {self.url}: {cause}"


def endpoints(answer: Mapping[str, Any]) -> list[CommandEndpointView]:
    """Read the topics that are not a robot's from the answer to a stop or a lock; an older daemon sends none."""
    return cast(list[CommandEndpointView], answer.get("endpoints", []))


def measured(robot: Mapping[str, Any]) -> Standstill:
    """Read the standstill of a robot from an answer of the REST API."""
    standstill = dict(robot["standstill"])
    return Standstill(StandstillState(standstill.pop("state")), **standstill)


def _parts(url: str) -> SplitResult:
    """Raises:
    ConfigError: it is not an address.
    """
    bare = url.lstrip(":")
    try:
        parts = urlsplit(url if "://" in url else f"http://{url}")
        is_address = (
            parts.scheme in _SCHEMES
            and not url.isdecimal()
            and bool((parts.hostname or "").encode("idna"))
            and parts.port != 0
        )
    except ValueError:  # the port is not a number, brackets do not match, or a label of the name is empty or too long
        is_address = False
    if not is_address:
        example = f"127.0.0.1:{bare}" if bare.isdecimal() else f"HOST:{DEFAULT_PORT}"
        raise ConfigError("url", f"{url!r} is not an address of a hostlink: write it as http://{example}")
    return parts
