"""Drivable: a velocity topic of a device, behind the gate that is its only subscriber in the graph."""

from dataclasses import dataclass, field
from typing import Any

from hostlink.hub.refusals import Refusals
from hostlink.hub.topic import Topic
from hostlink.link.link import Link
from hostlink.protocol.control import TopicInfo
from hostlink.protocol.frame import Id
from hostlink.robot.velocity import TWIST_TYPE, ZERO, AnyVelocity
from hostlink.robot.velocity_gate import VelocityGate


@dataclass(slots=True, eq=False, kw_only=True)
class Drivable:
    """A robot's own velocity topic, another one of it, or that of a device which publishes no pose."""

    name: str  # of the robot, or of the topic in the graph
    velocity_topic: str  # as the device names it
    gate: VelocityGate[Any]  # of a PlanarVelocity for a robot, else of a Twist
    link: Link | None = None
    echoes: dict[str, Topic] = field(default_factory=dict)  # topics of its gate, where all receive what it sent
    last_frame: bytes = b""  # its zero, as the device receives it
    sent: AnyVelocity = ZERO
    sent_at_s: float = 0.0
    refusals: Refusals = field(default_factory=Refusals)


def is_velocity(info: TopicInfo) -> bool:
    """Whether a device is driven by this topic, by type and name: a Twist may mean other things."""
    leaf = info.name.rpartition("/")[2].lower()
    return info.kind is Id.SUBSCRIBER and info.type == TWIST_TYPE and "vel" in leaf
