"""Parts of a robot: which of several devices commands it, which tell how it moves, and what is missing. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hostlink.core.robot.feedback import recognised
from hostlink.core.robot.model import CommandSettings, Endpoint, find_robot, misfit, namespace_of
from hostlink.core.runtime.topic_names import plain_name


class Membership(NamedTuple):
    """A device that is a part of a robot: the robot's name, and the entry of its `devices` that means the device.

    `is_waiting`: another device has this place since before, so that this one is not driven and tells nothing.
    """

    robot: str
    place: str
    is_waiting: bool = False


@dataclass(frozen=True, slots=True)
class Parts:
    """Composition of a robot of several devices, by entries of its `devices`.

    `why_not`: reason for which it is not driven; empty if it can be. `feedback`: where each topic is read, the first
    device of a topic before others that send it, too.
    """

    command: str | None
    why_not: str
    feedback: tuple[tuple[str, Endpoint], ...]

    def place_of(self, topic: tuple[str, str]) -> str | None:
        """Return the device from which a topic is read, by name and type; None: no device sends it."""
        return next((place for place, each in self.feedback if (each.name, each.type_name) == topic), None)

    def odometry(self) -> str | None:
        """Return the topic that tells most of the motion: that of the other devices precedes the command's own."""
        for is_command in (False, True):
            offered = [each for place, each in self.feedback if (place == self.command) is is_command]
            found = recognised((each.name, each.type_name) for each in offered)
            if found is not None:
                return found[0]
        return None


def place_in(devices: Sequence[str], endpoints: Sequence[Endpoint], *, peer: str, address: str) -> str | None:
    """Return the entry of a robot's `devices` that means this device; None: it is not a part of it.

    An address with its port precedes the address, and that precedes the name in front of the device's topics.
    """
    names = {namespace[0] for namespace in (namespace_of(each.name) for each in endpoints) if namespace}
    exact = (each for each in (peer, address) if each in devices)
    return next(exact, None) or next((each for each in devices if each.strip("/") in names), None)


def takes_velocity(place: str, endpoints: Sequence[Endpoint], settings: CommandSettings) -> bool:
    """Whether this device may be the one that commands the robot."""
    return settings.command_device in (None, place) and find_robot(endpoints, settings) is not None


def _why_no_command(name: str, settings: CommandSettings, connected: Mapping[str, Sequence[Endpoint]]) -> str:
    """Return why none of the devices commands the robot. They are connected, and take all topics of the settings."""
    taken = [
        (plain_name(each.name), place) for place in settings.devices for each in connected[place] if each.is_to_device
    ]
    first = dict(reversed(taken))
    places = {topic: first[plain_name(topic)] for topic in settings.topics}
    if len(set(places.values())) > 1:
        split = ", ".join(f"{topic} on {place}" for topic, place in places.items())
        return f"its command topics must be on one device, and they are on several: {split}"
    if settings.command_device not in (None, *places.values()):
        return f"command_device in [robots.{name}] is {settings.command_device}, which takes no velocity"
    return "none of its devices takes a velocity"


def parts_of(name: str, settings: CommandSettings, connected: Mapping[str, Sequence[Endpoint]]) -> Parts:
    """Return the parts of a robot, from the endpoints of the connected devices by entries of its `devices`."""
    commands = [
        place for place in settings.devices if place in connected and takes_velocity(place, connected[place], settings)
    ]
    command = commands[0] if len(commands) == 1 else None
    missing = [place for place in settings.devices if place not in connected]
    why_not = ""
    if len(commands) > 1:
        both = " and ".join(commands)
        why_not = f"{both} take a velocity: choose one, with command_device in [robots.{name}], and reload"
    elif missing:
        verb = "is" if len(missing) == 1 else "are"
        why_not = f"its device {' and '.join(missing)} {verb} not connected"
    elif command is None:
        every = [each for endpoints in connected.values() for each in endpoints]
        why_not = misfit(settings, every) or _why_no_command(name, settings, connected)
    order = sorted(settings.devices, key=lambda place: place == command)  # stable
    feedback = tuple((place, each) for place in order for each in connected.get(place, ()) if not each.is_to_device)
    return Parts(command, why_not, feedback)
