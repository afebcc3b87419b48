"""Which recordings go when there is no room: the oldest first, never one that is being written."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class StoredFile:
    """One file of the folder."""

    name: str
    size_bytes: int
    modified_s: float
    is_open: bool = False


def over_budget(files: Iterable[StoredFile], budget_bytes: int) -> list[str]:
    """The names of the files that must go, so that the others fit, oldest first."""
    kept = sorted(files, key=lambda file: (file.modified_s, file.name))
    total_bytes = sum(file.size_bytes for file in kept)
    gone = []
    for file in kept:
        if total_bytes <= budget_bytes:
            break
        if not file.is_open:
            gone.append(file.name)
            total_bytes -= file.size_bytes
    return gone
