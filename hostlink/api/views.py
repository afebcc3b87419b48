"""What the API shows of the hub, as plain dicts for JSON; numbers carry their unit in the name."""

import asyncio
from typing import Any

from hostlink.hub.hub import Hub
from hostlink.hub.robots import Robot


def robot_view(robot: Robot) -> dict[str, Any]:
    """One robot: what it is, who drives it how fast, where it says that it is."""
    return {
        "name": robot.name,
        "connected": robot.link is not None,
        "link": None if robot.link is None else robot.link.number,
        "velocity_topic": robot.topics.velocity,
        "odometry_topic": robot.topics.odometry,
        "holder": robot.gate.holder,
        "priority": robot.gate.priority,
        "locked": robot.gate.lock_reason is not None,
        "lock_reason": robot.gate.lock_reason,
        "velocity": {
            "linear_m_s": robot.gate.current.linear_x_m_s,
            "angular_rad_s": robot.gate.current.angular_z_rad_s,
        },
        "odometry": odometry_view(robot),
    }


def odometry_view(robot: Robot) -> dict[str, Any] | None:
    """Pose, twist, time and age; None before the first pose."""
    return robot.odometry.snapshot(asyncio.get_running_loop().time())


def link_views(hub: Hub) -> list[dict[str, Any]]:
    """Every live connection, its topics and what was counted on it."""
    now_s = asyncio.get_running_loop().time()
    return [
        {
            "number": link.number,
            "peer": link.peer,
            "silent_s": round(now_s - link.heard_at_s, 3),
            "topics": [
                {
                    "kind": info.kind.name.lower(),
                    "id": info.topic_id,
                    "name": info.name,
                    "type": info.type,
                    "md5": info.md5,
                    "buffer_bytes": info.buffer_bytes,
                }
                for info in link.session.topics
            ],
            **link.facts(),
        }
        for link in hub.links()
    ]


def topic_views(hub: Hub) -> list[dict[str, Any]]:
    """Every topic of the graph."""
    return [
        {
            "name": topic.name,
            "type": topic.type_name,
            "publishers": len(topic.publishers),
            "subscribers": len(topic.subscribers) + len(topic.devices),
            "messages": topic.messages,
        }
        for topic in hub.topics.all()
    ]
