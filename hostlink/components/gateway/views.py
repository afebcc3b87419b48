"""Views: what the API shows of the hub. These types are the OpenAPI document. Numbers carry their unit."""

import asyncio
import dataclasses
from collections.abc import Callable, Hashable, Iterable, Iterator
from datetime import UTC, datetime
from typing import TypedDict, TypeVar, cast

import msgspec

from hostlink.core.diagnosis.finding import Finding
from hostlink.core.hub.device import CommandEndpoint, Device
from hostlink.core.hub.graph_view import is_derived
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.robot import AnyRobot
from hostlink.core.hub.topic import Topic
from hostlink.core.robot.odometry import OdometrySnapshot
from hostlink.core.robot.standstill import Standstill
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.robot.views import CommandEndpointView, OdometryView, RobotView, TopicView, VelocityView

View = TypeVar("View")

SLICE_S = 0.0002  # of one turn of the event loop: eight robots, or one link with very many topics


class Slices:
    """Spreads the work of one encoder over turns of the event loop. `spent_s`: CPU time of its work."""

    def __init__(self, hub: Hub) -> None:
        self.spent_s = 0.0
        self._turns = hub.turns()

    async def run(self, views: Iterator[View], work: Callable[[View], None]) -> None:
        """Do the work for each view, as many in a turn as fill SLICE_S."""
        now_s = asyncio.get_running_loop().time
        is_done = False

        def work_on_some() -> None:
            nonlocal is_done
            began_s = now_s()
            for view in views:
                work(view)
                if now_s() - began_s >= SLICE_S:
                    break
            else:
                is_done = True
            self.spent_s += now_s() - began_s

        while not is_done:
            await self._turns.run(work_on_some, is_flooding=True)


def node_name(hub: Hub, key: Hashable) -> str:
    """Return the name of a node: a robot's name, a device's link, or a client's number."""
    robot = hub.robots.of_link(key)
    return f"/{str(key).split(' (', maxsplit=1)[0].replace(' ', '_') if robot is None else robot.name}"


def receivers(topic: Topic) -> Iterable[Hashable]:
    """Return the keys of the devices and clients that receive the topic's messages."""
    return (*topic.devices, *(subscriber.key for subscriber in topic.subscribers))


class VelocityAnswer(TypedDict):
    """The velocity after the limits, and its lease.

    limited_by: the setting of the robot that reduces it most; null: none does, or another daemon has the robot.
    """

    velocity: VelocityView
    is_limited: bool
    limited_by: str | None
    lease_s: float
    epoch: int  # commands with it are newer than the last interruption


class StandstillView(TypedDict):
    """Motion of a robot after a stop or a lock, by its odometry.

    state: `stopped`, `moving` or `unknown`. speed_m_s, turn_rad_s: newest; null: no odometry arrived since the stop.
    after_s: time until it was stopped; null unless stopped. reason: why it moves, or why its motion is unknown.
    """

    state: str
    speed_m_s: float | None
    turn_rad_s: float | None
    after_s: float | None
    reason: str


class StoppedRobotView(RobotView):
    """One robot after a stop or a lock, and what was measured since."""

    standstill: StandstillView


class TopicInfoView(TypedDict):
    """A topic of a device: its name in the graph, and the name that the device announced."""

    kind: str
    id: int
    name: str
    own_name: str
    type: str
    md5: str
    buffer_bytes: int


class FindingView(TypedDict):
    """One problem: a code for programs, the cause, the next step, and the numbers found."""

    code: str
    cause: str
    next_step: str
    detail: str


class ClockView(TypedDict):
    """A device's clock and the network to it. Values are null until they are measured.

    offset_s: smallest time from a header stamp to its arrival. drift_ppm: how much faster the device's clock runs.
    round_trip_s: of the network, as TCP measures it. answer_s: from a topic request to the first answer.
    """

    offset_s: float | None
    drift_ppm: float | None
    round_trip_s: float | None
    answer_s: float | None


