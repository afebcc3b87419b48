"""Model of robots: from the endpoints of devices and the settings, which robots there are and what each can do. Pure.

A robot is what takes a velocity; everything else is an ability that it has or lacks. The model knows nothing of a
device's protocol.

| endpoint to the device                                       | what it is                                            |
|--------------------------------------------------------------|-------------------------------------------------------|
| what a robot's settings name as its command                  | the command of that robot; while one of these topics  |
|                                                              | is missing, what is a command by itself               |
| Twist, TwistStamped with a name that tells of motion;        | a command by itself                                   |
| AckermannDrive, AckermannDriveStamped                        |                                                       |
| a number, a text or a Twist whose name tells of motion       | unguarded: a finding says which setting makes a robot |
| JointState, Joy, servos                                      | actuators                                             |
| everything else                                              | data                                                  |
"""

import difflib
import itertools
import json
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, NamedTuple

from hostlink.core.robot.command_types import (
    ACKERMANN_TYPES,
    ARRAY_TYPES,
    JOINT_STATE_TYPE,
    JOY_TYPE,
    NUMBER_TYPES,
    TEXT_TYPES,
    VECTOR_TYPE,
    TopicType,
)
from hostlink.core.robot.feedback import recognised
from hostlink.core.robot.readings import POSE_TYPES, VELOCITY_TYPES
from hostlink.core.robot.velocity import TWIST_STAMPED_TYPE, TWIST_TYPE
from hostlink.core.runtime.topic_names import plain_name

LONGEST_NAME: Final = 64  # characters of a robot's name; names are used in logs, paths and labels
RESET_TYPE: Final = "std_msgs/Empty"
STOP_SERVICE_TYPES: Final = ("std_srvs/Empty", "std_srvs/Trigger")  # without a field in the request
_USUAL_NAMES: Final = ("velocity_commands", "cmd_vel")  # the likelier first
_USUAL_POSES: Final = ("nav_msgs/Odometry", "geometry_msgs/Pose2D")
_TWISTS: Final = (TWIST_TYPE, TWIST_STAMPED_TYPE)
_NO_MOTION: Final = frozenset({"std_msgs/Bool", "std_msgs/Empty", "std_msgs/ColorRGBA", "std_msgs/Time"})
_MOTION: Final = re.compile(
    r"vel|drive|twist|cmd|command|control|(?<!e)mot(ion|or)|move|mov$|speed|teleop", re.IGNORECASE
)
_SUSPECT: Final = re.compile(
    r"vel(ocity|ocities)?$|^vel|^cmd|cmds?$|command|control|(?<!e)mot(ion|or)|mtr|wheel|speed|spd|pwm|dut(y|ies)|steer|throttle"
    r"|thrust|traction|move|(?<![a-z])mov|drive|rotat|joy|rpm|(?<![a-z])esc(?![a-z])|^dir$|omega|volt(age)?s?(?![a-z])"
    r"|^(front|rear|back)?_?(left|right|[lr])$|^[fbr][lr]$|^m\d$|^[uvw]_?(left|right|[lr])$"  # whole names
    r"|vitesse|moteur|^(gauche|droite|avance)|^(izq|der)(uierda|echa)?$|geschwindigkeit|^(links|rechts)$|lenk",
    re.IGNORECASE,
)
_SPOKEN: Final = re.compile(r"input|arduino|ard_|_ard|key|direction|action|manual|teleop|wasd", re.IGNORECASE)  # texts
# Of the words of a last part, the first of these that is found decides whether its number is a rate or a position.
_RATE: Final = re.compile(r"(?<!le)vel(ocity|ocities)?(?![a-z])|speed|spd|rpm|throttle|dut(y|ies)", re.IGNORECASE)
_POSITION: Final = re.compile(r"servo|stepper|angle|position", re.IGNORECASE)
_MOTOR: Final = re.compile(r"motor|wheel|pwm|steer", re.IGNORECASE)
# Words of a whole name whose motors set positions.
_ACTUATOR: Final = re.compile(
    rf"{_POSITION.pattern}|(?:^|[/_])arm(?![a-z])|joint|gripper|claw|actuat|lift|(?:^|[/_]|left|right)wing",
    re.IGNORECASE,
)
_TRIGGER: Final = re.compile(
    r"open|close|launch|fire|shoot|release|drop|grip|kick|throw|pick|forward|backward|^(back|left|right|go|turn)",
    re.IGNORECASE,
)
# Words of a topic's name that tell what it is, but not whose.
_COMMON: Final = frozenset({
    "ackermann", "base", "cb", "cmd", "cmdvel", "command", "commands", "control", "controller", "ctrl", "drive", "from",
    "in", "input", "motion", "motor", "motors", "move", "movement", "msg", "mux", "nav", "out", "output", "raw", "ref",
    "robot", "safe", "scaled", "set", "setpoint", "smooth", "smoothed", "speed", "stamped", "sub", "target", "teleop",
    "the", "to", "topic", "twist", "unstamped", "vel", "velocities", "velocity", "wheel", "wheels",
})  # fmt: skip
_SHORTEST_WORD: Final = 3
_TRIGGERS: Final = ("std_msgs/Empty", "std_msgs/Bool")
_SIDES: Final = (
    ("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"), ("izquierda", "derecha"), ("izq", "der"),
    ("gauche", "droite"), ("links", "rechts"), ("l", "r"), ("L", "R"), ("G", "D"),
)  # fmt: skip
_NO_WHEEL: Final = re.compile(r"mode|steer|rotat|turn|limit|enable", re.IGNORECASE)
_STEERING: Final = re.compile(r"steer", re.IGNORECASE)
_THROTTLE: Final = re.compile(r"throttle|speed|motor|pwm|drive|vel", re.IGNORECASE)
# What a number of wheels needs besides its topics, in a suggestion.
_WHEELS_NEED: Final = {
    1: (),
    2: (),
    3: ('kinematics = "omni3"', "wheel_distance_m = 0.1"),
    4: ('kinematics = "skid_steer"',),
}
_UNSIGNED: Final = "std_msgs/UInt"
_SHORT: Final = "std_msgs/Int8"  # holds at most 127


