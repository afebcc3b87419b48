"""Devices: for each connected one, whether it is a robot and why, by its topics and the settings."""

from typing import TypedDict

from hostlink.components.gateway.views import command_endpoint_view
from hostlink.core.hub.device import Device
from hostlink.core.hub.hub import Hub
from hostlink.core.robot.model import Role, roles
from hostlink.core.robot.views import CommandEndpointView


class DeviceTopicView(TypedDict):
    """A topic of a device that counts for what it is, by its name in the graph.

    role: `command` of its robot, `velocity` (a further one, with a gate), `unguarded` (looks like a command, and
    nothing guards it), `locked` (a lock refuses it by the settings), `ignored` (no command by the settings),
    `actuator` (sets positions), or `feedback` (tells of the robot's motion).
    """

    name: str
    type: str
    role: str


class RefusedTopicView(TypedDict):
    """A topic that a device announced and hostlink refused, by the device's name of it, and why."""

    name: str
    type: str
    reason: str


class DeviceView(TypedDict):
    """Whether a connected device is a robot, and why.

    robot: null: it is not a robot. part_of: the robot of several devices of which it is one; null: none. is_spatial:
    its velocity topics take all six numbers, by the settings. name_from: source of its name. settings: the robot whose
    settings in hostlink.toml apply to it; null: none. refused: why they do not fit the device; empty if they do.
    feedback: what is known of its motion: pose, velocity, motion or none. lacks: what is missing to know more.
    refused_topics: for example those with a wrong md5 sum. suggestion: lines of hostlink.toml that put the unguarded
    topics in order.
    """

    link: int
    peer: str
    robot: str | None
    part_of: str | None
    is_spatial: bool
    name_from: str
    settings: str | None
    refused: str
    feedback: str
    lacks: str
    topics: list[DeviceTopicView]
    refused_topics: list[RefusedTopicView]
    unguarded: list[CommandEndpointView]
    suggestion: str


class DevicesView(TypedDict):
    """Every connected device, oldest first. lock_reason: of a lock of all, which holds for boards too; null: none."""

    devices: list[DeviceView]
    lock_reason: str | None


def devices_view(hub: Hub) -> DevicesView:
    """Return every connected device that has announced topics, also if all of them were refused."""
    found = hub.robots.devices.values()
    devices = [device_view(hub, each) for each in found if each.infos or each.link.session.refusals]
    return {"devices": devices, "lock_reason": hub.robots.boards.lock_reason}


def device_view(hub: Hub, device: Device) -> DeviceView:
    """Return whether one device is a robot, and why."""
    robot, link, shown = device.robot, device.link, device.shown
    commands = () if robot is None else [topic.name for topic in robot.topics.commands]
    feedback = [name for name, _ in device.read_topics]
    found = roles(device.endpoints, device.settings, commands=commands, guarded=device.guarded, feedback=feedback)
    name_from, settings = hub.links.origin_of(device)
    return {
        "link": link.number,
        "peer": link.peer,
        "robot": None if robot is None else robot.name,
        "part_of": None if device.member is None else device.member.robot,
        "is_spatial": device.settings.is_spatial,
        "name_from": name_from,
        "settings": settings,
        "refused": device.refused,
        "feedback": "none" if robot is None else robot.feedback.kind.value,
        "lacks": "" if robot is None else robot.feedback.lacks,
        "topics": [
            {"name": shown.of(endpoint.name), "type": endpoint.type_name, "role": role.value}
            for endpoint, role in found
            if role is not Role.DATA
        ],
        "refused_topics": [
            {"name": info.name, "type": info.type, "reason": str(reason)} for info, reason in link.session.refusals
        ],
        "unguarded": [command_endpoint_view(each) for each in device.unguarded_endpoints()],
        "suggestion": device.suggestion,
    }
