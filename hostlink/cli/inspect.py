"""`hostlink inspect`: decode the recorded bytes of a link."""

import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from hostlink.cli.connecting import counted
from hostlink.cli.files import MessageFolders
from hostlink.cli.output import fitted_table, write
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.message_type import MessageType
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind, to_device_key
from hostlink.core.protocol.events import (
    Event,
    MessageReceived,
    Parameter,
    ServiceRequested,
    ServiceResponded,
    TimeRequested,
    TopicsNegotiated,
)
from hostlink.core.protocol.registry import find_protocol
from hostlink.core.protocol.rosserial.control import (
    decode_log,
    decode_parameter,
    decode_parameter_request,
    decode_topic_info,
)
from hostlink.core.protocol.rosserial.frame import FIRST_TOPIC_ID, MAX_PAYLOAD_BYTES, Frame, Id
from hostlink.core.protocol.rosserial.session import NAME as ROSSERIAL
from hostlink.core.protocol.rosserial.stream import DEFAULT_LIMIT_BYTES, FrameStream, Skipped
from hostlink.core.protocol.session import DeviceSession
from hostlink.core.runtime.capture_file import Read, load_reads
from hostlink.errors import BadPayload, WrongType

LAST_LOGS = 8
_KINDS = {
    EndpointKind.PUBLISHER: "publisher",
    EndpointKind.SUBSCRIBER: "subscriber",
    EndpointKind.SERVICE_SERVER_PUBLISHER: "service_server",
    EndpointKind.SERVICE_SERVER_SUBSCRIBER: "service_server",
    EndpointKind.SERVICE_CLIENT_PUBLISHER: "service_client",
    EndpointKind.SERVICE_CLIENT_SUBSCRIBER: "service_client",
}
_REQUESTS = (EndpointKind.SERVICE_SERVER_SUBSCRIBER, EndpointKind.SERVICE_CLIENT_PUBLISHER)


def command(
    file: Annotated[Path, typer.Argument(help="Capture of `hostlink capture`: JSON lines with t, dir, hex, conn.")],
    *,
    messages: MessageFolders = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object, for programs.")] = False,
) -> None:
    """Decode a capture of a link in both directions, also when reads split the frames."""
    inspection = Inspection(Catalog(messages or ()))
    inspection.add_all(counted(load_reads(file), "lines"))
    view = inspection.view()
    if json:
        write(msgspec.json.encode(view).decode())
    else:
        write(*inspection_lines(view))


# -- inspection -------------------------------------------------------------------------------------------------------


class Series:
    """Message count of a topic, with the first and the last message."""

    def __init__(self, type_: MessageType | None) -> None:
        self._type = type_
        self._count = 0
        self._first = self._last = b""

    def add(self, payload: bytes) -> None:
        """Add a message."""
        if not self._count:
            self._first = payload
        self._last = payload
        self._count += 1

    def view(self) -> dict[str, Any]:
        """Return the count and the two messages for JSON."""
        return {"count": self._count, "first": self._decode(self._first), "last": self._decode(self._last)}

    def _decode(self, payload: bytes) -> Any:
        """Return the fields; the bytes if the type is not known, or they do not fit it."""
        if self._type is None:
            return {"hex": payload.hex()}
        try:
            return json_value(self._type.decode(payload))
        except BadPayload as error:
            return {"hex": payload.hex(), "error": str(error)}