class Endpoint(NamedTuple):
    """Topic of a device as the device announces it."""

    name: str
    type_name: str
    is_to_device: bool


class CommandKind(StrEnum):
    """Ways to command a robot."""

    TWIST = "twist"
    ACKERMANN = "ackermann"
    WHEELS = "wheels"
    JOY = "joy"
    WORDS = "words"
    THROTTLE = "throttle"
    VECTOR = "vector"


class Role(StrEnum):
    """Role of a topic for its device, as `hostlink robots --explain` shows it."""

    COMMAND = "command"  # of its robot
    VELOCITY = "velocity"  # a further one, with a gate
    UNGUARDED = "unguarded"  # looks like a command, and nothing guards it
    LOCKED = "locked"  # a lock refuses it, by the settings
    IGNORED = "ignored"  # it commands no motion, by the settings
    ACTUATOR = "actuator"  # sets positions
    FEEDBACK = "feedback"  # tells of its robot's motion
    DATA = "data"


class CommandSettings(NamedTuple):
    """Settings of one robot's command. Topics are as the device names them, with or without a slash in front."""

    kind: CommandKind | None = None  # None: it is recognised
    topics: tuple[str, ...] = ()  # that command it; empty: they are recognised
    odometry: str | None = None  # the topic of its pose or velocity; "": it has none; None: it is recognised
    ignored: frozenset[str] = frozenset()  # topics that command no motion, also if their name and type say so
    locked: frozenset[str] = frozenset()  # topics of no velocity that a lock refuses, for example of servos
    is_spatial: bool = False  # its Twists have six numbers: it is guarded, but no robot of the plane
    devices: tuple[str, ...] = ()  # addresses, ports and names of its devices, if it consists of several
    command_device: str | None = None  # the one that is commanded; None: the only one that takes a velocity
    rests: tuple[float, ...] = ()  # number at rest of each of `topics`; empty: zero
    stop_service: str | None = None  # service of the device that is called with each zero, because a zero is not obeyed


NO_SETTINGS: Final = CommandSettings()
_ONE_TOPIC: Final = (CommandKind.JOY, CommandKind.WORDS, CommandKind.VECTOR)
_MOST_NAMED: Final = 8  # topics of a device, in a sentence


