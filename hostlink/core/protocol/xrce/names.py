"""Names that a client gives its topics, services and types, and the names that the hub uses for them.

Names of ROS 2 are those of hostlink/core/messages/ros2_names.py. A client without ROS has others: its topic keeps its
name, and its type gets the package `unknown`. A reference is the name of a profile in a file of the agent; the topic's
name is a part of it, its type is not.
"""

import re
from typing import Final

from hostlink.core.messages.ros2_names import NAME_CHARS_MAX, dds_endpoint, from_dds_type, ros1_type

NO_TYPE: Final = "unknown/unknown"
_PROFILE = re.compile(r"__(?:t|dw|dr|rq|rp)$")  # references of micro-ROS and ArduPilot
_NOT_IN_NAMES = re.compile(r"[^\w/]+", re.ASCII)


def topic_names(dds_topic: str, dds_type: str) -> tuple[str, str]:
    """Return the name and the type of a topic: "rt/odom" is "/odom"."""
    found = dds_endpoint(dds_topic, dds_type)
    if found is not None:
        return found.name, found.type_name
    return _topic_name(dds_topic), _type_name(dds_type)


def service_names(service: str, request_topic: str, request_type: str) -> tuple[str, str]:
    """Return the name and the type of a service, from the topic and type of its requests."""
    found = dds_endpoint(request_topic, request_type)
    if found is not None:
        return found.name, found.type_name
    return _topic_name(service), _type_name(request_type)


def name_of_reference(reference: str) -> str:
    """Return the name of the topic or service that a reference most likely means."""
    return _topic_name(_PROFILE.sub("", reference))


def _topic_name(name: str) -> str:
    cleaned = _NOT_IN_NAMES.sub("_", name.removeprefix("rt/").lstrip("/"))[:NAME_CHARS_MAX]
    return f"/{cleaned or 'unknown'}"


def _type_name(dds_type: str) -> str:
    type_name = from_dds_type(dds_type)
    if type_name is not None:
        return ros1_type(type_name.removesuffix("_Request"))
    cleaned = _NOT_IN_NAMES.sub("_", dds_type.replace("/", "_"))[:NAME_CHARS_MAX]
    return f"unknown/{cleaned}" if cleaned else NO_TYPE
