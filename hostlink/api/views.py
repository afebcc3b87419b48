"""Views: what the API shows of the hub. The OpenAPI document is made of these types. Numbers carry their unit."""

import asyncio
import functools
from collections.abc import Callable, Hashable, Iterable, Iterator
from typing import TypedDict, TypeVar

import msgspec

from hostlink.diagnosis.finding import Finding
from hostlink.hub.diagnoses import Diagnosis
from hostlink.hub.hub import Hub
from hostlink.hub.robot import Robot
from hostlink.hub.topic import Topic
from hostlink.robot.odometry import OdometrySnapshot
from hostlink.robot.standstill import Standstill
from hostlink.robot.velocity import PlanarVelocity

View = TypeVar("View")

SLICE_S = 0.0002  # of one turn of the loop: eight robots, or one link with very many topics


class Slices:
    """The turns of one encoder; `spent_s` is what its work has cost."""

    def __init__(self, hub: Hub) -> None:
        self.spent_s = 0.0
        self._turns = hub.turns()

    async def run(self, views: Iterator[View], work: Callable[[View], None]) -> None:
        """Make the views and do the work for each, in a turn as many as fill SLICE_S."""
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
    """A robot by its name, another device by its link, a client by its number."""
    robot = hub.robots.of_link(key)
    return f"/{str(key).split(' (', maxsplit=1)[0].replace(' ', '_') if robot is None else robot.name}"


def receivers(topic: Topic) -> Iterable[Hashable]:
    """The keys of the devices and the clients that get its messages."""
    return (*topic.devices, *(subscriber.key for subscriber in topic.subscribers))


class VelocityView(TypedDict):
    """Forwards, to the left, and counter-clockwise."""

    linear_m_s: float
    linear_y_m_s: float
    angular_rad_s: float


class VelocityAnswer(TypedDict):
    """The velocity after the limits, and how long it lasts.

    limited_by: the setting of the robot that slows it down most; null: none does, or its daemon is another.
    """

    velocity: VelocityView
    is_limited: bool
    limited_by: str | None
    lease_s: float
    epoch: int  # a command with it is meant since the newest interruption


class PoseView(TypedDict):
    """A pose by a robot's odometry: metres, radians, counter-clockwise from its x axis."""

    x_m: float
    y_m: float
    theta_rad: float


class OdometryView(TypedDict):
    """The newest pose, and the motion over the last few."""

    pose: PoseView
    twist: VelocityView
    stamp_ns: int
    age_s: float
    rate_hz: float
    count: int
    restarts: int
    ignored: int


class RobotView(TypedDict):
    """One robot: its topics, its driver, its velocity, its odometry, its device.

    holder_address: from which who drives it is connected; null: nobody, a part of a daemon, or at another daemon.
    played: its device is a recording, which obeys nobody. unreachable: why its device could not receive the last
    velocity; null: it could. host: the daemon that has its link; null: this one. also_at: other daemons that have a
    robot of this name. wheel_separation_m, kinematics: as they are configured. frames: how many its device has sent on
    this link, so that a reader notices when it falls silent; null: it is not connected, or not here. epoch: counts
    interruptions: stops, locks, reconnections. battery_v, battery_percent: the newest that its device has sent on this
    link; null: it sends none. signal_dbm: of its device's WiFi; null: it does not report it. device_errors: the codes
    of what `hostlink doctor` finds wrong with the device, the likeliest cause first. firmware: name and version, as
    the device logs them; null: it does not.
    """

    name: str
    host: str | None
    also_at: list[str]
    connected: bool
    link: int | None
    frames: int | None
    velocity_topic: str
    odometry_topic: str
    played: bool
    holder: str | None
    holder_address: str | None
    priority: int | None
    locked: bool
    lock_reason: str | None
    epoch: int
    unreachable: str | None
    wheel_separation_m: float | None
    kinematics: str
    lease_s: float
    velocity: VelocityView
    odometry: OdometryView | None
    battery_v: float | None
    battery_percent: float | None
    signal_dbm: int | None
    device_errors: list[str]
    firmware: str | None