def matched(settings: CommandSettings, endpoints: Sequence[Endpoint]) -> CommandSettings:
    """Return the settings with the names of topics as this device announces them. Others stay as they are."""
    taken = [each.name for each in endpoints if each.is_to_device]
    sent = [each.name for each in endpoints if not each.is_to_device]
    return settings._replace(
        topics=tuple(announced(name, taken) for name in settings.topics),
        odometry=settings.odometry and announced(settings.odometry, sent),
        ignored=_all_announced(settings.ignored, taken),
        locked=_all_announced(settings.locked, taken),
    )


def announced(name: str, names: Collection[str]) -> str:
    """Return a name of the settings as a device announces it, with these names; unchanged if it does not."""
    return name if name in names else next((each for each in names if plain_name(each) == plain_name(name)), name)


def _all_announced(wanted: frozenset[str], names: Sequence[str]) -> frozenset[str]:
    known = set(map(plain_name, wanted))
    return wanted | {name for name in names if plain_name(name) in known} if known else wanted


def has_command(settings: CommandSettings, endpoints: Sequence[Endpoint]) -> bool:
    """Whether a device has every topic that the settings name as the robot's command."""
    return _taken(endpoints).keys() >= set(map(plain_name, settings.topics))


def _taken(endpoints: Sequence[Endpoint]) -> dict[str, Endpoint]:
    return {plain_name(each.name): each for each in endpoints if each.is_to_device}


def misfit(settings: CommandSettings, endpoints: Sequence[Endpoint]) -> str:
    """Return which topics the settings name as the command and the devices do not announce; empty: none."""
    taken = _taken(endpoints)
    missing = [name for name in settings.topics if plain_name(name) not in taken]
    if not missing:
        return ""
    key = "command_topic" if settings.kind is None else f"{settings.kind}.topics"
    if settings.kind in _ONE_TOPIC:
        key = f"{settings.kind}.topic"
    shown = [f"{each.name} ({each.type_name})" for each in taken.values()][:_MOST_NAMED]
    topics = f"its topics are {', '.join(shown)}" if shown else "it takes no topic"
    return f"{key} names {' and '.join(missing)}, which {_nobody(settings)}{nearest(missing, taken)}; {topics}"


def unannounced(settings: CommandSettings, endpoints: Sequence[Endpoint], services: Collection[str]) -> str:
    """Return which other names of the settings no device of the robot announces; empty: none."""
    taken = [each.name for each in endpoints if each.is_to_device]
    sent = [each.name for each in endpoints if not each.is_to_device]
    lines = []
    for key, wanted, known in (
        ("locked_topics", sorted(settings.locked), taken),
        ("not_commands", sorted(settings.ignored), taken),
        ("feedback.topic", [settings.odometry or ""], sent),
        ("stop_service", [settings.stop_service or ""], services),
    ):
        missing = [name for name in wanted if name and plain_name(name) not in set(map(plain_name, known))]
        if missing:
            lines.append(f"{key} names {' and '.join(missing)}, which {_nobody(settings)}{nearest(missing, known)}")
    return "; ".join(lines)


def _nobody(settings: CommandSettings) -> str:
    return "none of its boards announces" if settings.devices else "the board does not announce"


def nearest(missing: Sequence[str], known: Iterable[str]) -> str:
    """Return a question after the names that are nearest to missing ones; empty: none is near."""
    names = sorted({plain_name(name) for name in known})
    near = [difflib.get_close_matches(plain_name(name), names, n=1) for name in missing]
    found = dict.fromkeys(name for each in near for name in each)
    return f" (did you mean {' and '.join(found)}?)" if found else ""


@dataclass(frozen=True, slots=True)
class RobotTopicNames:
    """A robot and the topics by which it is driven and read, by one set of names.

    `commands`: its topics to the device, at least one. `odometry`: topic of its pose, or of its velocity; None: it
    publishes neither.
    """

    name: str
    commands: tuple[TopicType, ...]
    odometry: str | None = None
    odometry_type: str | None = None
    reset: str | None = None
    kind: CommandKind = CommandKind.TWIST

    @property
    def velocity(self) -> str:
        """Name of its first command topic."""
        return self.commands[0].name

    @property
    def velocity_type(self) -> str:
        """Type of its first command topic."""
        return self.commands[0].type_name

    @property
    def namespace(self) -> tuple[str, ...]:
        """Common namespace of velocity and odometry; otherwise that of the velocity, or of the odometry."""
        velocity, odometry = namespace_of(self.velocity), namespace_of(self.odometry or "")
        return _common(velocity, odometry) or velocity or odometry

    @property
    def own(self) -> dict[str, str]:
        """The topics that no other device may use with another type, and their types.

        Its commands, wherever they are. The others in its namespace.
        """
        others = {}
        if self.odometry is not None and self.odometry_type is not None:
            others[self.odometry] = self.odometry_type
        if self.reset is not None:
            others[self.reset] = RESET_TYPE
        here = self.namespace
        own = {name: type_name for name, type_name in others.items() if namespace_of(name)[: len(here)] == here}
        return own | dict(self.commands)


