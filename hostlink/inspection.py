"""Inspection: what a recording of a link's bytes says, both directions, however its reads cut them.

A recording is JSON lines: {"t": seconds, "dir": "device" | "host", "hex": bytes, "conn": n, "event": "open" | "close"}.
`dir` is who sent; `conn` counts connections; only a line without bytes has an `event`. Reads stand in order of time.
"""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Literal

import msgspec

from hostlink.errors import BadPayload, BadRequest, WrongType
from hostlink.messages.catalog import Catalog
from hostlink.messages.message_type import MessageType
from hostlink.protocol.control import (
    Parameter,
    TopicInfo,
    decode_log,
    decode_parameter,
    decode_parameter_request,
    decode_topic_info,
)
from hostlink.protocol.frame import FIRST_TOPIC_ID, MAX_PAYLOAD_BYTES, Frame, Id
from hostlink.protocol.stream import DEFAULT_LIMIT_BYTES, FrameStream, Skipped

KINDS = {
    Id.PUBLISHER: "publisher",
    Id.SUBSCRIBER: "subscriber",
    Id.SERVICE_SERVER_PUBLISHER: "service_server",
    Id.SERVICE_SERVER_SUBSCRIBER: "service_server",
    Id.SERVICE_CLIENT_PUBLISHER: "service_client",
    Id.SERVICE_CLIENT_SUBSCRIBER: "service_client",
}


class Read(msgspec.Struct):
    """One line of a recording."""

    dir: Literal["device", "host"]
    hex: str = ""
    t: float = 0.0
    conn: int = 0
    event: Literal["open", "close"] | None = None


def load_reads(path: Path) -> Iterator[Read]:
    """The lines of a recording; BadRequest names the line that is none."""
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
        raise BadRequest(f"{where}: no line of a recording: {error}") from error
    return read


class Inspection:
    """Adds up what the reads of a recording say; `report` is the sum."""

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog
        self._connections: dict[int, _Connection] = {}
        self._topics: dict[tuple[Id, int, str], TopicInfo] = {}
        self._messages: dict[str, _Series] = {}
        self._to_device: dict[str, _Series] = {}
        self._services: dict[str, dict[str, int]] = {}
        self._parameters: list[dict[str, Any]] = []
        self._logs: list[dict[str, Any]] = []
        self._time_requests = 0
        self._skipped_bytes = 0

    def take_all(self, reads: Iterable[Read]) -> None:
        """Take every read, in order, then what is left over at the end."""
        for read in reads:
            connection = self._connections.get(read.conn)
            if connection is None:
                connection = self._connections[read.conn] = _Connection(self._fixed_bytes)
            connection.reads += 1
            if read.dir == "device":
                self._take_items(connection, connection.from_device.feed(bytes.fromhex(read.hex)), self._from_device)
            else:
                self._take_items(connection, connection.to_device.feed(bytes.fromhex(read.hex)), self._from_host)
        for connection in self._connections.values():
            self._finish(connection)

    def report(self) -> dict[str, Any]:
        """The whole recording in one object for JSON; NaN is the string "NaN"."""
        return {
            "topics": [_topic_view(info) for info in self._topics.values()],
            "messages": {name: series.view() for name, series in self._messages.items()},
            "to_device": {name: series.view() for name, series in self._to_device.items()},
            "logs": self._logs,
            "parameters": self._parameters,
            "services": self._services,
            "time_requests": self._time_requests,
            "skipped_bytes": self._skipped_bytes,
            "connections": len(self._connections),
        }

    def _take_items(
        self,
        connection: "_Connection",
        items: Iterator[Frame | Skipped],
        take: Callable[["_Connection", Frame], None],
    ) -> None:
        for item in items:
            if isinstance(item, Skipped):
                self._skipped_bytes += len(item.data)
            else:
                take(connection, item)

    def _finish(self, connection: "_Connection") -> None:
        while connection.from_device.pending_bytes:
            self._take_items(connection, connection.from_device.give_up(), self._from_device)
        while connection.to_device.pending_bytes:
            self._take_items(connection, connection.to_device.give_up(), self._from_host)
        for frame in connection.early:  # went to the device before the recording shows what its id means
            self._message_to_device(connection, frame)

    def _from_device(self, connection: "_Connection", frame: Frame) -> None:
        match frame.topic_id:
            case Id.TIME:
                self._time_requests += 1
            case Id.LOG if (log := decode_log(frame.payload)) is not None:
                self._logs.append({"level": log.level, "msg": log.text})
            case Id.PARAMETER if (name := decode_parameter_request(frame.payload)) is not None:
                self._parameters.append({"name": name, "reply": None})
                connection.ask(self._parameters[-1])
            case kind if kind <= Id.SERVICE_CLIENT_SUBSCRIBER:
                self._take_topic_info(connection, decode_topic_info(Id(kind), frame.payload))
            case topic_id if topic_id >= FIRST_TOPIC_ID:
                self._message_from_device(connection, frame)

    def _take_topic_info(self, connection: "_Connection", info: TopicInfo | None) -> None:
        if info is not None:
            self._topics.setdefault((info.kind, info.topic_id, info.name), info)
            connection.learn(info)

    def _message_from_device(self, connection: "_Connection", frame: Frame) -> None:
        info = connection.topics.get(frame.topic_id)
        if info is None or info.is_to_device:
            return
        if info.kind is Id.PUBLISHER:
            self._messages.setdefault(info.name, _Series(self._type_of(info))).add(frame.payload)
        elif info.kind is Id.SERVICE_SERVER_PUBLISHER:
            self._count(info.name, "responses")
        else:
            self._count(info.name, "requests")

    def _from_host(self, connection: "_Connection", frame: Frame) -> None:
        if frame.topic_id == Id.PARAMETER:
            parameter = decode_parameter(frame.payload)
            if parameter is not None and connection.parameter_questions:
                connection.parameter_questions.pop(0)["reply"] = _parameter_view(parameter)
        elif frame.topic_id in connection.topics:
            self._message_to_device(connection, frame)
        elif frame.topic_id >= FIRST_TOPIC_ID:
            connection.early.append(frame)

    def _message_to_device(self, connection: "_Connection", frame: Frame) -> None:
        info = connection.topics.get(frame.topic_id)
        if info is None or not info.is_to_device:
            return
        if info.kind is Id.SUBSCRIBER:
            self._to_device.setdefault(info.name, _Series(self._type_of(info))).add(frame.payload)
        elif info.kind is Id.SERVICE_SERVER_SUBSCRIBER:
            self._count(info.name, "requests")
        else:
            self._count(info.name, "responses")

    def _count(self, service: str, what: str) -> None:
        self._services.setdefault(service, {"requests": 0, "responses": 0})[what] += 1

    def _type_of(self, info: TopicInfo) -> MessageType | None:
        try:
            return self._catalog.check_message(info.name, info.type, info.md5)
        except WrongType:
            return None

    def _fixed_bytes(self, info: TopicInfo) -> int | None:
        type_ = self._type_of(info) if info.kind in (Id.PUBLISHER, Id.SUBSCRIBER) else None
        return None if type_ is None else type_.fixed_bytes