class Inspection:
    """Content of a capture, independent of how the reads were cut: sums over its reads."""

    def __init__(self, catalog: Catalog) -> None:
        self._connections: dict[int, _InspectedConnection] = {}
        self._topics: dict[tuple[EndpointKind, int, str], DeviceEndpoint] = {}
        self._messages: dict[str, Series] = {}  # from the device
        self._to_device: dict[str, Series] = {}
        self._services: dict[str, dict[str, int]] = {}  # in the order of first use
        self._parameters: list[dict[str, Any]] = []
        self._logs: list[dict[str, Any]] = []
        self._time_requests = 0
        self._skipped_bytes = 0
        self._catalog = catalog
        self._others: dict[int, DeviceSession] = {}  # of connections with another protocol than rosserial

    def add_all(self, reads: Iterable[Read]) -> None:
        """Add every read in order, then the incomplete frames at the end."""
        for read in reads:
            if read.conn in self._others or read.protocol != ROSSERIAL:
                self._add_other(read)
                continue
            connection = self._connections.get(read.conn)
            if connection is None:
                connection = self._connections[read.conn] = _InspectedConnection(self._fixed_bytes)
            connection.reads += 1
            if read.dir == "device":
                self._add_items(connection, connection.from_device.feed(bytes.fromhex(read.hex)), self._from_device)
            else:
                self._add_items(connection, connection.to_device.feed(bytes.fromhex(read.hex)), self._from_host)
        for connection in self._connections.values():
            self._finish(connection)
        for session in self._others.values():
            self._skipped_bytes += session.counts.skipped_bytes

    def _add_other(self, read: Read) -> None:
        """Add a read of a connection of another protocol: what the device announced and sent."""
        session = self._others.get(read.conn)
        if session is None:
            session = self._others[read.conn] = find_protocol(read.protocol).session(self._catalog)
            session.open(now_s=read.t)
        found = session.tick(now_s=read.t) if session.deadline_s() <= read.t else []
        if read.dir == "device" and read.hex:
            found += session.receive(bytes.fromhex(read.hex), now_s=read.t)
        for event in found:
            self._add_event(event)

    def _add_event(self, event: Event) -> None:
        match event:
            case TopicsNegotiated():
                self._topics |= {(info.kind, info.id, info.name): info for info in event.topics}
            case MessageReceived():
                info = event.topic
                self._messages.setdefault(info.name, Series(self._type_of(info))).add(event.payload)
            case ServiceRequested() | ServiceResponded():
                name = event.service.name
                counts = self._services.setdefault(name, {"requests": 0, "responses": 0})
                counts["requests" if isinstance(event, ServiceRequested) else "responses"] += 1
            case TimeRequested():
                self._time_requests += 1

    def view(self) -> dict[str, Any]:
        """Return the whole capture as one JSON object."""
        return {
            "topics": [_topic_view(info) for info in self._topics.values()],
            "messages": {name: series.view() for name, series in self._messages.items()},
            "to_device": {name: series.view() for name, series in self._to_device.items()},
            "logs": self._logs,
            "parameters": self._parameters,
            "services": self._services,
            "time_requests": self._time_requests,
            "skipped_bytes": self._skipped_bytes,
            "connections": len(self._connections) + len(self._others),
            "protocols": self._protocols(),
        }

    def _protocols(self) -> list[str]:
        own = [ROSSERIAL] if self._connections else []
        return sorted({*own, *(each.protocol for each in self._others.values())})

    def _add_items(
        self,
        connection: "_InspectedConnection",
        items: Iterator[Frame | Skipped],
        add: Callable[["_InspectedConnection", Frame], None],
    ) -> None:
        for item in items:
            if isinstance(item, Skipped):
                self._skipped_bytes += len(item.data)
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
                self._time_requests += 1
            case Id.LOG if (log := decode_log(frame.payload)) is not None:
                self._logs.append({"level": log.level, "msg": log.text})
            case Id.PARAMETER if (name := decode_parameter_request(frame.payload)) is not None:
                self._parameters.append({"name": name, "reply": None})
                connection.request_parameter(self._parameters[-1])
            case kind if kind <= EndpointKind.SERVICE_CLIENT_SUBSCRIBER:
                self._add_topic_info(connection, decode_topic_info(EndpointKind(kind), frame.payload))
            case topic_id if topic_id >= FIRST_TOPIC_ID:
                self._add_message(connection, frame, is_to_device=False)

    def _add_topic_info(self, connection: "_InspectedConnection", info: DeviceEndpoint | None) -> None:
        if info is not None:
            self._topics.setdefault((info.kind, info.id, info.name), info)
            connection.add_topic(info)

    def _add_message(self, connection: "_InspectedConnection", frame: Frame, *, is_to_device: bool) -> None:
        info = connection.topics.get(to_device_key(frame.topic_id) if is_to_device else frame.topic_id)
        if info is None:
            return
        if info.kind in (EndpointKind.PUBLISHER, EndpointKind.SUBSCRIBER):
            series = self._to_device if is_to_device else self._messages
            series.setdefault(info.name, Series(self._type_of(info))).add(frame.payload)
            return
        counts = self._services.setdefault(info.name, {"requests": 0, "responses": 0})
        counts["requests" if info.kind in _REQUESTS else "responses"] += 1

    def _from_host(self, connection: "_InspectedConnection", frame: Frame) -> None:
        if frame.topic_id == Id.PARAMETER:
            parameter = decode_parameter(frame.payload)
            if parameter is not None and connection.open_requests:
                connection.open_requests.pop(0)["reply"] = _parameter_view(parameter)
        elif to_device_key(frame.topic_id) in connection.topics:
            self._add_message(connection, frame, is_to_device=True)
        elif frame.topic_id >= FIRST_TOPIC_ID:
            connection.early.append(frame)

    def _type_of(self, info: DeviceEndpoint) -> MessageType | None:
        if not info.md5:  # a protocol that tells none
            return self._catalog.message(info.type)
        try:
            return self._catalog.check_message(info.name, info.type, info.md5)
        except WrongType:
            return None

    def _fixed_bytes(self, info: DeviceEndpoint) -> int | None:
        type_ = self._type_of(info) if info.kind in (EndpointKind.PUBLISHER, EndpointKind.SUBSCRIBER) else None
        return None if type_ is None else type_.fixed_bytes