def find_robot(endpoints: Sequence[Endpoint], settings: CommandSettings = NO_SETTINGS) -> RobotTopicNames | None:
    """Return the robot that a device is; None if it takes no velocity.

    Its name is that of the command's namespace, else the word in the command's own name; empty if neither tells.
    """
    commands, kind = _commands(endpoints, settings)
    if not commands or settings.is_spatial:
        return None
    velocity = commands[0].name
    odometry = _odometry(endpoints, velocity, settings)
    here = {namespace_of(velocity)} | ({namespace_of(odometry.name)} if odometry is not None else set())
    resets = [
        each.name
        for each in endpoints
        if each.is_to_device
        and each.type_name == RESET_TYPE
        and "reset" in leaf_of(each.name)
        and namespace_of(each.name) in here
    ]
    reset = min(resets, key=lambda topic: ("odom" not in leaf_of(topic), topic), default=None)
    return RobotTopicNames(
        name_of(velocity, "" if odometry is None else odometry.name),
        commands,
        None if odometry is None else odometry.name,
        None if odometry is None else odometry.type_name,
        reset,
        kind,
    )


def is_velocity(endpoint: Endpoint, ignored: frozenset[str] = frozenset()) -> bool:
    """Whether a topic drives its device, by type and name."""
    if not endpoint.is_to_device or endpoint.name in ignored:
        return False
    return endpoint.type_name in ACKERMANN_TYPES or (
        endpoint.type_name in _TWISTS and _MOTION.search(endpoint.name) is not None
    )


def unguarded(
    endpoints: Sequence[Endpoint],
    settings: CommandSettings = NO_SETTINGS,
    guarded: Collection[str] = (),
) -> list[Endpoint]:
    """Return the endpoints that look like commands of a motion, and that nothing guards.

    `guarded`: names of the topics that have a gate. The namespace of such a topic is the robot's name: that a robot is
    named `big_wheel` does not tell what its topics are for.
    """
    passed = {*guarded, *settings.ignored, *settings.locked}
    robots = {space for space in map(namespace_of, guarded) if not _COMMON.issuperset(map(str.lower, space))}
    return [
        each
        for each in endpoints
        if each.is_to_device
        and each.name not in passed
        and (
            each.type_name in {*_TWISTS, *ACKERMANN_TYPES, JOY_TYPE}
            or each.name in settings.topics
            or _looks_like_motion(each, robots)
        )
    ]


def actuators(endpoints: Sequence[Endpoint], settings: CommandSettings = NO_SETTINGS) -> list[Endpoint]:
    """Return the endpoints that set positions: servos, joints, a joystick that a board reads."""
    commands = {topic.name for topic in _commands(endpoints, settings)[0]}
    commands |= {each.name for each in endpoints if is_velocity(each)}
    return [each for each in endpoints if each.is_to_device and each.name not in commands and _is_position(each)]


def roles(
    endpoints: Sequence[Endpoint],
    settings: CommandSettings,
    *,
    commands: Collection[str],
    guarded: Collection[str],
    feedback: Collection[str],
) -> list[tuple[Endpoint, Role]]:
    """Return what each topic is for its device. `commands`, `guarded` and `feedback` are names of topics."""
    to_device: dict[str, Role] = {each.name: Role.ACTUATOR for each in actuators(endpoints, settings)}
    to_device |= {each.name: Role.UNGUARDED for each in unguarded(endpoints, settings, guarded)}
    to_device |= dict.fromkeys(settings.locked, Role.LOCKED) | dict.fromkeys(settings.ignored, Role.IGNORED)
    to_device |= dict.fromkeys(guarded, Role.VELOCITY) | dict.fromkeys(commands, Role.COMMAND)
    from_device = dict.fromkeys(feedback, Role.FEEDBACK)
    return [(each, (to_device if each.is_to_device else from_device).get(each.name, Role.DATA)) for each in endpoints]


