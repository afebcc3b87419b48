"""`hostlink delay`: how old messages are when they come, by the stamp of their header and this computer's clock."""

import struct
import time
from typing import Any

from hostlink.cli.measuring import Measured, duration
from hostlink.cli.topic_figures import Figures, command_of
from hostlink.client import Host, RawMessage
from hostlink.errors import HostlinkError

_HEADER = struct.Struct("<III")  # seq, secs, nsecs: what a std_msgs/Header begins with


async def _check_header(host: Host, topic: str) -> None:
    """Raises HostlinkError for a topic whose type has no header."""
    type_name = (await host.call("/rosapi/topic_type", {"topic": topic}))["type"]
    if not type_name:
        raise HostlinkError(f"{topic} has no type yet: nobody publishes it; `hostlink topics` lists them")
    fields = (await host.call("/rosapi/message_details", {"type": type_name}))["typedefs"][0]["fieldtypes"]
    if fields[:1] != ["std_msgs/Header"]:
        raise HostlinkError(
            f"{topic}: a {type_name} has no header, and so no stamp to measure by; "
            f"`hostlink hz {topic}` shows when its messages come"
        )


def _age_s(message: RawMessage) -> float:
    _, secs, nsecs = _HEADER.unpack_from(message.payload)
    return float(time.time() - secs - nsecs / 1e9)


def _view(measured: Measured) -> dict[str, Any]:
    age_s = measured.figures
    if age_s is None:
        return {"delay_s": None}
    seconds = {"delay_s": age_s.mean, "min_s": age_s.least, "max_s": age_s.most, "std_dev_s": age_s.deviation}
    return {key: round(value, 6) for key, value in seconds.items()} | {"window": age_s.count}


def _line(measured: Measured) -> str:
    age_s = measured.figures
    if age_s is None:
        return "no messages yet"
    return (
        f"delay {duration(age_s.mean)} (min {duration(age_s.least)}, max {duration(age_s.most)}, "
        f"std dev {duration(age_s.deviation)}) of {age_s.count} messages"
    )


command = command_of(
    Figures(
        text="Measure how old the messages of a topic are; a line each second until Ctrl-C. "
        "They need a header with a stamp.",
        view=_view,
        line=_line,
        figure=_age_s,
        check=_check_header,
    )
)
