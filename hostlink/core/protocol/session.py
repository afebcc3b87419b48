"""DeviceSession and DeviceProtocol: interfaces of device protocols, which links and the hub use."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import ClassVar

from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.serialisation import ROS1
from hostlink.core.protocol.clock import DeviceClock
from hostlink.core.protocol.endpoint import DeviceEndpoint
from hostlink.core.protocol.events import Event, Parameter
from hostlink.core.protocol.link_evidence import Explain, explain_unreadable
from hostlink.core.protocol.outbox import Outbox, OutgoingFrame
from hostlink.core.runtime.compiled import mypyc_attr
from hostlink.core.runtime.stop_frames import StopFrames
from hostlink.errors import FrameTooLarge, HostlinkError


@dataclass(slots=True)
class SessionCounts:
    """Counters of received and sent data and of damage, since the link opened."""

    frames_from_device: int = 0
    frames_to_device: int = 0
    bytes_from_device: int = 0
    bytes_to_device: int = 0
    skipped_bytes: int = 0
    unknown_ids: int = 0
    refused_frames: int = 0  # frames with an id that only the host may use, or of a refused topic
    malformed: int = 0  # control frames with an undecodable payload
    excess_topics: int = 0  # topics above max_topics
    negotiations: int = 0
    topic_requests: int = 0
    lost_messages: int = 0  # of the device, lost on their way: where its messages have numbers


@mypyc_attr(allow_interpreted_subclasses=True)
class DeviceSession(ABC):
    """State of one device's protocol, host side: bytes and times in, events and frames out. No I/O and no clock.

    All times are of one monotonic clock, in seconds. Methods raise the errors of hostlink that they name, and nothing
    for what a device sends, however damaged it is.
    """

    def __init__(self, protocol: str, outbox: Outbox) -> None:
        """`protocol`: name of its DeviceProtocol."""
        self.protocol = protocol
        self.counts = SessionCounts()
        self.device_clock = DeviceClock()
        self.outbox = outbox  # the link reads when its next frame may be sent
        self.too_large = ""  # text about the last message that was refused for its size
        self.foreign = b""  # the last bytes that are not of the protocol

    # -- what the link reports ----------------------------------------------------------------------------------------

    @abstractmethod
    def open(self, *, now_s: float) -> list[Event]:
        """Begin a new connection."""

    @abstractmethod
    def receive(self, data: bytes, *, now_s: float) -> list[Event]:
        """Process bytes from the device."""

    def note_host_pause(self, paused_s: float) -> None:  # noqa: B027 - for protocols that measure the device's silence
        """Learn, before the bytes of `receive`, for how long the host itself did not run since the bytes before them.

        Only a session that is not steady is told.
        """

    @abstractmethod
    def tick(self, *, now_s: float) -> list[Event]:
        """Do what is due by now. Call it at `deadline_s`."""

    @abstractmethod
    def deadline_s(self) -> float:
        """Time at which `tick` must be called if no byte arrives before."""

    @property
    @abstractmethod
    def is_steady(self) -> bool:
        """Whether `deadline_s` moves only later for as long as this is so."""

    @property
    def is_regular(self) -> bool:
        """Whether a live device of this kind would have sent something within a few seconds."""
        return False

    def is_crowded(self, data: bytes) -> bool:  # noqa: ARG002 - for protocols with short messages
        """Whether the bytes hold so many messages that others would wait for too long while they are read at once."""
        return False

    def pop_frame(self, *, now_s: float, wall_ns: int) -> OutgoingFrame | None:
        """Remove and return the next frame. None: the queues are empty, or the device's UART is busy."""
        outgoing = self.outbox.pop_frame(now_s=now_s, wall_ns=wall_ns)
        if outgoing is not None:
            self.counts.frames_to_device += 1
            self.counts.bytes_to_device += len(outgoing.frame)
        return outgoing

    @property
    def captured_as(self) -> str:
        """Name by which the protocol of a capture is found again."""
        return self.protocol

    @property
    def bad_checksums(self) -> int:
        """Number of rejected frame starts with a wrong checksum."""
        return 0

    @property
    def wrong_sizes(self) -> int:
        """Number of messages whose size is not that of their type."""
        return 0

    @property
    def is_outdated(self) -> bool:
        """Whether the device speaks an older version of the protocol, which is not understood."""
        return False

    def too_small(self, least_bytes: Callable[[str], int]) -> list[str]:  # noqa: ARG002 - for protocols with buffers
        """Say which topics exceed a buffer of the device. `least_bytes` returns the smallest size of a type, or 0."""
        return []

    @property
    def own_counts(self) -> tuple[int, ...]:
        """Counters of this protocol alone, since the link opened. `explain` gets those of the last seconds."""
        return ()

    @property
    def explain(self) -> Explain:
        """Rules of this protocol, with what the session has now: they say what is wrong, and may run in a thread."""
        return explain_unreadable

    def rest_of_frame_bytes(self, pieces: Iterable[bytes]) -> int:  # noqa: ARG002 - for protocols without frames
        """Number of bytes before the first whole frame of captured bytes whose beginning is lost."""
        return 0

    @property
    def rejected(self) -> dict[str, int]:
        """Number of rejected frame starts, by cause."""
        return {}

    # -- what the device is -------------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def topics(self) -> tuple[DeviceEndpoint, ...]:
        """The usable endpoints of the last announcement."""

    @property
    def node(self) -> str:
        """Name of the device's node in ROS, with its namespace; empty where a protocol has none."""
        return ""

    @property
    def refusals(self) -> tuple[tuple[DeviceEndpoint, HostlinkError], ...]:
        """Endpoints that cannot be used, with the reason."""
        return ()

    def is_refused(self, endpoint: DeviceEndpoint) -> bool:  # noqa: ARG002 - for protocols that check types
        """Whether this endpoint was refused because of its type."""
        return False

    @property
    def raw_encoding(self) -> str:
        """Serialisation in which messages of a type without a definition pass: ROS1, or CDR with its encapsulation."""
        return ROS1

    @abstractmethod
    def has(self, endpoint: DeviceEndpoint) -> bool:
        """Whether the device still has this endpoint."""

    def may_have(self, endpoint: DeviceEndpoint) -> bool:
        """Whether the device may still have this endpoint although a damaged announcement lacks it."""
        return self.has(endpoint)

    @abstractmethod
    def announcement(self, endpoints: Iterable[DeviceEndpoint]) -> bytes:
        """Return the bytes with which the device announces these, for the beginning of a capture."""

    @property
    def is_recalled(self) -> bool:
        """Whether it has a `memory` and `kept_bytes`, at which the hub looks several times a second."""
        return False

    @property
    def memory_version(self) -> int:
        """Number that changes when `memory` is worth keeping; 0: never yet."""
        return 0

    def memory(self) -> str:
        """Return what `DeviceProtocol.resumed` needs to go on later, for a device that announces itself only once."""
        return ""

    @property
    def kept_bytes(self) -> int:
        """Bytes from the device that are kept because more must follow, and that it made the host remember."""
        return 0

    def drop_unfinished(self) -> None:  # noqa: B027 - for protocols that keep some
        """Forget messages that are not whole."""

    def probe(self) -> None:  # noqa: B027 - for protocols that can ask
        """Ask something that a working device answers (TopicsAnswered), at most once a second.

        Where a protocol has no such thing, only the device's silence tells whether it is alive.
        """

    # -- what the hub sends -------------------------------------------------------------------------------------------

    @abstractmethod
    def publish(
        self, topic: str, payload: bytes, *, depth: int = 1, is_urgent: bool = False, is_kept: bool = False
    ) -> None:
        """Queue a message to the device. The newest `depth` wait; an urgent one precedes what is not.

        Raises:
            UnknownTopic: the device does not subscribe to it.
            WrongType: the payload has not the size of the topic's type, or the topic was refused.
            FrameTooLarge: the device's buffer is smaller, or a stop would wait behind the frame.
        """

    def drop_commands(self, endpoint: DeviceEndpoint) -> None:
        """Send no message of an endpoint that waits: it would follow a zero."""
        self.outbox.drop_commands(endpoint.id)

    @abstractmethod
    def endpoint_of(self, topic: str, payload: bytes) -> DeviceEndpoint:
        """Return the endpoint of a topic to which the device subscribes. It takes messages as long as this one.

        Raises:
            HostlinkError: as from `publish`.
        """

    @abstractmethod
    def service_endpoint(self, service: str, payload: bytes) -> DeviceEndpoint:
        """Return the endpoint that takes the requests to a service of the device. It takes one as long as this one.

        Raises:
            HostlinkError: as from `call`.
        """

    @abstractmethod
    def call(self, service: str, payload: bytes) -> bytes | None:
        """Queue a request to a service of the device. Return its identity, which `ServiceResponded` has.

        None: the device's answers have no identity. Then an answer that is late must not be taken for the next one.

        Raises:
            UnknownTopic: the device has no such service.
            WrongType: the payload has not the size of the request's type, or the service was refused.
            FrameTooLarge: the device's buffer is smaller, or a stop would wait behind the frame.
            DeviceBusy: too many requests and responses wait.
        """

    def number_calls(self, first: int) -> None:  # noqa: B027 - for protocols whose calls have numbers
        """Give the next call this number, of any size: an answer to an earlier daemon's call must not be that to it."""

    @abstractmethod
    def response_endpoint(self, request: DeviceEndpoint) -> DeviceEndpoint:
        """Return the endpoint at which the device receives the response to a request of this endpoint.

        Raises:
            UnknownTopic: the device announced no such endpoint.
        """

    @abstractmethod
    def respond(self, response: DeviceEndpoint, payload: bytes | None, *, request: bytes | None = None) -> None:
        """Queue a response to a request of the device; None: its layout is unknown.

        `request` is the identity from `ServiceRequested`. It is not passed to a session whose requests have none.

        Raises:
            FrameTooLarge: the device's buffer is smaller.
            DeviceBusy: too many requests and responses wait.
        """

    def is_waiting_for(self, service: DeviceEndpoint, request: bytes) -> bool:  # noqa: ARG002 - for those with identity
        """Whether the device still waits for the response to a request with this identity, at a service of the host."""
        return True

    def leave_unanswered(self, service: DeviceEndpoint, request: bytes) -> None:  # noqa: B027 - for those with identity
        """Forget a request with this identity: its response cannot be sent."""

    @abstractmethod
    def room_bytes(self, endpoint: DeviceEndpoint) -> int:
        """Longest payload that the device takes at an endpoint."""

    def too_long(self, endpoint: DeviceEndpoint, payload_bytes: int) -> FrameTooLarge:
        """Return the error about a payload that exceeds the room of an endpoint."""
        return FrameTooLarge(endpoint.name, payload_bytes, self.room_bytes(endpoint))

    @abstractmethod
    def answer_parameter(self, name: str, parameter: Parameter) -> None:
        """Queue the answer to a parameter request. An empty Parameter means that the parameter does not exist.

        Raises:
            WrongType: a number is outside the range that the protocol can carry.
            FrameTooLarge: the smallest buffer of the device is smaller.
            DeviceBusy: too many requests and responses wait.
        """

    def stop(self) -> None:
        """Queue the request to stop sending, after the urgent commands. It is the last frame of the session."""
        self.outbox.put_stop()

    # -- how the device is stopped ------------------------------------------------------------------------------------

    @abstractmethod
    def send_zero(self, endpoint: DeviceEndpoint, payload: bytes, *, is_kept: bool = False) -> bool:
        """Queue a zero for an endpoint that has taken one before, if the device `may_have` it. Return whether so."""

    @abstractmethod
    def zero_frames(self, endpoint: DeviceEndpoint, payload: bytes) -> tuple[bytes, ...]:
        """Return messages that stop an endpoint and may be sent at any time and again: mostly one."""

    def stop_frames(self, zeros: tuple[bytes, ...]) -> StopFrames:
        """Return these `zero_frames`, and how the link's end or the guardian writes them when the session cannot."""
        return StopFrames(zeros, self.outbox.control.end)