def name_of(command: str, odometry: str = "") -> str:
    """Return the name of the robot that a topic commands: its namespace, else a word in its name; else empty.

    Of the namespace counts what its odometry has in common with it, if that is anything.
    """
    namespace = namespace_of(command)
    name = "_".join(_common(namespace, namespace_of(odometry)) or namespace)
    if not name:
        words = [word for word in re.split(r"[^A-Za-z0-9]+", leaf_of(command)) if word.lower() not in _COMMON]
        name = "_".join(words) if any(map(_is_telling, words)) else ""
    return re.sub(r"\W", "_", name, flags=re.ASCII)[:LONGEST_NAME]


def name_of_node(node: str) -> str:
    """Return the name of the robot whose device has this node: the node's namespace, else its own name."""
    *namespace, name = _parts(node) or [""]
    return re.sub(r"\W", "_", "_".join(namespace) or name, flags=re.ASCII)[:LONGEST_NAME]


def motion_of(command: str) -> str:
    """Return what a topic commands. Topics of one motion are ways to command the same thing, as a base.

    They have one namespace, and their names differ only in words such as cmd, vel, drive or stamped.
    """
    words = [word for word in re.split(r"[^A-Za-z0-9]+", leaf_of(command)) if word.lower() not in _COMMON]
    return "/".join(("", *namespace_of(command), "_".join(words)))


def _is_telling(word: str) -> bool:
    return len(word) >= _SHORTEST_WORD and word.isalpha() and (word.islower() or word[0].isupper())


class Suggestion(NamedTuple):
    """Lines of hostlink.toml that make a robot of a device at an address."""

    name: str
    address: str
    lines: str


def suggest(
    suspects: Sequence[Endpoint], name: str, address: str, peer: str, others: Mapping[str, Suggestion | None]
) -> Suggestion:
    """Return the suggestion for a device, with a name of its own. Equal devices at one address share one.

    `others`: by the names of robots, the suggestions for other devices; None: there is such a robot. A device whose
    name another one has at the same address is told apart by its port, which is in `peer`.
    """
    chosen, place, number = name, address, 1
    while True:
        new, other = Suggestion(chosen, address, suggestion(suspects, chosen, place)), others.get(chosen)
        if chosen not in others or new == other:
            return new
        if other is not None and other.address == address:
            place = peer
        number += 1
        chosen = f"{name}_{number}"


def suggestion(
    suspects: Sequence[Endpoint], name: str, address: str, *, is_robot: bool = False, is_configured: bool = False
) -> str:
    """Return lines of hostlink.toml that make a robot of a device with these unguarded endpoints.

    `name` and `address` are the robot's. A type that hostlink cannot encode is refused by a lock at least, and so are
    the topics of a device that is a robot already. `is_configured`: the file has a table of this name.
    """
    table, keys = _suggested(suspects, is_robot=is_robot)
    key = name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _quoted(name)
    if not (is_robot or is_configured):
        keys = [f"address = {_quoted(address)}", *keys]
    lines = [f"[robots.{key}]", *keys] if keys else []
    if table:
        lines += [f"[robots.{key}.{table[0]}]", *table[1:]]
    return "\n".join(lines)


