"""Names of the events that hostlink logged, for tests that compare them."""

from collections.abc import Iterable, Mapping
from typing import Any

CAUSED_BY_LOAD = {"daemon.stalled"}  # other programs on the computer can cause these in each test


def logged(lines: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the names of the logged events, without those that a busy computer adds."""
    return [line["event"] for line in lines if line["event"] not in CAUSED_BY_LOAD]