@mypyc_attr(allow_interpreted_subclasses=True)
class DeviceProtocol(ABC):
    """A protocol that devices speak: creates the session of each connection, and knows its bytes without a session."""

    name: ClassVar[str]
    invitation: ClassVar[bytes] = b""  # sent to a silent device of a datagram port, which then begins
    keeps_datagrams = False  # whether a session gets each datagram whole and by itself
    # Devices send one message with several writes, and wait for the acknowledgement of each.
    writes_in_parts: ClassVar[bool] = False

    @abstractmethod
    def session(
        self, catalog: Catalog, *, uart_bytes_s: int | None = None, max_topics: int = 256, is_lossy: bool = False
    ) -> DeviceSession:
        """Create the session of a new connection. `is_lossy`: the transport may lose messages without a trace."""

    def resumed(
        self,
        catalog: Catalog,
        memory: str,  # noqa: ARG002 - for protocols whose devices announce themselves only once
        *,
        uart_bytes_s: int | None = None,
        max_topics: int = 256,
        is_lossy: bool = False,
    ) -> DeviceSession:
        """Create the session of a connection that may go on where the one with this memory ended. It may be damaged."""
        return self.session(catalog, uart_bytes_s=uart_bytes_s, max_topics=max_topics, is_lossy=is_lossy)

    def host_reader(self) -> Callable[[bytes], int]:
        """Return a reader of a captured host's bytes: it counts the requests to the device to announce itself."""
        return lambda _: 0

    @abstractmethod
    def is_greeting(self, data: bytes) -> bool:
        """Whether a datagram of an unknown sender is of this protocol."""

    def is_in(self, data: bytes) -> bool:
        """Whether bytes of a serial port contain a whole message of this protocol."""
        return self.is_greeting(data)

    def is_of_other_host(self, data: bytes) -> bool:  # noqa: ARG002 - for protocols whose devices begin a session
        """Whether a datagram is of a session that was not begun here: that of another host, or of an earlier daemon."""
        return False

    def answer_ping(self, data: bytes) -> bytes:  # noqa: ARG002 - for protocols with a question that needs no session
        """Return the answer to a datagram that asks only whether a host is there; empty: it asks something else."""
        return b""
