"""Qos: what of a quality of service matters between Zenoh and ROS 2, and its text in a token. Pure.

Zenoh matches every publisher with every subscription; the text is for the tools of ROS 2. A part that is left out has
rmw_zenoh's default: reliable, volatile, the last 42 messages.
"""

from dataclasses import dataclass
from typing import Final

DEFAULT_DEPTH: Final = 42
DEPTH_MAX: Final = 1_000_000
_BEST_EFFORT, _TRANSIENT_LOCAL, _KEEP_ALL = "2", "1", "2"  # the numbers of rmw/types.h
_PARTS: Final = 6
_INFINITE: Final = ":,:,:,,"  # deadline, lifespan, liveliness: automatic


@dataclass(frozen=True, slots=True)
class Qos:
    """`depth`: messages that are kept; None: all."""

    is_reliable: bool = True
    is_transient_local: bool = False
    depth: int | None = DEFAULT_DEPTH

    def encode(self) -> str:
        """The text in a token."""
        reliability = "" if self.is_reliable else _BEST_EFFORT
        durability = _TRANSIENT_LOCAL if self.is_transient_local else ""
        kind = _KEEP_ALL if self.depth is None else ""
        depth = "" if self.depth in (None, DEFAULT_DEPTH) else self.depth
        return f"{reliability}:{durability}:{kind},{depth}{_INFINITE}"

    @classmethod
    def decode(cls, text: str) -> "Qos | None":
        """From the text in a token; None: it is none."""
        parts = text.split(":")
        if len(parts) < _PARTS:
            return None
        kind, _, depth_text = parts[2].partition(",")
        if not all(part.isascii() and (part.isdigit() or not part) for part in (parts[0], parts[1], kind, depth_text)):
            return None
        depth = min(int(depth_text[:9]), DEPTH_MAX) if depth_text else DEFAULT_DEPTH
        return cls(
            is_reliable=parts[0] != _BEST_EFFORT,
            is_transient_local=parts[1] == _TRANSIENT_LOCAL,
            depth=None if kind == _KEEP_ALL else depth or DEFAULT_DEPTH,
        )


TELEMETRY: Final = Qos(depth=10)
LATCHED: Final = Qos(is_transient_local=True, depth=1)
COMMANDS: Final = Qos(is_reliable=False, depth=1)  # matches every publisher, in the eyes of a tool too
SERVICE: Final = Qos(depth=10)
