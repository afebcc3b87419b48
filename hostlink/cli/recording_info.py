"""What is in a recording, for `hostlink info FILE`."""

import time
from pathlib import Path

import msgspec

from hostlink.cli.measuring import megabytes
from hostlink.cli.output import table, write
from hostlink.recording.channel import NS_PER_S
from hostlink.recording.contents import Contents, TopicContents, contents_of
from hostlink.recording.definitions import why_unknown


def show_recording(file: Path, *, as_json: bool) -> None:
    """Write it.

    Raises:
        RecordingFailed: it cannot be read, or is no recording.
    """
    found = contents_of(file)
    if as_json:
        write(msgspec.json.encode(_view(found)).decode())
        return
    begin = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(found.begin_ns // NS_PER_S))
    write(
        f"{file}: {megabytes(found.size_bytes)}, {found.messages} messages, {found.seconds:.1f} s from {begin}",
        *(f"  {name}: {value}" for name, value in found.metadata.items() if value),
        *(f"  clock: it was set by {step.step_s:+.1f} s after {step.at_s:.1f} s" for step in found.clock_steps),
        *(f"  damage: {damage}{_mended(file)}" for damage in found.damage),
        *table(["topic", "type", "messages", "Hz", "robot", "from", "export"], [_row(topic) for topic in found.topics]),
    )


def _mended(file: Path) -> str:
    return f"; hostlink record --repair {file} mends it" if file.suffix == ".mcap" else ""


def _row(topic: TopicContents) -> list[str]:
    channel, rate_hz = topic.channel, topic.rate_hz
    why = why_unknown(channel)
    rate = "" if rate_hz is None else f"{rate_hz:.1f}"
    return [channel.topic, channel.type_name, str(topic.messages), rate, channel.robot, channel.origin, why or "yes"]


def _view(found: Contents) -> dict[str, object]:
    return {
        "file": str(found.path),
        "bytes": found.size_bytes,
        "messages": found.messages,
        "seconds": round(found.seconds, 6),
        "begin_ns": found.begin_ns,
        "clock_steps": [step._asdict() for step in found.clock_steps],
        "metadata": found.metadata,
        "damage": found.damage,
        "topics": [
            {
                "topic": topic.channel.topic,
                "type": topic.channel.type_name,
                "encoding": topic.channel.encoding,
                "robot": topic.channel.robot,
                "origin": topic.channel.origin,
                "not_exported": why_unknown(topic.channel),
                "messages": topic.messages,
                "bytes": topic.payload_bytes,
                "rate_hz": None if topic.rate_hz is None else round(topic.rate_hz, 3),
            }
            for topic in found.topics
        ],
    }