class StandstillView(TypedDict):
    """What a robot's odometry says after a stop or a lock.

    state: stands, moves or unknown. speed_m_s, turn_rad_s: the newest; null: no odometry came since then. after_s: when
    it stood first; null unless it stands. reason: why it moves, or why it is not known; empty if it stands.
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
    """A topic of a device: its name in the graph, and the one that the device announced."""

    kind: str
    id: int
    name: str
    own_name: str
    type: str
    md5: str
    buffer_bytes: int


class FindingView(TypedDict):
    """One thing that is wrong: a name for programs, the cause, the next step, and the numbers found."""

    code: str
    cause: str
    next_step: str
    detail: str


class ClockView(TypedDict):
    """A device's clock and the way to it, in parts that are null until they are measured.

    offset_s: from a header stamp to its arrival, on the fastest way. drift_ppm: how much faster it runs.
    round_trip_s: of the network, as TCP measures it. answer_s: from a request for its topics to the first of them.
    """

    offset_s: float | None
    drift_ppm: float | None
    round_trip_s: float | None
    answer_s: float | None


class LinkView(TypedDict):
    """One live connection, its topics, its counters, and what is wrong with it, the likeliest cause first.

    robot: the name of its robot; null where it is none. parameters: what its device was answered, and uses until it
    connects again; an empty list: there was none.
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
    """One of the last connections that ended: why, after how long, and what was wrong with it."""

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


class LinkHistoryView(TypedDict):
    """The last connections that ended, latest first; serial ports that cannot be opened; how many links a fault of
    hostlink itself ended; how many were refused, by cause.
    """

    ended: list[EndedLinkView]
    ports: list[ClosedPortView]
    crashes: int
    refused: dict[str, int]


class LinksView(LinkHistoryView):
    """Every live connection, and what became of others."""

    links: list[LinkView]


class TopicView(TypedDict):
    """A topic of the graph."""

    name: str
    type: str
    publishers: int
    subscribers: int
    messages: int


def robot_view(robot: Robot) -> RobotView:
    """One robot as it is now."""
    state = robot.state(asyncio.get_running_loop().time())
    return {
        "name": state.name,
        "host": state.host,
        "also_at": list(state.also_at),
        "connected": state.link is not None,
        "link": state.link,
        "frames": state.frames,
        "velocity_topic": state.velocity_topic,
        "odometry_topic": state.odometry_topic,
        "played": state.is_played,
        "holder": state.holder,
        "holder_address": state.holder_address,
        "priority": state.priority,
        "locked": state.lock_reason is not None,
        "lock_reason": state.lock_reason,
        "epoch": state.epoch,
        "unreachable": state.unreachable,
        "wheel_separation_m": state.wheel_separation_m,
        "kinematics": state.kinematics,
        "lease_s": state.lease_s,
        "velocity": velocity_view(state.velocity),
        "odometry": None if state.odometry is None else odometry_view(state.odometry),
        "battery_v": state.battery_v,
        "battery_percent": state.battery_percent,
        "signal_dbm": state.signal_dbm,
        "device_errors": list(state.device_errors),
        "firmware": state.firmware,
    }


def stopped_view(robot: Robot, measured: Standstill) -> StoppedRobotView:
    """One robot as it is now, and what was measured after a stop."""
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


def velocity_view(velocity: PlanarVelocity) -> VelocityView:
    """The three numbers of a robot on a floor."""
    return {
        "linear_m_s": velocity.x_m_s,
        "linear_y_m_s": velocity.y_m_s,
        "angular_rad_s": velocity.yaw_rad_s,
    }


def velocity_answer(robot: Robot, requested: PlanarVelocity, limited: PlanarVelocity) -> VelocityAnswer:
    """The velocity after the limits, beside the requested one."""
    return {
        "velocity": velocity_view(limited),
        "is_limited": limited != requested,
        "limited_by": robot.limited_by(requested),
        "lease_s": robot.admission.lease_s,
        "epoch": robot.admission.epoch,
    }


