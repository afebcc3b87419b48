"""Echoes: what the bridge has published itself, and what ROS 2 therefore delivers to it again. Pure."""

from collections import deque

MAX_REMEMBERED = 64  # messages of a topic; an echo comes within milliseconds


class Echoes:
    """Of one topic. A message is an echo once for each time that it was published."""

    def __init__(self) -> None:
        self._published: deque[bytes] = deque(maxlen=MAX_REMEMBERED)

    def publish(self, data: bytes) -> None:
        """The bridge publishes it."""
        self._published.append(data)

    def is_echo(self, data: bytes) -> bool:
        """Whether a message that came is the bridge's own."""
        try:
            self._published.remove(data)
        except ValueError:
            return False
        return True