class _Connection:
    """The streams and topics of one connection."""

    def __init__(self, fixed_bytes_of: Callable[[TopicInfo], int | None]) -> None:
        self.topics: dict[int, TopicInfo] = {}
        self.reads = 0
        self.parameter_questions: list[dict[str, Any]] = []  # without an answer yet
        self._asked_in_read = 0
        self.early: list[Frame] = []
        self._fixed_bytes_of = fixed_bytes_of
        self._fixed_bytes: dict[int, int] = {}
        self.from_device = FrameStream(fixed_bytes=self._fixed_bytes)
        self.to_device = FrameStream(fixed_bytes=self._fixed_bytes, limit_bytes=MAX_PAYLOAD_BYTES)

    def ask(self, question: dict[str, Any]) -> None:
        """The device asks for one parameter at a time: a question of an earlier read was given up."""
        if self._asked_in_read != self.reads:
            self.parameter_questions.clear()
        self._asked_in_read = self.reads
        self.parameter_questions.append(question)

    def learn(self, info: TopicInfo) -> None:
        self.topics[info.topic_id] = info
        fixed_bytes = self._fixed_bytes_of(info)
        if fixed_bytes is None:
            self._fixed_bytes.pop(info.topic_id, None)
        else:
            self._fixed_bytes[info.topic_id] = fixed_bytes
        buffers = (known.buffer_bytes for known in self.topics.values() if not known.is_to_device)
        self.from_device.limit_bytes = max(DEFAULT_LIMIT_BYTES, *buffers, 0)


class _Series:
    """How many messages of a topic, and the first and the last of them."""

    def __init__(self, type_: MessageType | None) -> None:
        self._type = type_
        self._count = 0
        self._first = self._last = b""

    def add(self, payload: bytes) -> None:
        if not self._count:
            self._first = payload
        self._last = payload
        self._count += 1

    def view(self) -> dict[str, Any]:
        return {"count": self._count, "first": self._show(self._first), "last": self._show(self._last)}

    def _show(self, payload: bytes) -> Any:
        if self._type is None:
            return {"hex": payload.hex()}
        try:
            return speakable(self._type.decode(payload))
        except BadPayload as error:
            return {"hex": payload.hex(), "error": str(error)}


def speakable(value: Any) -> Any:
    """A decoded value for JSON: NaN and the infinities as strings, everything else as it is."""
    if isinstance(value, dict):
        return {key: speakable(item) for key, item in value.items()}
    if isinstance(value, list):
        return [speakable(item) for item in value]
    if isinstance(value, float) and value - value != 0:
        return {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}[str(value)]
    return value


def _topic_view(info: TopicInfo) -> dict[str, Any]:
    return {
        "kind": KINDS[info.kind],
        "id": info.topic_id,
        "name": info.name,
        "type": info.type,
        "md5": info.md5,
        "buffer_size": info.buffer_bytes,
    }


def _parameter_view(parameter: Parameter) -> dict[str, Any]:
    return {key: list(getattr(parameter, key)) for key in ("ints", "floats", "strings")}