def _suggested(suspects: Sequence[Endpoint], *, is_robot: bool) -> tuple[list[str], list[str]]:
    """Return the name and the lines of the table that makes a robot of these endpoints, and lines of the robot's own.

    The number at rest of a motor that takes no number below zero is not known: such a motor would turn at once.
    """
    by_type: dict[str, list[str]] = {}
    for each in () if is_robot else suspects:
        by_type.setdefault(each.type_name, []).append(each.name)
    for type_name, names in by_type.items():
        first = _quoted(names[0])
        is_number = type_name in NUMBER_TYPES
        if type_name in _TWISTS:
            return [], [f"command_topic = {first}"]
        if type_name == VECTOR_TYPE:
            return ["vector", f"topic = {first}", 'fields = ["x", "y", "yaw"]'], []
        throttle = _throttle_topics(suspects) if is_number else []
        wheels = names[:1] if type_name in ARRAY_TYPES else _wheel_topics(suspects) if is_number else []
        numbers = {each.type_name for each in suspects if each.name in (throttle or wheels)}
        is_known = (throttle or len(wheels) in _WHEELS_NEED) and not any(each.startswith(_UNSIGNED) for each in numbers)
        if is_known:
            full = ["full = 127"] if any(each.startswith(_SHORT) for each in numbers) else []
            table = [f"topics = [{', '.join(map(_quoted, throttle or wheels))}]", 'unit = "pwm"', *full]
            if throttle:
                return ["throttle", *table], []
            return ["wheels", *table], [*_WHEELS_NEED[len(wheels)]]
        if type_name == JOY_TYPE:
            return ["joy", f"topic = {first}", "x_axis = 1", "yaw_axis = 0"], []
        if type_name in TEXT_TYPES:
            words = ('forward = "F"', 'backward = "B"', 'left = "L"', 'right = "R"', 'stop = "S"')
            return ["words", f"topic = {first}", *words], []
    return [], [f"locked_topics = [{', '.join(_quoted(each.name) for each in suspects)}]"]


