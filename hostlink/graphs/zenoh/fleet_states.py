"""FleetStates: what other daemons receive of the robots here: a state each second and after each change."""

import asyncio
import re
from typing import Any

import msgspec

from hostlink.graphs.zenoh.fleet_messages import MAX_ROBOTS, Live, Motion, RobotMessage, State, encode
from hostlink.graphs.zenoh.fleet_post import Post
from hostlink.hub.hub import Hub
from hostlink.hub.robot import LocalRobot
from hostlink.logs import printable

STATE_INTERVAL_S = 1.0
GREETING_S = 0.5  # after a daemon has appeared: it may not yet know who sends
_TEXT = 200
_UNSTEADY: dict[str, Any] = {  # no reason to send a state before its time
    "pose": None, "velocity": (0.0, 0.0), "linear_y_m_s": 0.0, "battery_v": None, "battery_percent": None,
    "signal_dbm": None,
}  # fmt: skip


class FleetStates:
    """Poses go with every state; as they come only while somebody reads them, by another key."""

    def __init__(self, hub: Hub, post: Post) -> None:
        self._hub, self._post = hub, post
        self._states = post.session.declare_publisher(post.keys.key("state", post.me), is_urgent=True)
        self._live = post.session.declare_publisher(post.keys.key("live", post.me))
        self._is_live = False
        self._live.watch(self._note_readers)
        self._due_s = 0.0
        self._greeting_until_s = 0.0
        self._known: tuple[object, ...] = ()
        self._marks: dict[str, object] = {}  # by which a motion that was sent is known

    def greet(self) -> None:
        """Somebody has appeared: send the state again and again for a moment."""
        self._greeting_until_s = _now_s() + GREETING_S

    def tick(self, topics: int) -> None:
        """Send what has changed; `topics`: the number of the list of topics."""
        now_s = _now_s()
        states = self.states()
        known = (topics, *(msgspec.structs.replace(each, **_UNSTEADY) for each in states))
        if now_s >= self._due_s or now_s < self._greeting_until_s or known != self._known:
            self._due_s, self._known = now_s + STATE_INTERVAL_S, known
            self._states.put(encode(State(sent_s=now_s, topics=topics, robots=states)))
        elif self._is_live:
            self._send_motions(states)

    def _send_motions(self, states: tuple[RobotMessage, ...]) -> None:
        """Of the robots that have moved, or whose velocity is another."""
        motions = {state.name: Motion(state.name, state.velocity, state.pose, state.linear_y_m_s) for state in states}
        marks: dict[str, object] = {
            name: (each.velocity, each.linear_y_m_s, each.pose and each.pose.count) for name, each in motions.items()
        }
        moved = tuple(motion for name, motion in motions.items() if marks[name] != self._marks.get(name))
        self._marks = marks
        if moved:
            self._live.put(encode(Live(robots=moved)))

    def states(self) -> tuple[RobotMessage, ...]:
        """Of every robot here whose name can be a part of a key."""
        robots = [robot for robot in self._hub.robots.here() if is_shareable(robot)]
        if len(robots) > MAX_ROBOTS:
            self._post.counts["unshared_robots"] += len(robots) - MAX_ROBOTS
            robots = sorted(robots, key=lambda robot: robot.link is None)[:MAX_ROBOTS]
        return tuple(map(state_of, robots))

    def close(self) -> None:
        """Send no more."""
        self._states.close()
        self._live.close()

    def _note_readers(self, is_read: bool) -> None:
        self._is_live = is_read


def is_shareable(robot: LocalRobot) -> bool:
    """Whether other daemons can know it by its name."""
    return re.fullmatch(r"\w{1,64}", robot.name, re.ASCII) is not None


def fleet_name(robot: LocalRobot, topic: str) -> str:
    """A topic of a robot as other daemons know it: below the robot's name."""
    return topic if topic.startswith(f"/{robot.name}/") else f"/{robot.name}{topic}"


def state_of(robot: LocalRobot) -> RobotMessage:
    """A robot as other daemons receive it: its topics below its name, without what concerns this daemon alone."""
    state = robot.state(_now_s())
    shared = msgspec.structs.replace(
        state,
        also_at=(),
        frames=None,
        velocity_topic=fleet_name(robot, state.velocity_topic),
        odometry_topic=fleet_name(robot, state.odometry_topic),
        reset_topic=None if state.reset_topic is None else fleet_name(robot, state.reset_topic),
        holder=None if state.holder is None else printable(state.holder, _TEXT),
        holder_address=None,
        unreachable=None if state.unreachable is None else printable(state.unreachable, _TEXT),
    )
    return RobotMessage.of(shared)


def _now_s() -> float:
    return asyncio.get_running_loop().time()
