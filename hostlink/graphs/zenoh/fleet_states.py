"""FleetStates: what other daemons receive of the robots here: a state each second and after each change."""

import asyncio
import re

import msgspec

from hostlink.graphs.zenoh.fleet_messages import MAX_ROBOTS, Live, Motion, PoseState, RobotState, State, encode
from hostlink.graphs.zenoh.fleet_post import Post
from hostlink.hub.hub import Hub
from hostlink.hub.robot import Robot
from hostlink.logs import printable
from hostlink.robot.odometry_estimator import OdometrySnapshot

STATE_INTERVAL_S = 1.0
GREETING_S = 0.5  # after a daemon has appeared: it may not yet know who sends
_TEXT = 200
_DIGITS = 6  # micrometres


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
        known = (
            topics,
            *(msgspec.structs.replace(each, pose=None, velocity=(0.0, 0.0), linear_y_m_s=0.0) for each in states),
        )
        if now_s >= self._due_s or now_s < self._greeting_until_s or known != self._known:
            self._due_s, self._known = now_s + STATE_INTERVAL_S, known
            self._states.put(encode(State(sent_s=now_s, topics=topics, robots=states)))
        elif self._is_live:
            self._send_motions(states)

    def _send_motions(self, states: tuple[RobotState, ...]) -> None:
        """Of the robots that have moved, or whose velocity is another."""
        motions = {state.name: Motion(state.name, state.velocity, state.pose, state.linear_y_m_s) for state in states}
        marks: dict[str, object] = {
            name: (each.velocity, each.linear_y_m_s, each.pose and each.pose.count) for name, each in motions.items()
        }
        moved = tuple(motion for name, motion in motions.items() if marks[name] != self._marks.get(name))
        self._marks = marks
        if moved:
            self._live.put(encode(Live(robots=moved)))

    def states(self) -> tuple[RobotState, ...]:
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


def is_shareable(robot: Robot) -> bool:
    """Whether other daemons can know it by its name."""
    return re.fullmatch(r"\w{1,64}", robot.name, re.ASCII) is not None


def fleet_name(robot: Robot, topic: str) -> str:
    """A topic of a robot as other daemons know it: below the robot's name."""
    return topic if topic.startswith(f"/{robot.name}/") else f"/{robot.name}{topic}"


def state_of(robot: Robot) -> RobotState:
    """A robot as other daemons receive it."""
    gate, shown = robot.gate, robot.shown
    pose = robot.odometry.snapshot(_now_s())
    cause = robot.refusals.cause
    return RobotState(
        name=robot.name,
        link=None if robot.link is None else robot.link.number,
        velocity_topic=fleet_name(robot, shown.velocity),
        odometry_topic=fleet_name(robot, shown.odometry),
        odometry_type=shown.odometry_type,
        reset_topic=None if shown.reset is None else fleet_name(robot, shown.reset),
        holder=None if gate.owner_name is None else printable(gate.owner_name, _TEXT),
        priority=gate.priority,
        lock_reason=gate.lock_reason,
        unreachable=None if cause is None else printable(cause, _TEXT),
        is_played=robot.is_played,
        velocity=(gate.current.x_m_s, gate.current.yaw_rad_s),
        linear_y_m_s=gate.current.y_m_s,
        lease_s=gate.admission.lease_s,
        epoch=gate.admission.epoch,
        pose=None if pose is None else _pose_of(pose),
    )


def _pose_of(known: OdometrySnapshot) -> PoseState:
    return PoseState(
        x_m=round(known.pose.x_m, _DIGITS),
        y_m=round(known.pose.y_m, _DIGITS),
        theta_rad=round(known.pose.theta_rad, _DIGITS),
        linear_m_s=round(known.twist.x_m_s, _DIGITS),
        angular_rad_s=round(known.twist.yaw_rad_s, _DIGITS),
        stamp_ns=known.stamp_ns,
        age_s=round(known.age_s, _DIGITS),
        rate_hz=round(known.rate_hz, 2),
        count=known.count,
        restarts=known.restarts,
        ignored=known.ignored,
        linear_y_m_s=round(known.twist.y_m_s, _DIGITS),
    )


def _now_s() -> float:
    return asyncio.get_running_loop().time()
