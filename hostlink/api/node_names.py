"""Node names: how a device, a robot and a program are called as nodes of a ROS graph."""

from collections.abc import Hashable, Iterable

from hostlink.hub.hub import Hub
from hostlink.hub.topic import Topic


def node_name(hub: Hub, key: Hashable) -> str:
    """A robot by its name, another device by its link, a client by its number."""
    robot = hub.robots.of_link(key)
    return f"/{str(key).split(' (', maxsplit=1)[0].replace(' ', '_') if robot is None else robot.name}"


def receivers(topic: Topic) -> Iterable[Hashable]:
    """The keys of the devices and the clients that get its messages."""
    return (*topic.devices, *(subscriber.key for subscriber in topic.subscribers))
