"""The JSON of robots and topics that REST, the events and the client show. Numbers carry their unit. Pure."""

from typing import TypedDict


class VelocityView(TypedDict):
    """Velocity forwards, to the left, and counter-clockwise."""

    linear_m_s: float
    linear_y_m_s: float
    angular_rad_s: float


class PoseView(TypedDict):
    """A pose by a robot's odometry: metres, and radians counter-clockwise from the x axis."""

    x_m: float
    y_m: float
    theta_rad: float


class OdometryView(TypedDict):
    """The newest pose, and the motion over the last poses.

    pose, twist: null if the robot's feedback does not tell it.
    is_moving: of a robot whose feedback tells only that; else null.
    """

    pose: PoseView | None
    twist: VelocityView | None
    is_moving: bool | None
    stamp_ns: int
    age_s: float
    rate_hz: float
    count: int
    restarts: int
    ignored: int


class RobotView(TypedDict):
    """One robot: its topics, its driver, its velocity, its odometry, its device.

    holder_address: address of the driver's connection; null: no driver, a part of a daemon, or at another daemon.
    command_type: type of velocity_topic. feedback: what is known of its motion: pose, velocity, motion (whether it
    moves) or none. odometry_topic: null: the device publishes neither pose nor velocity. played: the device is a
    recording that is played, which obeys no command. unreachable: why the device could not receive the last
    velocity; null: it could. host: the daemon that has its link; null: this one. also_at: other daemons with a
    robot of this name. wheel_separation_m, kinematics: as configured. frames: number that the device has sent on
    this link, so that a reader notices silence; null: not connected, or at another daemon. epoch: number of
    interruptions: stops, locks, reconnections. battery_v, battery_percent: newest values that the device has sent
    on this link; null: it sends none. signal_dbm: WiFi signal of the device; null: it does not report it.
    device_errors: codes of what `hostlink doctor` finds wrong with the device, the most likely cause first.
    firmware: name and version in the device's log; null: it logs none.
    """

    name: str
    host: str | None
    also_at: list[str]
    connected: bool
    link: int | None
    frames: int | None
    velocity_topic: str
    command_type: str
    feedback: str
    odometry_topic: str | None
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


class CommandEndpointView(TypedDict):
    """A topic that commands a motion and is not a robot's, after a stop or a lock of all.

    robot: of its board; null: the board is not a robot. is_guarded: it has a gate; otherwise hostlink only sends zeros
    and refuses messages under a lock. reason: why it was not sent a zero; empty if it was. host: the daemon of the
    fleet that has the board; null: this one.
    """

    link: int
    peer: str
    robot: str | None
    topic: str
    type: str
    is_guarded: bool
    is_locked: bool
    is_zero_sent: bool
    reason: str
    host: str | None


class TopicView(TypedDict):
    """A topic of the graph."""

    name: str
    type: str  # as geometry_msgs/Twist; empty while it is unknown
    publishers: int
    subscribers: int
    messages: int  # that have passed
    is_derived: bool  # hostlink publishes it, and mostly only while it has subscribers
