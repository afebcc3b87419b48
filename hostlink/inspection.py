"""Inspection: content of a capture of a link's bytes in both directions, independent of how the reads were cut.

A capture is JSON lines: {"t": seconds, "dir": "device" | "host", "hex": bytes, "conn": n, "event": "open" | "close"}.
`dir` is the sender; `conn` counts connections; only a line without bytes has an `event`. Lines are ordered by time. The
event `topics` marks that the beginning is lost; its bytes announce the topics of that time.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec

from hostlink.errors import BadPayload, BadRequest, WrongType
from hostlink.messages.catalog import Catalog
from hostlink.messages.message_type import MessageType
from hostlink.protocol.control import (
    Log,
    Parameter,
    TopicInfo,
    decode_log,
    decode_parameter,
    decode_parameter_request,
    decode_topic_info,
)
from hostlink.protocol.frame import FIRST_TOPIC_ID, MAX_PAYLOAD_BYTES, Frame, Id
from hostlink.protocol.stream import DEFAULT_LIMIT_BYTES, FrameStream, Skipped

_REQUESTS = (Id.SERVICE_SERVER_SUBSCRIBER, Id.SERVICE_CLIENT_PUBLISHER)


class Read(msgspec.Struct):
    """One line of a capture."""

    dir: Literal["device", "host"]
    hex: str = ""
    t: float = 0.0
    conn: int = 0
    event: Literal["open", "topics", "close"] | None = None


@dataclass(frozen=True, slots=True)
class Payload:
    """Bytes of a message, and its fields if its type is known and the bytes fit it."""

    data: bytes
    fields: dict[str, Any] | None = None
    error: str = ""


class Series:
    """Message count of a topic, with the first and the last message."""

    def __init__(self, type_: MessageType | None) -> None:
        self.count = 0
        self._type = type_
        self._first = self._last = b""

    def add(self, payload: bytes) -> None:
        """Add a message."""
        if not self.count:
            self._first = payload
        self._last = payload
        self.count += 1

    @property
    def first(self) -> Payload:
        """The first message."""
        return self._decode(self._first)

    @property
    def last(self) -> Payload:
        """The last message."""
        return self._decode(self._last)

    def _decode(self, payload: bytes) -> Payload:
        if self._type is None:
            return Payload(payload)
        try:
            return Payload(payload, self._type.decode(payload))
        except BadPayload as error:
            return Payload(payload, error=str(error))


@dataclass(slots=True)
class ServiceCounts:
    """Message counts of one service."""

    requests: int = 0
    responses: int = 0


@dataclass(slots=True)
class ParameterRequest:
    """Parameter that the device requested; `reply` is None without an answer."""

    name: str
    reply: Parameter | None = None


def load_reads(path: Path) -> Iterator[Read]:
    """Read the lines of a capture.

    Raises:
        BadRequest: the file cannot be read, or a line is not one of a capture; the text names the line.
    """
    decoder = msgspec.json.Decoder(Read)
    try:
        with path.open("rb") as lines:
            for number, line in enumerate(lines, 1):
                if line.strip():
                    yield _read_line(decoder, line, f"{path}:{number}")
    except OSError as error:
        raise BadRequest(f"{path}: {error.strerror}") from error


def _read_line(decoder: "msgspec.json.Decoder[Read]", line: bytes, where: str) -> Read:
    try:
        read = decoder.decode(line)
        bytes.fromhex(read.hex)
    except (msgspec.DecodeError, UnicodeDecodeError, ValueError) as error:
        raise BadRequest(
            f"{where}: not a line of a capture ({error}); `hostlink capture` writes captures, "
            "and `hostlink info` shows recordings"
        ) from error
    return read


class Inspection:
    """Content of a capture: sums over its reads."""

    def __init__(self, catalog: Catalog) -> None:
        self.connections: dict[int, _InspectedConnection] = {}
        self.topics: dict[tuple[Id, int, str], TopicInfo] = {}
        self.messages: dict[str, Series] = {}  # from the device
        self.to_device: dict[str, Series] = {}
        self.services: dict[str, ServiceCounts] = {}  # in the order of first use
        self.parameters: list[ParameterRequest] = []
        self.logs: list[Log] = []
        self.time_requests = 0
        self.skipped_bytes = 0
        self._catalog = catalog

    def add_all(self, reads: Iterable[Read]) -> None:
        """Add every read in order, then the incomplete frames at the end."""
        for read in reads:
            connection = self.connections.get(read.conn)
            if connection is None:
                connection = self.connections[read.conn] = _InspectedConnection(self._fixed_bytes)
            connection.reads += 1
            if read.dir == "device":
                self._add_items(connection, connection.from_device.feed(bytes.fromhex(read.hex)), self._from_device)
            else:
                self._add_items(connection, connection.to_device.feed(bytes.fromhex(read.hex)), self._from_host)
        for connection in self.connections.values():
            self._finish(connection)

    def _add_items(
        self,
        connection: "_InspectedConnection",
        items: Iterator[Frame | Skipped],
        add: Callable[["_InspectedConnection", Frame], None],
    ) -> None:
        for item in items:
            if isinstance(item, Skipped):
                self.skipped_bytes += len(item.data)
            else:
                add(connection, item)

    def _finish(self, connection: "_InspectedConnection") -> None:
        while connection.from_device.pending:
            self._add_items(connection, connection.from_device.give_up(), self._from_device)
        while connection.to_device.pending:
            self._add_items(connection, connection.to_device.give_up(), self._from_host)
        for frame in connection.early:  # sent to the device before the capture shows the meaning of its id
            self._add_message(connection, frame, is_to_device=True)

    def _from_device(self, connection: "_InspectedConnection", frame: Frame) -> None:
        match frame.topic_id:
            case Id.TIME:
                self.time_requests += 1
            case Id.LOG if (log := decode_log(frame.payload)) is not None:
                self.logs.append(log)
            case Id.PARAMETER if (name := decode_parameter_request(frame.payload)) is not None:
                self.parameters.append(ParameterRequest(name))
                connection.request_parameter(self.parameters[-1])
            case kind if kind <= Id.SERVICE_CLIENT_SUBSCRIBER:
                self._add_topic_info(connection, decode_topic_info(Id(kind), frame.payload))
            case topic_id if topic_id >= FIRST_TOPIC_ID:
                self._add_message(connection, frame, is_to_device=False)

    def _add_topic_info(self, connection: "_InspectedConnection", info: TopicInfo | None) -> None:
        if info is not None:
            self.topics.setdefault((info.kind, info.topic_id, info.name), info)
            connection.add_topic(info)

    def _add_message(self, connection: "_InspectedConnection", frame: Frame, *, is_to_device: bool) -> None:
        info = connection.topics.get(frame.topic_id)
        if info is None or info.is_to_device is not is_to_device:
            return
        if info.kind in (Id.PUBLISHER, Id.SUBSCRIBER):
            series = self.to_device if is_to_device else self.messages
            series.setdefault(info.name, Series(self._type_of(info))).add(frame.payload)
            return
        counts = self.services.setdefault(info.name, ServiceCounts())
        if info.kind in _REQUESTS:
            counts.requests += 1
        else:
            counts.responses += 1

    def _from_host(self, connection: "_InspectedConnection", frame: Frame) -> None:
        if frame.topic_id == Id.PARAMETER:
            parameter = decode_parameter(frame.payload)
            if parameter is not None and connection.open_requests:
                connection.open_requests.pop(0).reply = parameter
        elif frame.topic_id in connection.topics:
            self._add_message(connection, frame, is_to_device=True)
        elif frame.topic_id >= FIRST_TOPIC_ID:
            connection.early.append(frame)

    def _type_of(self, info: TopicInfo) -> MessageType | None:
        try:
            return self._catalog.check_message(info.name, info.type, info.md5)
        except WrongType:
            return None

    def _fixed_bytes(self, info: TopicInfo) -> int | None:
        type_ = self._type_of(info) if info.kind in (Id.PUBLISHER, Id.SUBSCRIBER) else None
        return None if type_ is None else type_.fixed_bytes


class _InspectedConnection:
    """Streams and topics of one connection."""

    def __init__(self, fixed_bytes_of: Callable[[TopicInfo], int | None]) -> None:
        self.topics: dict[int, TopicInfo] = {}
        self.reads = 0
        self.open_requests: list[ParameterRequest] = []  # parameter requests without a reply
        self._requested_in_read = 0
        self.early: list[Frame] = []
        self._fixed_bytes_of = fixed_bytes_of
        self._fixed_bytes: dict[int, int] = {}
        self.from_device = FrameStream(fixed_bytes=self._fixed_bytes)
        self.to_device = FrameStream(fixed_bytes=self._fixed_bytes, limit_bytes=MAX_PAYLOAD_BYTES)

    def request_parameter(self, request: ParameterRequest) -> None:
        """Note a parameter request. A device makes one at a time, so requests of earlier reads were given up."""
        if self._requested_in_read != self.reads:
            self.open_requests.clear()
        self._requested_in_read = self.reads
        self.open_requests.append(request)

    def add_topic(self, info: TopicInfo) -> None:
        self.topics[info.topic_id] = info
        fixed_bytes = self._fixed_bytes_of(info)
        if fixed_bytes is None:
            self._fixed_bytes.pop(info.topic_id, None)
        else:
            self._fixed_bytes[info.topic_id] = fixed_bytes
        buffers = (known.buffer_bytes for known in self.topics.values() if not known.is_to_device)
        self.from_device.limit_bytes = max(DEFAULT_LIMIT_BYTES, *buffers, 0)
