"""LogOnce: bound of the log lines that peers cause again and again."""

from collections import Counter
from collections.abc import Collection

import structlog

from hostlink.core.runtime.logs import printable

MAX_LINES = 512
MAX_CHARS = 200  # of one fact

log = structlog.get_logger()


class LogOnce:
    """Log of repeated failures: each line is written once. Lines over MAX_LINES are counted, and not written."""

    def __init__(
        self, counts: Counter[str] | None = None, *, at_info: Collection[str] = (), by: Collection[str] | None = None
    ) -> None:
        """`counts`: `unlogged`; `at_info`: events of level info; `by`: facts that make another line, else all."""
        self.counts: Counter[str] = Counter() if counts is None else counts
        self._at_info, self._by = at_info, by
        self._logged: set[tuple[str, ...]] = set()

    def __call__(self, event: str, **facts: str) -> None:
        """Write a line, unless it was written."""
        shown = {name: printable(text, MAX_CHARS) for name, text in facts.items()}
        if self.is_new(event, *(text for name, text in shown.items() if self._by is None or name in self._by)):
            write = log.info if event in self._at_info else log.warning
            write(event, **shown)

    def is_new(self, *key: str) -> bool:
        """Whether a line of this key is to be written now."""
        if key in self._logged:
            return False
        if len(self._logged) >= MAX_LINES:
            self.counts["unlogged"] += 1
            return False
        self._logged.add(key)
        return True
