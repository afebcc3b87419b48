"""The JSON of devices and their connections that REST and the events show. Numbers carry their unit. Pure."""

from typing import TypedDict

from hostlink.core.robot.views import CommandEndpointView


class FindingView(TypedDict):
    """One problem: a code for programs, the cause, the next step, and the numbers found."""

    code: str
    cause: str
    next_step: str
    detail: str


class TopicInfoView(TypedDict):
    """A topic of a device: its name in the graph, and the name that the device announced."""

    kind: str
    id: int
    name: str
    own_name: str
    type: str
    md5: str
    buffer_bytes: int


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

    protocol: rosserial, micro-ROS, or the name of an installed one. robot: name of its robot; null without one.
    parameters: answers to the device, used until it reconnects. lost_messages: of the device, by the gaps in their
    numbers; rosserial has none, and those that are sent again are not counted.
    """

    number: int
    transport: str
    protocol: str
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
    lost_messages: int
    replaced: int
    rejected: dict[str, int]
    slowest_wait_s: float
    oldest_waiting_s: float
    signal_dbm: int | None
    clock: ClockView | None


class EndedLinkView(TypedDict):
    """One of the last connections that ended: the reason, the duration, and its problems."""

    number: int
    protocol: str
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


class OtherLinksView(TypedDict):
    """The last connections that ended, the newest first.

    ports: closed serial ports. crashes: how many links an internal error of hostlink ended. refused: how many
    connections were refused, by cause.
    """

    ended: list[EndedLinkView]
    ports: list[ClosedPortView]
    crashes: int
    refused: dict[str, int]


class LinksView(OtherLinksView):
    """Every live connection, and the last ended ones, the newest first.

    ports: closed serial ports. crashes: how many links an internal error of hostlink ended. refused: how many
    connections were refused, by cause.
    """

    links: list[LinkView]


class ArrivalView(TypedDict):
    """Arrivals of one address and cause in the last minute that are not a robot. ago_s: age of the last one."""

    way: str
    peer: str
    cause: str
    text: str
    count: int
    ago_s: float
    diagnosis: list[FindingView]


class DeviceTopicView(TypedDict):
    """A topic of a device that counts for what it is, by its name in the graph.

    role: `command` of its robot, `velocity` (a further one, with a gate), `unguarded` (looks like a command, and
    nothing guards it), `locked` (a lock refuses it by the settings), `ignored` (no command by the settings),
    `actuator` (sets positions), or `feedback` (tells of the robot's motion).
    """

    name: str
    type: str
    role: str


class RefusedTopicView(TypedDict):
    """A topic that a device announced and hostlink refused, by the device's name of it, and why."""

    name: str
    type: str
    reason: str


class DeviceView(TypedDict):
    """Whether a connected device is a robot, and why.

    protocol: rosserial, micro-ROS, or the name of an installed one. robot: null: it is not a robot. part_of: the robot
    of several devices of which it is one; null: none. is_spatial: its velocity topics take all six numbers, by the
    settings. name_from: source of its name. settings: the robot whose settings in hostlink.toml apply to it; null:
    none. refused: why they do not fit the device; empty if they do. feedback: what is known of its motion: pose,
    velocity, motion or none. lacks: what is missing to know more. refused_topics: for example those with a wrong md5
    sum. suggestion: lines of hostlink.toml that put the unguarded topics in order.
    """

    link: int
    peer: str
    protocol: str
    robot: str | None
    part_of: str | None
    is_spatial: bool
    name_from: str
    settings: str | None
    refused: str
    feedback: str
    lacks: str
    topics: list[DeviceTopicView]
    refused_topics: list[RefusedTopicView]
    unguarded: list[CommandEndpointView]
    suggestion: str


class DevicesView(TypedDict):
    """Every connected device, oldest first. lock_reason: of a lock of all, which holds for boards too; null: none."""

    devices: list[DeviceView]
    lock_reason: str | None
