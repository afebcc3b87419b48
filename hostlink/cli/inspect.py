"""`hostlink inspect`: decode the recorded bytes of a link."""

import dataclasses
import math
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from hostlink.cli.connecting import counted
from hostlink.cli.files import MessageFolders
from hostlink.cli.output import fitted_table, write
from hostlink.inspection import Inspection, Payload, Series, load_reads
from hostlink.messages.catalog import Catalog
from hostlink.protocol.control import Parameter, TopicInfo
from hostlink.protocol.frame import Id

LAST_LOGS = 8
_KINDS = {
    Id.PUBLISHER: "publisher",
    Id.SUBSCRIBER: "subscriber",
    Id.SERVICE_SERVER_PUBLISHER: "service_server",
    Id.SERVICE_SERVER_SUBSCRIBER: "service_server",
    Id.SERVICE_CLIENT_PUBLISHER: "service_client",
    Id.SERVICE_CLIENT_SUBSCRIBER: "service_client",
}


def command(
    file: Annotated[Path, typer.Argument(help="Capture of `hostlink capture`: JSON lines with t, dir, hex, conn.")],
    *,
    messages: MessageFolders = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object, for programs.")] = False,
) -> None:
    """Decode a capture of a link in both directions, also when reads split the frames."""
    inspection = Inspection(Catalog(messages or ()))
    inspection.add_all(counted(load_reads(file), "lines"))
    view = report_view(inspection)
    if json:
        write(msgspec.json.encode(view).decode())
    else:
        write(*_lines(view))


# -- JSON -------------------------------------------------------------------------------------------------------------


def report_view(report: Inspection) -> dict[str, Any]:
    """Return the whole capture as one JSON object."""
    return {
        "topics": [_topic_view(info) for info in report.topics.values()],
        "messages": {name: _series_view(series) for name, series in report.messages.items()},
        "to_device": {name: _series_view(series) for name, series in report.to_device.items()},
        "logs": [{"level": log.level, "msg": log.text} for log in report.logs],
        "parameters": [
            {"name": each.name, "reply": None if each.reply is None else _parameter_view(each.reply)}
            for each in report.parameters
        ],
        "services": {name: dataclasses.asdict(counts) for name, counts in report.services.items()},
        "time_requests": report.time_requests,
        "skipped_bytes": report.skipped_bytes,
        "connections": len(report.connections),
    }


def _topic_view(info: TopicInfo) -> dict[str, Any]:
    return {
        "kind": _KINDS[info.kind],
        "id": info.topic_id,
        "name": info.name,
        "type": info.type,
        "md5": info.md5,
        "buffer_size": info.buffer_bytes,
    }


def _series_view(series: Series) -> dict[str, Any]:
    return {"count": series.count, "first": _payload_view(series.first), "last": _payload_view(series.last)}


def _payload_view(payload: Payload) -> Any:
    if payload.fields is not None:
        return json_value(payload.fields)
    error = {"error": payload.error} if payload.error else {}
    return {"hex": payload.data.hex(), **error}


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


def _lines(view: dict[str, Any]) -> list[str]:
    lines = [
        f"connections {view['connections']}   time requests {view['time_requests']}   "
        f"skipped bytes {view['skipped_bytes']}"
    ]
    topics = [[topic["id"], topic["kind"], topic["name"], topic["type"]] for topic in view["topics"]]
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
