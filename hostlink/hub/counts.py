"""Counts: what happened to those who are no part of the hub, for the metrics and for people."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Counts:
    """Whoever counts writes into it."""

    refused: Counter[str] = field(default_factory=Counter)  # connections not served or evicted, by cause
    datagrams_dropped: Counter[str] = field(default_factory=Counter)  # of UDP, either way, by cause
    velocities_replaced: Counter[str] = field(default_factory=Counter)  # of clients, by a newer one, by their kind
    graphs: dict[str, Callable[[], Mapping[str, int]]] = field(default_factory=dict)  # of each that the hub is part of