class LinkView(TypedDict):
    """One live connection: topics, counters, and problems, the most likely cause first.

    robot: name of its robot; null without one. parameters: answers to the device, used until it reconnects.
    """

    number: int
    transport: str
    peer: str
    robot: str | None
    silent_s: float
    diagnosis: list[FindingView]
    topics: list[TopicInfoView]
    parameters: dict[str, list[float | str]]
    seconds: float
    frames_from_device: int
    frames_to_device: int
    bytes_from_device: int
    bytes_to_device: int
    skipped_bytes: int
    unknown_ids: int
    refused_frames: int
    malformed: int
    excess_topics: int
    negotiations: int
    topic_requests: int
    replaced: int
    rejected: dict[str, int]
    slowest_wait_s: float
    oldest_waiting_s: float
    signal_dbm: int | None
    clock: ClockView | None


class EndedLinkView(TypedDict):
    """One of the last connections that ended: the reason, the duration, and its problems."""

    number: int
    peer: str
    robot: str | None
    end: str
    seconds: float
    ended_ago_s: float
    diagnosis: list[FindingView]


class ClosedPortView(TypedDict):
    """A serial port that cannot be opened."""

    name: str
    diagnosis: list[FindingView]


class LinksView(TypedDict):
    """Every live connection, and the last ended ones, the newest first.

    ports: closed serial ports. crashes: how many links an internal error of hostlink ended. refused: how many
    connections were refused, by cause.
    """

    ended: list[EndedLinkView]
    ports: list[ClosedPortView]
    crashes: int
    refused: dict[str, int]
    links: list[LinkView]


def utc_text(stamp_ns: int) -> str:
    """Format a wall time: `2026-11-22T07:43:29.123+00:00`."""
    return datetime.fromtimestamp(stamp_ns / 1e9, UTC).isoformat(timespec="milliseconds")


def robot_view(robot: AnyRobot) -> RobotView:
    """Return the present state of one robot."""
    state = robot.state(asyncio.get_running_loop().time())
    fields = msgspec.structs.asdict(state)
    del fields["odometry_type"], fields["reset_topic"], fields["is_played"]
    view = {
        "name": state.name,
        "connected": state.link is not None,
        **fields,
        "also_at": list(state.also_at),
        "played": state.is_played,
        "locked": state.lock_reason is not None,
        "velocity": velocity_view(state.velocity),
        "odometry": None if state.odometry is None else odometry_view(state.odometry),
        "device_errors": list(state.device_errors),
    }
    return cast(RobotView, view)


def stopped_view(robot: AnyRobot, measured: Standstill) -> StoppedRobotView:
    """Return the present state of one robot, and what was measured after a stop."""
    return {
        **robot_view(robot),
        "standstill": {
            "state": measured.state.value,
            "speed_m_s": _rounded(measured.speed_m_s, 4),
            "turn_rad_s": _rounded(measured.turn_rad_s, 4),
            "after_s": _rounded(measured.after_s, 3),
            "reason": measured.reason,
        },
    }


def command_endpoint_view(endpoint: CommandEndpoint) -> CommandEndpointView:
    """Return what became of a topic that is not a robot's after a stop or a lock."""
    return {
        "link": endpoint.link,
        "peer": endpoint.peer,
        "robot": endpoint.robot,
        "topic": endpoint.topic,
        "type": endpoint.type_name,
        "is_guarded": endpoint.is_guarded,
        "is_locked": endpoint.is_locked,
        "is_zero_sent": not endpoint.reason,
        "reason": endpoint.reason,
        "host": endpoint.host,
    }


def velocity_view(velocity: PlanarVelocity) -> VelocityView:
    """Return the three components of a velocity."""
    return {
        "linear_m_s": velocity.x_m_s,
        "linear_y_m_s": velocity.y_m_s,
        "angular_rad_s": velocity.yaw_rad_s,
    }


def velocity_answer(robot: AnyRobot, requested: PlanarVelocity, limited: PlanarVelocity) -> VelocityAnswer:
    """Return the velocity after the limits, with what reduced it."""
    return {
        "velocity": velocity_view(limited),
        "is_limited": limited != requested,
        "limited_by": None if limited == requested else robot.limited_by(requested),
        "lease_s": robot.admission.lease_s,
        "epoch": robot.admission.epoch,
    }


