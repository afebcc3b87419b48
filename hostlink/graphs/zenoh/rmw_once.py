"""Once: log lines that names of other nodes cause, each written once, and so many in all."""

from collections import Counter

import structlog

from hostlink.logs import printable

MAX_LINES = 256
UNKNOWN = "ros2.type_unknown"

log = structlog.get_logger()


class Once:
    """Lines by event and name; over MAX_LINES they are counted as `unlogged`."""

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self._logged: set[tuple[str, ...]] = set()

    def log(self, event: str, name: str, detail: str = "", **facts: str) -> None:
        """Write a line, unless it was written."""
        key = (event, name, detail)
        if key in self._logged:
            return
        if len(self._logged) >= MAX_LINES:
            self._counts["unlogged"] += 1
            return
        self._logged.add(key)
        shown = {key: printable(text, 200) for key, text in facts.items()}
        write = log.info if event == UNKNOWN else log.warning  # most types of a large graph are no robot's here
        write(event, name=printable(name), **({"type": printable(detail)} if detail else {}), **shown)
