"""What happened to a robot over REST: where it drove, what was commanded, what its plots and its log showed.

The last minutes of a robot, and those around an incident, are one JSON: ages count back from now, or from the incident.
"""

import asyncio
import heapq
import time
from collections.abc import Iterator
from http import HTTPStatus
from typing import Any, TypedDict, cast

import msgspec
from aiohttp import web

from hostlink.api.replies import reply, reply_encoded
from hostlink.api.routes import Route
from hostlink.api.views import PoseView, VelocityView, velocity_view
from hostlink.hub.hub import Hub
from hostlink.hub.robot import LocalRobot
from hostlink.messages.catalog import Catalog
from hostlink.recording.black_box import BlackBox
from hostlink.recording.history import PastPose, Rest, RobotHistory
from hostlink.recording.ring import Entry
from hostlink.robot.kinematics import Pose
from hostlink.robot.odometry import OdometryEstimator
from hostlink.robot.velocity import TWIST_TYPE, PlanarVelocity, Twist

WORK_S = 0.0005  # of a thread that reads, before the loop has the interpreter for REST_S
REST_S = 0.001
PIECE = 100  # of a list, encoded at once: some 0.1 ms


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


class Pauses:
    """Gives the interpreter back to the loop, again and again, while a thread reads thousands of messages."""

    def __init__(self) -> None:
        self._began_s = time.perf_counter()

    def __call__(self) -> None:
        """Sleep for REST_S after each WORK_S."""
        if time.perf_counter() - self._began_s >= WORK_S:
            time.sleep(REST_S)
            self._began_s = time.perf_counter()


class HistoryRoutes:
    """The handler. `turn`: one history is made at a time, of a robot or of an incident."""

    def __init__(self, hub: Hub, black_box: BlackBox, turn: asyncio.Semaphore) -> None:
        self._hub, self._black_box, self._turn = hub, black_box, turn

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
        async with self._turn:
            found = self._hub.robots.find(request.match_info["name"])
            robot = self._hub.robots.get_here(found.name)
            if robot is None or robot is not found:  # another daemon has its past
                return reply({"poses": [], "commands": [], "plot_data": [], "events": []})
            body = await asyncio.to_thread(self._body, robot, *self._collect(robot))
        return reply_encoded(body)

    def _collect(self, robot: LocalRobot) -> tuple[list[Iterator[Entry]], Pose | None]:
        """In the loop's thread: what belongs together."""
        snapshot = robot.odometry.snapshot(asyncio.get_running_loop().time())
        return self._black_box.rings.copies(robot.name), None if snapshot is None else snapshot.pose

    def _body(self, robot: LocalRobot, copies: list[Iterator[Entry]], present: Pose | None) -> bytes:
        """In a thread: thousands of messages are read."""
        rest = Pauses()
        topics = robot.shown
        odometry = (topics.odometry, topics.odometry_type)
        history = RobotHistory(robot.name, odometry=odometry, commands=topics.velocity)
        for entry in heapq.merge(*copies, key=lambda entry: entry.at_s):
            rest()
            history.add(entry)
        return encode_history(
            history_view(self._hub.catalog, history, robot.odometry.anew(), present, time.monotonic(), rest), rest
        )


def history_view(
    catalog: Catalog,
    history: RobotHistory,
    estimator: OdometryEstimator,
    present: Pose | None,
    now_s: float,
    rest: Rest,
) -> HistoryView:
    """What is shown. Ages count from `now_s`; of `estimator`, `present` and `rest` see `RobotHistory.poses`."""
    twist = catalog.message(TWIST_TYPE)
    assert twist is not None  # noqa: S101 - of the store that hostlink is built on
    commands = history.commands(twist.decode, rest)
    return {
        "poses": [_pose_view(each, now_s) for each in history.poses(estimator, present, rest)],
        "commands": [{"age_s": _age(now_s, at_s), "velocity": _command_view(fields)} for at_s, fields in commands],
        "plot_data": _messages(history.plot_data(twist.decode, rest), now_s),
        "events": _messages(history.events(rest), now_s),
    }


def encode_history(view: HistoryView, rest: Rest) -> bytes:
    """As JSON, in pieces: the encoder keeps the interpreter for as long as it works."""
    fields: list[bytes] = []
    for name, items in view.items():
        pieces = []
        for begin in range(0, len(cast("list[object]", items)), PIECE):
            rest()
            pieces.append(msgspec.json.encode(cast("list[object]", items)[begin : begin + PIECE])[1:-1])
        fields.append(b'"%s":[%s]' % (name.encode(), b",".join(pieces)))
    return b"{%s}" % b",".join(fields)


def _messages(found: list[tuple[float, dict[str, Any]]], now_s: float) -> list[PastMessageView]:
    return [{"age_s": _age(now_s, at_s), "msg": message} for at_s, message in found]


def _age(now_s: float, at_s: float) -> float:
    return round(now_s - at_s, 3)


def _pose_view(past: PastPose, now_s: float) -> PastPoseView:
    pose, twist = past.pose, past.twist
    return {
        "age_s": _age(now_s, past.at_s),
        "pose": {"x_m": round(pose.x_m, 6), "y_m": round(pose.y_m, 6), "theta_rad": round(pose.theta_rad, 6)},
        "twist": velocity_view(PlanarVelocity(*(round(component, 4) for component in twist))),
    }


def _command_view(twist: dict[str, Any]) -> VelocityView:
    return velocity_view(Twist.from_fields(twist).planar)
