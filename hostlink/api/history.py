"""What happened to a robot over REST: where it drove, what was commanded, what its plots and its log showed.

The last minutes of a robot, and those around an incident, are one JSON: ages count back from now, or from the incident.
"""

import asyncio
import itertools
import time
from collections.abc import Iterator
from http import HTTPStatus
from typing import Any, TypedDict

from aiohttp import web

from hostlink.api.replies import reply
from hostlink.api.routes import Route
from hostlink.api.views import PoseView, VelocityView
from hostlink.hub.hub import Hub
from hostlink.hub.remote_robot import RemoteRobot
from hostlink.hub.robot import Robot
from hostlink.hub.robot_events import EventKind
from hostlink.messages.catalog import Catalog
from hostlink.recording.black_box import BlackBox
from hostlink.recording.channel import EVENTS, VELOCITY
from hostlink.recording.history import PastPose, decode_event, odometry_of, past_messages, past_poses, thinned
from hostlink.recording.ring import Entry
from hostlink.robot.kinematics import Pose
from hostlink.robot.odometry_estimator import OdometryEstimator
from hostlink.robot.velocity import TWIST_TYPE

_PLOT_LEAF = "plot_data"
_FREQUENT = (EventKind.COMMANDED.value, EventKind.REFUSED.value)
NS_PER_S = 1e9


class PastPoseView(TypedDict):
    """Where it was and how it moved, how long ago."""

    age_s: float
    pose: PoseView
    twist: VelocityView


class PastCommandView(TypedDict):
    """What was sent to the device, how long ago."""

    age_s: float
    velocity: VelocityView


class PastMessageView(TypedDict):
    """A message, how long ago."""

    age_s: float
    msg: dict[str, Any]


class HistoryView(TypedDict):
    """The oldest first; empty where the black box is off."""

    poses: list[PastPoseView]
    commands: list[PastCommandView]
    plot_data: list[PastMessageView]
    events: list[PastMessageView]


class HistoryRoutes:
    """The handler."""

    def __init__(self, hub: Hub, black_box: BlackBox) -> None:
        self._hub, self._black_box = hub, black_box

    def routes(self) -> list[Route]:
        """Every path of this file."""
        return [
            Route(
                "/api/robots/{name}/history",
                self._history,
                "Where a robot drove in its last minutes, its commands, its plots, and what happened to it",
                HistoryView,
                fails=(HTTPStatus.NOT_FOUND,),
            )
        ]

    async def _history(self, request: web.Request) -> web.Response:
        robot = self._hub.robots.find(request.match_info["name"])
        if isinstance(robot, RemoteRobot):  # its daemon has its past
            return reply({"poses": [], "commands": [], "plot_data": [], "events": []})
        view = await asyncio.to_thread(self._view, robot, *self._collect(robot))
        return reply(view)

    def _collect(self, robot: Robot) -> tuple[list[Iterator[Entry]], Pose | None]:
        """In the loop's thread: what belongs together."""
        snapshot = robot.odometry.snapshot(asyncio.get_running_loop().time())
        return self._black_box.rings.copies(robot.name), None if snapshot is None else snapshot.pose

    def _view(self, robot: Robot, copies: list[Iterator[Entry]], present: Pose | None) -> HistoryView:
        """In a thread: thousands of messages are read."""
        entries = sorted(itertools.chain(*copies), key=lambda entry: entry.stamp_ns)
        topics = robot.shown
        poses = past_poses(entries, topics.odometry, topics.odometry_type, robot.odometry.anew(), present)
        return history_view(
            self._hub.catalog, robot.name, entries, poses, commands=topics.velocity, now_ns=time.time_ns()
        )


def stored_history_view(catalog: Catalog, robot: str, entries: list[Entry], *, stamp_ns: int) -> HistoryView:
    """What is in the file of an incident, around its time."""
    entries.sort(key=lambda entry: entry.stamp_ns)
    odometry = odometry_of(entries)
    poses = [] if odometry is None else past_poses(entries, *odometry, OdometryEstimator(), None)
    velocities = {entry.channel.topic for entry in entries if entry.channel.origin == VELOCITY}
    return history_view(catalog, robot, entries, poses, commands=min(velocities, default=""), now_ns=stamp_ns)


def history_view(
    catalog: Catalog, robot: str, entries: list[Entry], poses: list[PastPose], *, commands: str, now_ns: int
) -> HistoryView:
    """`commands`: the topic of the robot's velocity; `now_ns`: from when ages count."""
    twist = catalog.message(TWIST_TYPE)
    assert twist is not None  # noqa: S101 - of the store that hostlink is built on
    plot = past_messages(entries, f"/{robot}/{_PLOT_LEAF}", TWIST_TYPE, twist.decode)
    events = past_messages(entries, EVENTS.topic, EVENTS.type_name, decode_event)
    return {
        "poses": [_pose_view(each, now_ns) for each in thinned(poses)],
        "commands": [
            {"age_s": _age(now_ns, stamp_ns), "velocity": _command_view(fields)}
            for stamp_ns, fields in thinned(past_messages(entries, commands, TWIST_TYPE, twist.decode))
        ],
        "plot_data": _messages(thinned(plot), now_ns),
        "events": _messages(thinned([each for each in events if each[1].get("kind") not in _FREQUENT]), now_ns),
    }


def _messages(found: list[tuple[int, dict[str, Any]]], now_ns: int) -> list[PastMessageView]:
    return [{"age_s": _age(now_ns, stamp_ns), "msg": message} for stamp_ns, message in found]


def _age(now_ns: int, stamp_ns: int) -> float:
    return round((now_ns - stamp_ns) / NS_PER_S, 3)


def _pose_view(past: PastPose, now_ns: int) -> PastPoseView:
    pose, twist = past.pose, past.twist
    return {
        "age_s": _age(now_ns, past.stamp_ns),
        "pose": {"x_m": round(pose.x_m, 6), "y_m": round(pose.y_m, 6), "theta_rad": round(pose.theta_rad, 6)},
        "twist": {"linear_m_s": round(twist.linear_m_s, 4), "angular_rad_s": round(twist.angular_rad_s, 4)},
    }


def _command_view(twist: dict[str, Any]) -> VelocityView:
    return {"linear_m_s": twist["linear"]["x"], "angular_rad_s": twist["angular"]["z"]}
