"""LogOnce: log lines that peers cause again and again, each written once, and so many in all."""

from collections.abc import Collection

import structlog

from hostlink.logs import printable

MAX_LINES = 512
MAX_CHARS = 200  # of one fact

log = structlog.get_logger()


class LogOnce:
    """What is tried again and again fails in the same way. Over MAX_LINES lines are counted, and not written."""

    def __init__(self, *, at_info: Collection[str] = ()) -> None:
        """`at_info`: events of which nobody needs to be warned."""
        self.unlogged = 0
        self._at_info = at_info
        self._logged: set[tuple[str, ...]] = set()

    def __call__(self, event: str, **facts: str) -> None:
        """Write a line, unless this one was written."""
        shown = {name: printable(text, MAX_CHARS) for name, text in facts.items()}
        if self.is_new(event, *shown.values()):
            write = log.info if event in self._at_info else log.warning
            write(event, **shown)

    def is_new(self, *key: str) -> bool:
        """Whether a line of this key is to be written now."""
        if key in self._logged:
            return False
        if len(self._logged) >= MAX_LINES:
            self.unlogged += 1
            return False
        self._logged.add(key)
        return True