class _InspectedConnection:
    """Streams and topics of one connection."""

    def __init__(self, fixed_bytes_of: Callable[[DeviceEndpoint], int | None]) -> None:
        self.topics: dict[int, DeviceEndpoint] = {}  # by `TopicInfo.key`
        self.reads = 0
        self.open_requests: list[dict[str, Any]] = []  # parameter requests without a reply
        self._requested_in_read = 0
        self.early: list[Frame] = []
        self._fixed_bytes_of = fixed_bytes_of
        self._fixed_from_device: dict[int, int] = {}
        self._fixed_to_device: dict[int, int] = {}
        self.from_device = FrameStream(fixed_bytes=self._fixed_from_device)
        self.to_device = FrameStream(fixed_bytes=self._fixed_to_device, limit_bytes=MAX_PAYLOAD_BYTES)

    def request_parameter(self, request: dict[str, Any]) -> None:
        """Note a parameter request. A device makes one at a time, so requests of earlier reads were given up."""
        if self._requested_in_read != self.reads:
            self.open_requests.clear()
        self._requested_in_read = self.reads
        self.open_requests.append(request)

    def add_topic(self, info: DeviceEndpoint) -> None:
        self.topics[info.key] = info
        fixed_bytes = self._fixed_bytes_of(info)
        known = self._fixed_to_device if info.is_to_device else self._fixed_from_device
        if fixed_bytes is None:
            known.pop(info.id, None)
        else:
            known[info.id] = fixed_bytes
        buffers = (known.buffer_bytes for known in self.topics.values() if not known.is_to_device)
        self.from_device.limit_bytes = max(DEFAULT_LIMIT_BYTES, *buffers, 0)


def _topic_view(info: DeviceEndpoint) -> dict[str, Any]:
    return {
        "kind": _KINDS[info.kind],
        "id": info.id,
        "name": info.name,
        "type": info.type,
        "md5": info.md5,
        "buffer_size": info.buffer_bytes,
    }


def _parameter_view(parameter: Parameter) -> dict[str, list[Any]]:
    return {"ints": list(parameter.ints), "floats": list(parameter.floats), "strings": list(parameter.strings)}


def json_value(value: Any) -> Any:
    """Return a decoded value for JSON, with NaN and the infinities as strings."""
    if isinstance(value, dict):
        return {key: json_value(item) for key, item in value.items()}
    if isinstance(value, list):
        return [json_value(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}[str(value)]
    return value


# -- text -------------------------------------------------------------------------------------------------------------


def inspection_lines(view: dict[str, Any]) -> list[str]:
    """Return the lines of an inspection's view for people."""
    lines = [
        f"connections {view['connections']}   {', '.join(view['protocols']) or 'no protocol'}   "
        f"time requests {view['time_requests']}   skipped bytes {view['skipped_bytes']}"
    ]
    ids: dict[tuple[str, str, str], list[str]] = {}  # a service has two: requests and responses
    for topic in view["topics"]:
        ids.setdefault((topic["kind"], topic["name"], topic["type"]), []).append(str(topic["id"]))
    topics = [[", ".join(numbers), *topic] for topic, numbers in ids.items()]
    lines += fitted_table(["id", "kind", "topic", "type"], topics)
    for title, key in (("from device", "messages"), ("to device", "to_device")):
        series = view[key].items()
        lines += fitted_table(
            [title, "count", "last"], [[name, item["count"], _short(item["last"])] for name, item in series]
        )
    services = view["services"].items()
    lines += fitted_table(
        ["service", "requests", "responses"], [[name, item["requests"], item["responses"]] for name, item in services]
    )
    lines += fitted_table(
        ["parameter", "reply"], [[item["name"], _short(item["reply"])] for item in view["parameters"]]
    )
    logs = view["logs"][-LAST_LOGS:]
    return lines + fitted_table(
        ["level", f"log, the last of {len(view['logs'])} lines"], [[each["level"], each["msg"]] for each in logs]
    )


def _short(value: Any) -> str:
    text = msgspec.json.encode(value).decode()
    return text if len(text) <= 100 else text[:97] + "..."  # noqa: PLR2004 - the length of a line
