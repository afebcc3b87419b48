"""Writing the file of an incident: off the loop, by the daemon or by the process that comes after it."""

import itertools
import re
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from hostlink.recording.channel import NS_PER_S, Channel
from hostlink.recording.folder import Folder
from hostlink.recording.incident import Incident
from hostlink.recording.ring import Entry

BURST = 64  # messages, which take about half a millisecond


class OutOfTime(Exception):
    """The process ends, and waits no more for a file."""


def write_incident(
    folder: Folder,
    incident: Incident,
    channels: list[Channel],
    entries: Iterable[Iterable[Entry]],
    *,
    before_s: float,
    rest: Callable[[], None],
) -> Path:
    """Write an incident's file, in the order of arrival; returns where. It waits for the disk.

    `rest` is called after every BURST messages: the loop would be half as fast without the interpreter for itself.
    What it raises ends the work, and no file is left.

    Raises:
        OSError: of the disk.
    """
    from hostlink.recording.mcap_writer import McapWriter  # noqa: PLC0415 - most daemons never save one

    folder.make_room(())
    stamp = time.strftime("%Y-%m-%dT%H-%M-%S", time.localtime(incident.stamp_ns // 1_000_000_000))
    name = re.sub(r"[^A-Za-z0-9_+-]", "-", f"{stamp}_{incident.robot}_{incident.cause}")[:90]
    number = 0
    while folder.file(name, number).exists():
        number += 1
    path = folder.file(name, number)
    metadata = {
        "robot": incident.robot,
        "cause": incident.cause,
        "detail": incident.detail,
        "stamp_ns": str(incident.stamp_ns),
    }
    first_s = incident.at_s - before_s
    beside = path.with_suffix(".part")
    beside.unlink(missing_ok=True)
    writer = McapWriter(beside, metadata=metadata)
    try:
        for channel in channels:
            writer.announce(channel)
        wanted = (entry for entry in itertools.chain(*entries) if entry.at_s >= first_s)
        for number, entry in enumerate(sorted(wanted, key=lambda entry: entry.at_s)):
            steady_ns = incident.stamp_ns + round((entry.at_s - incident.at_s) * NS_PER_S)
            writer.write(entry.channel, entry.stamp_ns, entry.payload, steady_ns)
            if number % BURST == BURST - 1:
                rest()
        writer.close()
    except BaseException:
        writer.abandon()
        beside.unlink(missing_ok=True)
        raise
    beside.rename(path)
    return path