def odometry_view(known: OdometrySnapshot) -> OdometryView:
    """The newest pose with its age."""
    return {
        "pose": {"x_m": known.pose.x_m, "y_m": known.pose.y_m, "theta_rad": known.pose.theta_rad},
        "twist": velocity_view(known.twist),
        "stamp_ns": known.stamp_ns,
        "age_s": round(known.age_s, 6),
        "rate_hz": round(known.rate_hz, 2),
        "count": known.count,
        "restarts": known.restarts,
        "ignored": known.ignored,
    }


def link_view(hub: Hub, diagnosis: Diagnosis) -> LinkView:
    """One live connection as it is now."""
    link = diagnosis.link
    facts = link.facts()
    counts, clock = facts.counts, facts.clock
    return {
        "number": link.number,
        "transport": link.kind,
        "peer": link.peer,
        "robot": diagnosis.robot or None,
        "silent_s": round(link.silent_s, 3),
        "diagnosis": finding_views(diagnosis.findings),
        "topics": topic_info_views(hub, diagnosis),
        "parameters": {
            name: [*answer.ints, *answer.floats, *answer.strings]
            for name, answer in hub.links.answered_parameters(link).items()
        },
        "seconds": round(facts.seconds, 3),
        "frames_from_device": counts.frames_from_device,
        "frames_to_device": counts.frames_to_device,
        "bytes_from_device": counts.bytes_from_device,
        "bytes_to_device": counts.bytes_to_device,
        "skipped_bytes": counts.skipped_bytes,
        "unknown_ids": counts.unknown_ids,
        "refused_frames": counts.refused_frames,
        "malformed": counts.malformed,
        "excess_topics": counts.excess_topics,
        "negotiations": counts.negotiations,
        "topic_requests": counts.topic_requests,
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


def topic_info_views(hub: Hub, diagnosis: Diagnosis) -> list[TopicInfoView]:
    """The topics of one device, under the graph's names and its own."""
    shown_name = functools.partial(hub.links.shown_name, diagnosis.link)
    return [
        {
            "kind": info.kind.name.lower(),
            "id": info.topic_id,
            "name": shown_name(info.name),
            "own_name": info.name,
            "type": info.type,
            "md5": info.md5,
            "buffer_bytes": info.buffer_bytes,
        }
        for info in diagnosis.link.topics
    ]


def link_views(hub: Hub) -> Iterator[LinkView]:
    """Every live connection, each as it is when the iteration reaches it."""
    for link in hub.links.all():
        diagnosis = hub.diagnoses.find(link.number)
        if diagnosis is not None:
            yield link_view(hub, diagnosis)


async def links_view(hub: Hub, slices: Slices) -> dict[str, object]:
    """A LinksView, ready to be encoded. The topics of many devices are megabytes of JSON: so it is made in slices."""
    links: list[msgspec.Raw] = []
    await slices.run(link_views(hub), lambda view: links.append(msgspec.Raw(msgspec.json.encode(view))))
    return {"links": links, **link_history_view(hub)}


def link_history_view(hub: Hub) -> LinkHistoryView:
    """The connections that are not live."""
    return {
        "ended": ended_views(hub),
        "ports": [{"name": name, "diagnosis": finding_views([each])} for name, each in hub.diagnoses.ports.items()],
        "crashes": hub.isolation.crashes.total(),
        "refused": dict(hub.counts.refused),
    }


def ended_views(hub: Hub) -> list[EndedLinkView]:
    """The last links that ended, the latest first."""
    now_s = asyncio.get_running_loop().time()
    return [
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


def finding_views(findings: Iterable[Finding]) -> list[FindingView]:
    """In the words of the log and of the documents."""
    return [
        {"code": each.code, "cause": each.cause, "next_step": each.next_step, "detail": each.detail}
        for each in findings
    ]


def topic_views(hub: Hub) -> list[TopicView]:
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


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
