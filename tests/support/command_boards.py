"""Boards of each type of command: their topics, the settings that they need, and what they receive."""

from dataclasses import dataclass

from hostlink.core.config import JoyConfig, RobotConfig, ThrottleConfig, VectorConfig, WheelsConfig, WordsConfig
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from tests.support.fake_device import message_type, topic
from tests.support.participants import ROBOT

ADDRESS = "10.0.0.1"
THROTTLE = ThrottleConfig(topics=("/throttle", "/steering"))
WHEELS = WheelsConfig(topics=("/left", "/right"), unit="m_s")


@dataclass(frozen=True)
class Board:
    """A board without odometry: the topics that command it, and the settings that make a robot of it, if any."""

    types: tuple[str, ...]
    names: tuple[str, ...] = (f"/{ROBOT}/cmd",)
    config: RobotConfig | None = None
    steering: int | None = None  # number of the topic that commands no motion

    @property
    def motors(self) -> list[int]:
        """Numbers of the topics that command a motion."""
        return [number for number in range(len(self.types)) if number != self.steering]

    @property
    def infos(self) -> list[DeviceEndpoint]:
        pairs = zip(self.names, self.types, strict=True)
        return [topic(EndpointKind.SUBSCRIBER, 100 + number, name, type_) for number, (name, type_) in enumerate(pairs)]

    def is_at_rest(self, number: int, payload: bytes) -> bool:
        """Whether a message on one of the topics commands no motion."""
        type_name = self.types[number]
        decoded = message_type(type_name).decode(payload)
        if type_name.endswith("Joy"):
            return not any(decoded["axes"]) and not any(decoded["buttons"])
        if type_name.endswith("JointState"):
            return not any(decoded["velocity"]) and len(decoded["velocity"]) > 0
        if type_name.endswith("MultiArray"):
            return not any(decoded["data"]) and len(decoded["data"]) > 0
        if type_name.startswith("std_msgs/"):
            return decoded["data"] in ("S", 0)
        return self.largest(number, payload) == 0.0

    def largest(self, number: int, payload: bytes) -> float:
        """The largest number of a message that has one; 0 for a word."""
        decoded = message_type(self.types[number]).decode(payload)
        numbers: list[float] = []

        def collect(value: object) -> None:
            if isinstance(value, dict):
                for name, each in value.items():
                    if name not in ("header", "layout"):
                        collect(each)
            elif isinstance(value, (int, float)):
                numbers.append(abs(value))
            elif hasattr(value, "__iter__") and not isinstance(value, (str, bytes)):
                for each in value:
                    collect(each)

        collect(decoded)
        return max(numbers, default=0.0)


def _wheels(**fields: object) -> RobotConfig:
    return RobotConfig(address=ADDRESS, wheels=WheelsConfig(unit="m_s", **fields))  # type: ignore[arg-type]


def _words(topic_name: str) -> WordsConfig:
    return WordsConfig(topic=topic_name, forward="F", backward="B", left="L", right="R", stop="S")


CMD = f"/{ROBOT}/cmd"
BOARDS = {
    "Twist": Board(("geometry_msgs/Twist",)),
    "TwistStamped": Board(("geometry_msgs/TwistStamped",)),
    "AckermannDrive": Board(("ackermann_msgs/AckermannDrive",)),
    "AckermannDriveStamped": Board(("ackermann_msgs/AckermannDriveStamped",)),
    "wheels by topics": Board(("std_msgs/Float32",) * 2, WHEELS.topics, _wheels(topics=WHEELS.topics)),
    "wheels by an array": Board(("std_msgs/Float32MultiArray",), config=_wheels(topics=(CMD,))),
    "wheels by a JointState": Board(("sensor_msgs/JointState",), config=_wheels(topics=(CMD,), joints=("l", "r"))),
    "Joy": Board(("sensor_msgs/Joy",), config=RobotConfig(address=ADDRESS, joy=JoyConfig(topic=CMD))),
    "throttle and steering": Board(
        ("std_msgs/Float32",) * 2, THROTTLE.topics, RobotConfig(address=ADDRESS, throttle=THROTTLE), steering=1
    ),
    "Vector3": Board(("geometry_msgs/Vector3",), config=RobotConfig(address=ADDRESS, vector=VectorConfig(topic=CMD))),
    "words": Board(("std_msgs/String",), config=RobotConfig(address=ADDRESS, words=_words(CMD))),
}
