"""MICRO_ROS_UDP, MICRO_ROS_TCP, MICRO_ROS_SERIAL: DDS-XRCE as listeners and links use it, one for each transport."""

from collections.abc import Callable
from typing import ClassVar

from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.session import DeviceProtocol
from hostlink.core.protocol.xrce.framing import FRAMINGS, DatagramFraming, Framing, framing_on
from hostlink.core.protocol.xrce.payloads import Payloads
from hostlink.core.protocol.xrce.resume import read_state
from hostlink.core.protocol.xrce.session import NAME, XrceSession
from hostlink.core.protocol.xrce.wire import NO_STREAM, answer_ping, decode_message, is_create_client, is_in_session


class Xrce(DeviceProtocol):
    """DDS-XRCE on one kind of transport."""

    name: ClassVar[str] = NAME
    writes_in_parts: ClassVar[bool] = True  # on TCP: the length, and the message

    def __init__(
        self, framing: Callable[[], Framing], *, keeps_datagrams: bool = False, velocity_stream: int = NO_STREAM
    ) -> None:
        """`velocity_stream`: as in XrceSession."""
        self.keeps_datagrams = keeps_datagrams
        self._framing, self._velocity_stream = framing, velocity_stream

    @classmethod
    def on(cls, transport: str, *, velocity_stream: int = NO_STREAM) -> "Xrce":
        """Return the protocol on a transport, as Framing.transport names it; on UDP if it is not known."""
        framing = framing_on(transport)
        return cls(framing, keeps_datagrams=issubclass(framing, DatagramFraming), velocity_stream=velocity_stream)

    def session(
        self,
        catalog: Catalog,
        *,
        uart_bytes_s: int | None = None,
        max_topics: int = 256,
        is_lossy: bool = False,
    ) -> XrceSession:
        """Create the session of a new connection."""
        return self.resumed(catalog, "", uart_bytes_s=uart_bytes_s, max_topics=max_topics, is_lossy=is_lossy)

    def resumed(
        self,
        catalog: Catalog,
        memory: str,
        *,
        uart_bytes_s: int | None = None,
        max_topics: int = 256,
        is_lossy: bool = False,  # noqa: ARG002 - losses are repaired on every transport
    ) -> XrceSession:
        """Create the session of a connection that may go on where an earlier one ended."""
        return XrceSession(
            self._framing(),
            Payloads(catalog),
            uart_bytes_s=uart_bytes_s,
            max_topics=max_topics,
            velocity_stream=self._velocity_stream,
            state=read_state(memory),
        )

    def is_greeting(self, data: bytes) -> bool:
        """Whether the bytes create a client."""
        return any(map(is_create_client, self._framing().feed(data)))

    def is_in(self, data: bytes) -> bool:
        """Whether the bytes contain a message of any client, or a ping."""
        return any(decode_message(each) is not None for each in self._framing().feed(data))

    def is_of_other_host(self, data: bytes) -> bool:
        """Whether the bytes are messages of a client that was not created here."""
        messages = self._framing().feed(data)
        return bool(messages) and all(map(is_in_session, messages))

    def answer_ping(self, data: bytes) -> bytes:
        """Return the answer to pings that need no link; empty if there are none."""
        framing = self._framing()
        answers = map(answer_ping, framing.feed(data))
        return b"".join(framing.encode(each) for each in answers if each is not None)


MICRO_ROS_UDP, MICRO_ROS_TCP, MICRO_ROS_SERIAL = (Xrce.on(each.transport) for each in FRAMINGS[:3])
