"""A component of a velocity for which the robot's command has no field is refused, and never dropped silently."""

import dataclasses

import pytest

from hostlink.core.config import Config, JoyConfig, RobotConfig, VectorConfig, WordsConfig
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import CommandRefused, RefusalKind
from tests.support.fake_device import topic
from tests.support.memory_hub import MemoryHub, in_hub

HOME = "10.0.0.2"
WORDS = WordsConfig(topic="cmd", forward="F", backward="B", left="L", right="R", stop="S")
SIDEWAYS, TURN = PlanarVelocity(y_m_s=0.1), PlanarVelocity(yaw_rad_s=0.1)
COMMANDS = {
    "joy without y": (RobotConfig(joy=JoyConfig(topic="cmd")), "sensor_msgs/Joy", SIDEWAYS, "linear.y", TURN),
    "joy without yaw": (
        RobotConfig(joy=JoyConfig(topic="cmd", y_axis=2, yaw_axis=None)),
        "sensor_msgs/Joy",
        TURN,
        "angular.z",
        SIDEWAYS,
    ),
    "vector without y": (
        RobotConfig(vector=VectorConfig(topic="cmd", fields=("x", "yaw"))),
        "geometry_msgs/Vector3",
        SIDEWAYS,
        "linear.y",
        TURN,
    ),
    "words": (RobotConfig(words=WORDS), "std_msgs/String", SIDEWAYS, "linear.y", TURN),
    "a Twist beside settings that do not fit": (RobotConfig(words=WORDS), "geometry_msgs/Twist", None, "", SIDEWAYS),
}


@pytest.mark.parametrize(("config", "type_name", "lacking", "named", "possible"), COMMANDS.values(), ids=COMMANDS)
def test_component_without_a_field_is_refused_and_named(
    config: RobotConfig, type_name: str, lacking: PlanarVelocity | None, named: str, possible: PlanarVelocity
) -> None:
    name = "cmd_vel" if type_name == "geometry_msgs/Twist" else "cmd"

    async def test(made: MemoryHub) -> None:
        await made.connect([topic(EndpointKind.SUBSCRIBER, 100, name, type_name)])
        robot, program = made.robot("car"), made.hub.join("program")
        if lacking is not None:
            with pytest.raises(CommandRefused, match=f"has no field for {named}: send 0 there") as refused:
                program.drive(robot, lacking)
            assert refused.value.kind is RefusalKind.UNSUPPORTED
        assert program.drive(robot, possible) == possible

    in_hub(test, Config(robots={"car": dataclasses.replace(config, address=HOME)}))