def _quoted(text: str) -> str:
    """Return a string of TOML: a device may announce any name."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


# -- recognition ------------------------------------------------------------------------------------------------------


def _commands(endpoints: Sequence[Endpoint], settings: CommandSettings) -> tuple[tuple[TopicType, ...], CommandKind]:
    """Return the command topics of a device, and their kind. Empty: it takes no velocity."""
    to_device = [each for each in endpoints if each.is_to_device]
    types = {each.name: each.type_name for each in to_device}
    if settings.topics and types.keys() >= set(settings.topics):
        found = tuple(TopicType(name, types[name]) for name in settings.topics)
        kind = settings.kind
        if kind is None:
            kind = CommandKind.ACKERMANN if found[0].type_name in ACKERMANN_TYPES else CommandKind.TWIST
        return found, kind
    if settings.topics and settings.devices:  # another of the robot's devices may have them
        return (), CommandKind.TWIST
    likely = [each for each in to_device if is_velocity(each, settings.ignored)]
    poses = [each for each in endpoints if _is_pose(each)]
    if not likely and poses:  # what has a pose and takes a Twist is a robot by any name of the Twist
        twists = (each for each in to_device if each.type_name in _TWISTS)
        likely = [each for each in twists if each.name not in settings.ignored]
    if not likely:
        return (), CommandKind.TWIST
    usual = min(map(_rank, likely))
    named: dict[tuple[str, ...], bool] = {}  # namespaces with a pose, and whether its name tells of odometry
    for pose in poses:
        namespace = namespace_of(pose.name)
        named[namespace] = named.get(namespace, False) or "odom" in leaf_of(pose.name)
    first = min(
        (each for each in likely if _rank(each) == usual),
        key=lambda each: (
            namespace_of(each.name) not in named,
            not named.get(namespace_of(each.name), False),
            each.name,
        ),
    )
    kind = CommandKind.ACKERMANN if first.type_name in ACKERMANN_TYPES else CommandKind.TWIST
    return (TopicType(first.name, first.type_name),), kind


def _rank(command: Endpoint) -> tuple[int, int]:
    leaf = leaf_of(command.name)
    usual = _USUAL_NAMES.index(leaf) if leaf in _USUAL_NAMES else len(_USUAL_NAMES)
    return usual, (*_TWISTS, *ACKERMANN_TYPES).index(command.type_name)


def _odometry(endpoints: Sequence[Endpoint], velocity: str, settings: CommandSettings) -> Endpoint | None:
    """Return the pose that a person would choose: in the command's namespace, of a usual name and type.

    Without a pose, what measures a velocity.
    """
    sent = [each for each in endpoints if not each.is_to_device]
    if settings.odometry is not None:
        known = {*POSE_TYPES, *VELOCITY_TYPES}
        return next((each for each in sent if each.name == settings.odometry and each.type_name in known), None)
    here = namespace_of(velocity)
    pose = min(
        filter(_is_pose, sent),
        key=lambda each: (
            each.type_name not in _USUAL_POSES,
            namespace_of(each.name) != here,
            "odom" not in leaf_of(each.name),
            each.name,
            each.type_name,
        ),
        default=None,
    )
    if pose is None:
        found = recognised((each.name, each.type_name) for each in sent)
        pose = next((each for each in sent if (each.name, each.type_name) == found), None)
    return pose


def _is_pose(endpoint: Endpoint) -> bool:
    return not endpoint.is_to_device and endpoint.type_name in POSE_TYPES


def _is_motor(endpoint: Endpoint) -> bool:
    """Whether the type may carry how far or how fast something moves."""
    return endpoint.type_name not in _NO_MOTION


def _looks_like_motion(endpoint: Endpoint, robots: Collection[tuple[str, ...]]) -> bool:
    """Whether its type and name tell of motion. `robots`: namespaces that are names of robots."""
    if not _is_motor(endpoint) or _is_position(endpoint):
        return False
    leaf, space = leaf_of(endpoint.name), namespace_of(endpoint.name)
    words = [leaf] if space in robots else [*space, leaf]
    is_spoken = endpoint.type_name in TEXT_TYPES and any(map(_SPOKEN.search, words))
    return is_spoken or any(map(_SUSPECT.search, words))


def _is_position(endpoint: Endpoint) -> bool:
    """Whether it sets a position or starts a movement. A speed or a motor of an arm is a motion all the same."""
    if endpoint.type_name in _TRIGGERS:
        return _TRIGGER.search(leaf_of(endpoint.name)) is not None
    if endpoint.type_name == JOINT_STATE_TYPE:
        return True
    leaf = leaf_of(endpoint.name)
    if not _is_motor(endpoint) or _RATE.search(leaf):
        return False
    return bool(_POSITION.search(leaf) or (_ACTUATOR.search(endpoint.name) and not _MOTOR.search(leaf)))


def _wheel_topics(suspects: Sequence[Endpoint]) -> list[str]:
    """Return the topics of the wheels, in their order: those that are pairs of left and right, if there are any."""
    names = [each.name for each in suspects if each.type_name in NUMBER_TYPES]
    pairs: dict[str, str] = {}
    for name in names:
        for left, right in _SIDES:
            starts = [found.start() for found in re.finditer(left, name)]
            others = [name[:start] + right + name[start + len(left) :] for start in starts]
            other = next((each for each in others if each in names), None)
            if other is not None and name not in pairs and other not in pairs.values():
                pairs[name] = other
    if pairs:
        return [topic for pair in pairs.items() for topic in pair]
    return [name for name in names if _NO_WHEEL.search(leaf_of(name)) is None] or names[:1]


def _throttle_topics(suspects: Sequence[Endpoint]) -> list[str]:
    """Return the topics of throttle and steering of a car; empty if there is not one of each."""
    names = [each.name for each in suspects if each.type_name in NUMBER_TYPES]
    steering = [name for name in names if _STEERING.search(leaf_of(name))]
    throttle = [name for name in names if name not in steering and _THROTTLE.search(leaf_of(name))]
    return [throttle[0], steering[0]] if len(throttle) == len(steering) == 1 else []


def select(settings: Mapping[str, CommandSettings], endpoints: Sequence[Endpoint]) -> str | None:
    """Return the robot whose settings name command topics that the device has, all of them; None if there is none."""
    names = _taken(endpoints).keys()
    return next(
        (name for name, each in settings.items() if each.topics and names >= set(map(plain_name, each.topics))), None
    )


# -- names ------------------------------------------------------------------------------------------------------------


def _parts(topic: str) -> list[str]:
    return [part for part in topic.lstrip("~").split("/") if part]


def leaf_of(topic: str) -> str:
    """Return the last part of a topic's name."""
    return _parts(topic)[-1] if _parts(topic) else ""


def namespace_of(topic: str) -> tuple[str, ...]:
    """Return the parts of a topic's name before the last one."""
    return tuple(_parts(topic)[:-1])


def _common(velocity: tuple[str, ...], odometry: tuple[str, ...]) -> tuple[str, ...]:
    """Common part of two namespaces."""
    pairs = itertools.takewhile(lambda pair: pair[0] == pair[1], zip(velocity, odometry, strict=False))
    return tuple(here for here, _ in pairs)