def odometry_view(known: OdometrySnapshot) -> OdometryView:
    """Return the newest pose with its age."""
    pose = known.pose
    return {
        "pose": None if pose is None else {"x_m": pose.x_m, "y_m": pose.y_m, "theta_rad": pose.theta_rad},
        "twist": None if known.twist is None else velocity_view(known.twist),
        "is_moving": known.is_moving,
        "stamp_ns": known.stamp_ns,
        "age_s": round(known.age_s, 6),
        "rate_hz": round(known.rate_hz, 2),
        "count": known.count,
        "restarts": known.restarts,
        "ignored": known.ignored,
    }


def link_view(device: Device) -> LinkView:
    """Return the present state of one live connection."""
    link, diagnosis = device.link, device.diagnosis
    facts = link.facts()
    clock = facts.clock
    view = {
        "number": link.number,
        "transport": link.kind,
        "peer": link.peer,
        "robot": diagnosis.robot or None,
        "silent_s": round(link.silent_s, 3),
        "diagnosis": finding_views(diagnosis.findings),
        "topics": topic_info_views(device),
        "parameters": {
            name: [*answer.ints, *answer.floats, *answer.strings] for name, answer in device.parameters.items()
        },
        "seconds": round(facts.seconds, 3),
        **dataclasses.asdict(facts.counts),
        "replaced": facts.replaced,
        "rejected": facts.rejected,
        "slowest_wait_s": round(facts.slowest_wait_s, 6),
        "oldest_waiting_s": round(facts.oldest_waiting_s, 6),
        "signal_dbm": diagnosis.monitor.signal_dbm(link.opened_at_s + facts.seconds),
        "clock": None
        if clock is None
        else {
            "offset_s": _rounded(clock.offset_s, 6),
            "drift_ppm": _rounded(clock.drift_ppm, 1),
            "round_trip_s": _rounded(clock.round_trip_s, 6),
            "answer_s": _rounded(clock.answer_s, 6),
        },
    }
    return cast(LinkView, view)


def topic_info_views(device: Device) -> list[TopicInfoView]:
    """Return the topics of one device, under the graph's names and the device's own."""
    return [
        {
            "kind": info.kind.name.lower(),
            "id": info.id,
            "name": device.shown.of(info.name),
            "own_name": info.name,
            "type": info.type,
            "md5": info.md5,
            "buffer_bytes": info.buffer_bytes,
        }
        for info in device.link.topics
    ]


async def links_view(hub: Hub, slices: Slices) -> dict[str, object]:
    """Return a LinksView, ready to be encoded. It is made in slices: topics of many devices are megabytes of JSON."""
    links: list[msgspec.Raw] = []
    devices = hub.robots.devices
    views = (link_view(each) for each in list(devices.values()) if each.link.number in devices)  # one may end meanwhile
    await slices.run(views, lambda view: links.append(msgspec.Raw(msgspec.json.encode(view))))
    now_s = asyncio.get_running_loop().time()
    ended: list[EndedLinkView] = [
        {
            "number": diagnosis.link.number,
            "peer": diagnosis.link.peer,
            "robot": diagnosis.robot or None,
            "end": "" if diagnosis.end is None else diagnosis.end.value,
            "seconds": round(diagnosis.seconds, 3),
            "ended_ago_s": round(now_s - diagnosis.ended_at_s, 3),
            "diagnosis": finding_views(diagnosis.findings),
        }
        for diagnosis in reversed(hub.diagnoses.ended)
    ]
    return {
        "links": links,
        "ended": ended,
        "ports": [{"name": name, "diagnosis": finding_views([each])} for name, each in hub.diagnoses.ports.items()],
        "crashes": hub.isolation.crashes.total(),
        "refused": dict(hub.counts.refused),
    }


def finding_views(findings: Iterable[Finding]) -> list[FindingView]:
    """Return findings in the words of the log and of the documents."""
    return [
        {"code": each.code, "cause": each.cause, "next_step": each.next_step, "detail": each.detail}
        for each in findings
    ]


def topic_views(hub: Hub) -> list[TopicView]:
    """Return every topic of the graph."""
    return [
        {
            "name": topic.name,
            "type": topic.type_name,
            "publishers": len(topic.publishers),
            "subscribers": len(topic.subscribers) + len(topic.devices),
            "messages": topic.messages,
            "is_derived": is_derived(topic),
        }
        for topic in hub.topics.all()
    ]


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
