"""Connections to the broker: aiomqtt behind a callback, and its errors as one line for people."""

import asyncio
import contextlib
import re
import socket
import ssl
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Final

import aiomqtt
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from hostlink.components.mqtt.settings import MqttSettings
from hostlink.core.runtime.cancellation import raise_if_cancelled
from hostlink.errors import ConfigError

TIMEOUT_S: Final = 3.0  # for each answer of the broker
MAX_PACKET_BYTES: Final = 1 << 16  # MQTT 5: the broker sends no larger packet
MAX_PASSWORD_BYTES: Final = 1024
UNSUPPORTED: Final = 132  # reason codes of MQTT 5
LOGIN_REFUSED: Final = (134, 135, 138)
CLIENT_ID_REFUSED: Final = 133

Receive = Callable[[aiomqtt.Message], None]


class Connection:
    """One connection to the broker. Raises ConnectionError when it ends.

    aiomqtt waits with `asyncio.wait_for`, which in Python 3.11 drops a cancellation that arrives with the answer.
    """

    def __init__(self, client: aiomqtt.Client, broker: str) -> None:
        self._client, self._broker = client, broker

    async def publish(self, topic: str, payload: bytes, *, retain: bool = False, qos: int = 0) -> None:
        """Publish; returns when the message is written."""
        with as_os_errors(self._broker):
            await self._client.publish(topic, payload, qos=qos, retain=retain)
        raise_if_cancelled()

    async def subscribe(
        self, filters: list[str], *, qos: int, own: bool = True, as_published: bool = True
    ) -> list[str]:
        """Subscribe, also to retained messages. Returns the filters that the broker refused.

        `as_published`: a message that arrives live keeps its retain flag. `own`: also what this connection publishes.
        """
        options = SubscribeOptions(qos=qos, noLocal=not own, retainAsPublished=as_published)
        with as_os_errors(self._broker):
            codes = await self._client.subscribe([(each, options) for each in filters])
        raise_if_cancelled()
        return [each for each, code in zip(filters, codes, strict=True) if _is_failure(code)]

    async def ended(self) -> None:
        """Wait for the connection's end, which is an error."""
        with as_os_errors(self._broker):
            async for _ in self._client.messages:
                pass


@contextlib.asynccontextmanager
async def connected(
    settings: MqttSettings,
    receive: Receive,
    *,
    password: str | None,
    tls: ssl.SSLContext | None,
    suffix: str = "",
    will: aiomqtt.Will | None = None,
) -> AsyncIterator[Connection]:
    """Connection of which `receive` gets each message in the turn in which it is read."""

    class Inbox(asyncio.Queue[aiomqtt.Message]):
        def put_nowait(self, item: aiomqtt.Message) -> None:
            receive(item)

    properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
    properties.MaximumPacketSize = MAX_PACKET_BYTES
    client = aiomqtt.Client(
        settings.host,
        settings.port,
        username=settings.username or None,
        password=password,
        identifier=f"{settings.client_id}{suffix}" if settings.client_id else None,
        queue_type=Inbox,
        protocol=aiomqtt.ProtocolVersion.V5,
        will=will,
        clean_start=True,
        timeout=TIMEOUT_S,
        keepalive=settings.keepalive_s,
        properties=properties,
        tls_context=tls,
        socket_options=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)],
    )
    with as_os_errors(settings.broker):
        async with client:
            yield Connection(client, settings.broker)


@contextlib.contextmanager
def as_os_errors(broker: str) -> Iterator[None]:
    """Raise errors of the library as a ConnectionError that says what to do. A defect of ours stays what it is."""
    try:
        yield
    except aiomqtt.MqttCodeError as error:
        raise ConnectionError(f"{broker}: {_advice(error)}") from None
    except aiomqtt.MqttError as error:
        cause = error.__cause__
        if cause is not None and not isinstance(cause, aiomqtt.MqttError | OSError):
            raise cause from None  # of `receive`
        why = re.sub(r"^\[Errno -?\d+\] ", "", str(error)) if cause is None else "the broker has closed the connection"
        raise ConnectionError(f"{broker}: {why}; is the broker running, and reachable from here?") from None


def _advice(error: aiomqtt.MqttCodeError) -> str:
    code = error.rc.value if isinstance(error.rc, ReasonCode) else error.rc
    if code in LOGIN_REFUSED:
        return f"the broker refuses the login ({error.rc}): check username and password_file"
    if code == CLIENT_ID_REFUSED:
        return f"the broker refuses the client id ({error.rc}): set client_id to one that it permits"
    if code == UNSUPPORTED:
        return "the broker does not speak MQTT 5: use a newer one, such as mosquitto 1.6 or later"
    return f"the connection has ended ({error.rc if isinstance(error.rc, ReasonCode) else error})"


def _is_failure(code: object) -> bool:
    return isinstance(code, ReasonCode) and code.is_failure


def read_password(file: Path) -> str:
    """Return the first line of a password file.

    Raises:
        ConfigError: it cannot be read, or is not such a file.
    """
    try:
        with file.open("rb") as opened:
            data = opened.read(MAX_PASSWORD_BYTES + 1)
    except OSError as error:
        raise ConfigError("mqtt.password_file", f"{file}: {error.strerror}") from None
    first = data.splitlines()[0] if data.splitlines() else b""
    if not first or len(data) > MAX_PASSWORD_BYTES:
        raise ConfigError("mqtt.password_file", f"{file}: its first line must be the password, of at most 1 KB")
    return first.decode(errors="surrogateescape")


def load_tls(settings: MqttSettings) -> ssl.SSLContext | None:
    """Return the TLS context; None without TLS.

    Raises:
        ConfigError: a file is missing, or is not a certificate or key.
    """
    if not settings.tls:
        return None
    where = f"mqtt.ca: {settings.ca}" if settings.ca else "mqtt.ca"
    try:
        context = ssl.create_default_context(cafile=settings.ca)
        if settings.certificate and settings.key:
            where = f"mqtt.certificate: {settings.certificate}, {settings.key}"
            context.load_cert_chain(settings.certificate, settings.key, password=lambda: "")  # never asks a terminal
    except (OSError, ValueError) as error:
        raise ConfigError(where, f"cannot be loaded: {error}") from None
    return context
