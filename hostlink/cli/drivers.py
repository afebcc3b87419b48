"""Who drives, for a person: the name, and from which address."""

from collections.abc import Mapping


def driver(robot: Mapping[str, object], client_name: str | None = None) -> str | None:
    """Who drives a robot, of its view; None: nobody. `client_name`: what this program is called there, which is you."""
    if robot.get("played"):
        return "a recording"
    name = robot["holder"]
    if name is not None and name == client_name:
        return "you"
    return None if name is None else named(str(name), str(robot.get("holder_address") or ""))


def named(name: str, address: str) -> str:
    """As `client 3 (phone, 10.0.0.5)`; a name that has the address already stays as it is."""
    if not address or address in name:
        return name
    return f"{name.removesuffix(')')}, {address})" if name.endswith(")") else f"{name} ({address})"
