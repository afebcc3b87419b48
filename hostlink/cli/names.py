"""Names for a person: their order, and what may have been meant by one that is not known. Pure."""

import difflib
import re
from collections.abc import Iterable

from hostlink.errors import HostlinkError

MOST = 3
CLOSE = 0.6  # difflib's ratio: /robot_0/odom and /robot_0/odometry have 0.83, /led and /odom 0.44
LESS = 0.15  # than the closest: what is less close is not meant
LISTED = 8
_NUMBER = re.compile(r"([0-9]+)")


def natural(name: str) -> list[tuple[int, str]]:
    """The key of a natural order: robot_2 before robot_10."""
    parts = _NUMBER.split(name)  # texts at even places, digits between them
    return [(len(part.lstrip("0")) if place % 2 else 0, part) for place, part in enumerate(parts)]


def near(name: str, known: Iterable[str]) -> list[str]:
    """The names that come near: by their letters, by a part, or else none."""
    names = sorted(known, key=natural)
    found = difflib.get_close_matches(name, names, n=MOST, cutoff=CLOSE)
    ratios = {each: difflib.SequenceMatcher(None, each, name).ratio() for each in found}
    close = [each for each in found if ratios[each] >= max(ratios.values()) - LESS]
    last = name.rstrip("/").rpartition("/")[2].lower()
    parts = [each for each in names if last and last in each.lower() and each not in close]
    return (close + parts)[:MOST]


def unknown(kind: str, name: str, known: Iterable[str], *, command: str) -> HostlinkError:
    """The error of a name that is not known: what comes near, or what there is, and the command that lists it."""
    names = sorted(known, key=natural)
    found = near(name, names)
    hint = f"near it: {', '.join(found)}" if found else f"there is: {', '.join(names[:LISTED]) or 'none yet'}"
    return HostlinkError(f"no {kind} named {name}; {hint}; `hostlink {command}` lists them")
