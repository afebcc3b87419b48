"""Captures of a link's bytes in both directions.

A capture is JSON lines: {"t": seconds, "dir": "device" | "host", "hex": bytes, "conn": n, "event": "open" | "close"}.
The first line of a connection names its protocol, unless it is rosserial.
`dir` is the sender; `conn` counts connections; only a line without bytes has an `event`. Lines are ordered by time. The
event `topics` marks that the beginning is lost; its bytes announce the topics of that time.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import msgspec

from hostlink.errors import BadRequest


class Read(msgspec.Struct):
    """One line of a capture."""

    dir: Literal["device", "host"]
    hex: str = ""
    t: float = 0.0
    conn: int = 0
    event: Literal["open", "topics", "close"] | None = None
    protocol: str = "rosserial"


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
