"""Text of `hostlink robots --explain`, and of what a list of robots warns of. Pure."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any

from hostlink.cli.figures import place

ROLES = {  # by the roles of a device's topics; commands, velocities and feedback have sentences of their own
    "unguarded": "topics that look like commands, and that nothing guards",
    "locked": "topics that a lock refuses, by locked_topics",
    "ignored": "topics that are not commands, by not_commands",
    "actuator": "topics that set positions, without a lease",
}
KNOWN_BY = {"pose": "pose", "velocity": "velocity", "motion": "whether it moves", "none": "nothing: no odometry"}


def explanation(devices: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return why each device is a robot or is not one."""
    given, devices = dict[str, str](), list(devices)
    driven = {device["robot"] for device in devices}
    return [line for device in devices for line in (*_of_device(device, driven), *_advice(device, given))]


def warnings(devices: Iterable[Mapping[str, Any]], lock_reason: str | None) -> list[str]:
    """Return what a list of robots must not hide: topics that nothing guards, refused settings, a lock of all."""
    lines, given = list[str](), dict[str, str]()
    for device in devices:
        place = _place(device)
        if device["refused"]:
            what = f"is not {device['settings'] or 'a robot'}"
            if device["robot"] is not None:
                what = f"is the robot {device['robot']}, with its limits"
            elif device.get("part_of") is not None:
                what = f"is a part of the robot {device['part_of']}"
            lines.append(f"{place} {what}: its settings do not fit: {device['refused']}")
        if device["unguarded"]:
            topics = ", ".join(each["topic"] for each in device["unguarded"])
            if not device["suggestion"]:
                lines.append(f"nothing guards {topics} of {place}")
                continue
            first = given.setdefault(device["suggestion"], place)
            if first != place:
                lines.append(f"nothing guards {topics} of {place}; the lines of {first} are for it, too")
                continue
            lines.append(f"nothing guards {topics} of {place}; in hostlink.toml:")
            lines += [f"  {line}" for line in device["suggestion"].splitlines()]
    if lock_reason is not None:
        lines.append(f"everything that connects is locked: {lock_reason}; `hostlink unlock --all` ends it")
    return lines


def _place(device: Mapping[str, Any]) -> str:
    return f"link {device['link']} ({place(device)})"


def _of_device(device: Mapping[str, Any], driven: Collection[str]) -> Iterator[str]:
    named: dict[str, list[str]] = {}
    for topic in device["topics"]:
        named.setdefault(topic["role"], []).append(f"{topic['name']} ({topic['type']})")
    place, commands = _place(device), ", ".join(named.get("command", ()))
    if device["robot"] is not None:
        yield f"{place} is the robot {device['robot']}: it takes velocities on {commands}"
        yield f"  its name: {device['name_from']}"
        if device["refused"]:
            yield f"  its settings do not fit: {device['refused']}"
        known = KNOWN_BY.get(device["feedback"], device["feedback"])
        topics, lacks = ", ".join(named.get("feedback", ())), device["lacks"]
        yield f"  its motion is known by {known}{topics and f', from {topics}'}{lacks and f'; it lacks {lacks}'}"
        yield from _velocities("further velocity topics, with the robot's lease, limits and lock", named)
    elif device["refused"] and device.get("part_of") is None:
        yield f"{place} is not a robot: the settings do not fit its topics: {device['refused']}"
    elif device.get("part_of") is not None:  # an older daemon does not say it
        how = "takes its velocities on another device" if device["part_of"] in driven else "no device commands"
        yield f"{place} is a part of the robot {device['part_of']}, which {how}"
        if device["refused"]:
            yield f"  its settings do not fit: {device['refused']}"
        if named.get("feedback"):
            yield f"  the robot's motion is known by {', '.join(named['feedback'])}"
        yield from _velocities(
            "velocity topics with a lease of their own, and the robot's limits, stop and lock", named
        )
    elif device.get("is_spatial") and named.get("velocity"):
        yield f'{place} is not a robot of the plane, by kinematics = "spatial"'
        yield from _velocities("velocity topics, which take all six numbers, with a lease and a lock", named)
    elif named.get("velocity"):
        yield f"{place} is not a robot by its settings"
        yield from _velocities("velocity topics, with a lease and a lock, and without limits", named)
    elif not device["topics"] and device.get("refused_topics"):
        yield f"{place} is not a robot: hostlink refused topics of it, and none of the others takes a velocity"
    else:
        yield f"{place} is not a robot: none of its topics takes a velocity by its type and name, or by the settings"
    for role, text in ROLES.items():
        if role in named:
            yield f"  {text}: {', '.join(named[role])}"
    for topic in device.get("refused_topics", ()):
        yield f"  refused: {topic['reason']}; `hostlink doctor` says what to do"
    if device["settings"] is not None:
        yield f"  settings: [robots.{device['settings']}] in hostlink.toml"


def _velocities(text: str, named: Mapping[str, list[str]]) -> Iterator[str]:
    if named.get("velocity"):
        yield f"  {text}: {', '.join(named['velocity'])}"


def _advice(device: Mapping[str, Any], given: dict[str, str]) -> Iterator[str]:
    """Yield the lines for hostlink.toml. `given`: the devices that got lines; a table of TOML may be there once."""
    if not device["suggestion"]:
        return
    place = _place(device)
    first = given.setdefault(device["suggestion"], place)
    if first != place:
        yield f"  to change that, the lines of {first} are for it, too"
        return
    is_there = device["suggestion"].startswith(f"[robots.{device['settings']}]\n")
    place = f"the table [robots.{device['settings']}] of hostlink.toml" if is_there else "hostlink.toml"
    yield f"  to change that, put these lines into {place}, and restart hostlink:"
    yield from (f"    {line}" for line in device["suggestion"].splitlines())
