"""Names in the output: their natural order, suggestions for unknown ones, and the name of a driver. Pure."""

import difflib
import re
from collections.abc import Collection, Iterable, Mapping, Sequence

from hostlink.errors import HostlinkError

# -- names of the graph -----------------------------------------------------------------------------------------------

MOST = 3
CLOSE = 0.6  # difflib's ratio: /robot_0/odom and /robot_0/odometry have 0.83, /led and /odom 0.44
LESS = 0.15  # below the closest ratio: a name that is less similar is not suggested
LISTED = 8
ALL = ("all", "*")  # words for every robot
_NUMBER = re.compile(r"([0-9]+)")


def natural(name: str) -> list[tuple[int, str]]:
    """Sort key of the natural order: robot_2 before robot_10."""
    parts = _NUMBER.split(name)  # texts at even places, digits between them
    return [(len(part.lstrip("0")) if place % 2 else 0, part) for place, part in enumerate(parts)]


def near(name: str, known: Iterable[str]) -> list[str]:
    """Names that are similar by their letters or contain the last part; at most MOST."""
    names = sorted(known, key=natural)
    found = difflib.get_close_matches(name, names, n=MOST, cutoff=CLOSE)
    ratios = {each: difflib.SequenceMatcher(None, each, name).ratio() for each in found}
    close = [each for each in found if ratios[each] >= max(ratios.values()) - LESS]
    last = name.rstrip("/").rpartition("/")[2].lower()
    parts = [each for each in names if last and last in each.lower() and each not in close]
    return (close + parts)[:MOST]


def similar(name: str, known: Iterable[str]) -> str:
    """Return the names that are similar, as a part of a sentence; empty without any."""
    found = near(name, known)
    return f"similar names: {', '.join(found)}; " if found else ""


def unknown(kind: str, name: str, known: Iterable[str], *, command: str) -> HostlinkError:
    """Error of an unknown name: similar names, or else known ones, and the command that lists them."""
    names = sorted(known, key=natural)
    found = near(name, names)
    if not names:
        return HostlinkError(f"there is no {kind} named {name}; there are none yet")
    hint = f"similar names: {', '.join(found)}" if found else f"known are: {', '.join(names[:LISTED])}"
    return HostlinkError(f"there is no {kind} named {name}; {hint}; `hostlink {command}` lists them")


def unknown_robot(name: str | None, known: Iterable[str], *, also: str = "") -> HostlinkError:
    """Error of a robot's name that is unknown, or if no robot is known, of any name or none.

    `also` is one more next step.
    """
    names = list(known)
    if name is None or not names:
        return HostlinkError("no robot has connected yet; `hostlink doctor` finds out why")
    error = unknown("robot", name, names, command="robots")
    return HostlinkError(f"{error}; {also}") if also else error


def mean_all(names: Iterable[str], known: Collection[str]) -> bool:
    """Tell whether one of the names means every robot. The name of a robot does not."""
    return any(name.lower() in ALL and name not in known for name in (each.strip("/") for each in names))


def only_connected(robots: Mapping[str, bool], *, example: str) -> str:
    """Return the only robot that is connected. `robots`: name -> whether it is connected.

    `example` is a command with a place for the name, as in `hostlink teleop {}`.

    Raises:
        HostlinkError: several are connected, or none.
    """
    if not robots:
        raise unknown_robot(None, ())
    connected = sorted((name for name, is_connected in robots.items() if is_connected), key=natural)
    if len(connected) == 1:
        return connected[0]
    if connected:
        raise HostlinkError(
            f"{len(connected)} robots are connected: {listed(connected)}; "
            f"name one, as in `{example.format(connected[0])}`"
        )
    known = listed(sorted(robots, key=natural))
    raise HostlinkError(f"no robot is connected; known are: {known}; `hostlink doctor` finds out why")


def listed(names: Sequence[str]) -> str:
    """Return the first names, with dots if there are more."""
    return f"{', '.join(names[:LISTED])}{', ...' if len(names) > LISTED else ''}"


# -- drivers ----------------------------------------------------------------------------------------------------------


def driver(robot: Mapping[str, object], client_name: str | None = None) -> str | None:
    """Return the driver in a robot's view; None without one. `client_name`, the name of this program, becomes "you"."""
    if robot.get("played"):
        return "a recording"
    name = robot["holder"]
    if name is not None and name == client_name:
        return "you"
    return None if name is None else named(str(name), str(robot.get("holder_address") or ""))


def named(name: str, address: str) -> str:
    """Return the name with its address: `client 3 (phone, 10.0.0.5)`. A name that contains the address is unchanged."""
    if not address or address in name:
        return name
    return f"{name.removesuffix(')')}, {address})" if name.endswith(")") else f"{name} ({address})"
