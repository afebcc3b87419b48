"""A robot's last minutes over REST: where it drove, what its plots showed, what its device logged."""

import asyncio
import time
from http import HTTPStatus
from typing import Any, TypedDict

import msgspec
from aiohttp import web

from hostlink.api.replies import reply
from hostlink.api.routes import Route
from hostlink.api.views import PoseView
from hostlink.hub.hub import Hub
from hostlink.hub.remote_robot import RemoteRobot
from hostlink.hub.robot import Robot
from hostlink.hub.robot_events import EventKind
from hostlink.recording.black_box import BlackBox
from hostlink.recording.channel import EVENTS
from hostlink.recording.history import past_messages, past_poses
from hostlink.recording.ring import Entry
from hostlink.robot.kinematics import Pose

PLOT_S = 25.0  # as much as the page shows
_PLOT_LEAF = "plot_data"
_FREQUENT = (EventKind.COMMANDED.value, EventKind.REFUSED.value)
NS_PER_S = 1e9


class PastPoseView(TypedDict):
    """Where it was, how long ago."""

    age_s: float
    pose: PoseView


class PastMessageView(TypedDict):
    """A message, how long ago."""

    age_s: float
    msg: dict[str, Any]


class HistoryView(TypedDict):
    """The oldest first; empty where the black box is off."""

    poses: list[PastPoseView]
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
                "Where a robot drove in its last minutes, its plots, and what happened to it",
                HistoryView,
                fails=(HTTPStatus.NOT_FOUND,),
            )
        ]

    async def _history(self, request: web.Request) -> web.Response:
        robot = self._hub.robots.find(request.match_info["name"])
        if isinstance(robot, RemoteRobot):  # its daemon has its past
            return reply({"poses": [], "plot_data": [], "events": []})
        view = await asyncio.to_thread(self._view, robot, *self._collect(robot))
        return reply(view)

    def _collect(self, robot: Robot) -> tuple[list[Entry], Pose | None]:
        """In the loop's thread: what belongs together."""
        snapshot = robot.odometry.snapshot(asyncio.get_running_loop().time())
        return self._black_box.rings.of(robot.name), None if snapshot is None else snapshot.pose

    def _view(self, robot: Robot, entries: list[Entry], present: Pose | None) -> HistoryView:
        """In a thread: thousands of messages are read."""
        now_ns = time.time_ns()
        entries.sort(key=lambda entry: entry.stamp_ns)
        topics = robot.shown
        poses = past_poses(entries, topics.odometry, topics.odometry_type, robot.odometry.anew(), present)
        plot_topic = f"/{robot.name}/{_PLOT_LEAF}"
        plot = self._hub.catalog.message("geometry_msgs/Twist")
        assert plot is not None  # noqa: S101 - of the store that hostlink is built on
        since_ns = now_ns - int(PLOT_S * NS_PER_S)
        return {
            "poses": [{"age_s": _age(now_ns, each.stamp_ns), "pose": _pose(each.pose)} for each in poses],
            "plot_data": _messages(past_messages(entries, plot_topic, plot.decode, since_ns), now_ns),
            "events": [
                each
                for each in _messages(past_messages(entries, EVENTS.topic, msgspec.json.decode, 0), now_ns)
                if each["msg"]["kind"] not in _FREQUENT
            ],
        }


def _messages(found: list[tuple[int, dict[str, Any]]], now_ns: int) -> list[PastMessageView]:
    return [{"age_s": _age(now_ns, stamp_ns), "msg": message} for stamp_ns, message in found]


def _age(now_ns: int, stamp_ns: int) -> float:
    return round((now_ns - stamp_ns) / NS_PER_S, 3)


def _pose(pose: Pose) -> PoseView:
    return {"x_m": round(pose.x_m, 6), "y_m": round(pose.y_m, 6), "theta_rad": round(pose.theta_rad, 6)}
