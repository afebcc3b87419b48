"""hostlink.toml: accepted settings, and the errors of others."""

import dataclasses
import re
import typing
from pathlib import Path

import pytest

from hostlink.cli.settings import load
from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import Config, EncodersConfig, RobotConfig, SerialConfig, Unit
from hostlink.core.robot.wheel_feedback import UNITS, WheelSettings
from hostlink.errors import ConfigError


def write(folder: Path, text: str) -> Path:
    path = folder / "hostlink.toml"
    path.write_text(text)
    return path


def test_empty_file_is_the_defaults(tmp_path: Path) -> None:
    assert load(write(tmp_path, "")) == Config()


def test_every_part_is_read(tmp_path: Path) -> None:
    text = """
        message_folders = ["msgs"]
        [tcp]
        port = 11511
        [[serial]]
        path = "/dev/ttyACM0"
        baud = 38400
        [[serial]]
        usb_serial = "7543031303535190A0A1"
        baud = [57600, 115200]
        on_open = "reset"
        [link]
        uart_bytes_s = 3840
        [api]
        port = 9191
        [robots.robot_0]
        address = "192.168.4.2"
        max_wheel_m_s = 0.3436
        wheel_separation_m = 0.21
        [parameters]
        "/robot_0/gain" = [23.0, 36.0, 0.1]
        name = "first"
    """
    config = load(write(tmp_path, text))
    assert config.tcp.port == 11511
    assert config.serial == (
        SerialConfig(path="/dev/ttyACM0", baud=38400),
        SerialConfig(usb_serial="7543031303535190A0A1", baud=(57600, 115200), on_open="reset"),
    )
    assert [port.name for port in config.serial] == ["/dev/ttyACM0", "7543031303535190A0A1"]
    assert [port.bauds for port in config.serial] == [(38400,), (57600, 115200)]
    assert config.link.uart_bytes_s == 3840
    assert config.table("api", ApiConfig).port == 9191
    assert config.robots == {
        "robot_0": RobotConfig(address="192.168.4.2", max_wheel_m_s=0.3436, wheel_separation_m=0.21)
    }
    assert config.parameters == {"/robot_0/gain": [23.0, 36.0, 0.1], "name": "first"}
    assert config.message_folders == (tmp_path / "msgs",)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[tpc]\nport = 1", "unknown key tpc; did you mean tcp?"),
        ("[robots.a]\nmax_whel_m_s = 1.0", "unknown key robots.a.max_whel_m_s; did you mean max_wheel_m_s?"),
        (
            "[[serial]]\npath = 'x'\nspeed = 3",
            "unknown key serial.0.speed; known: baud, baud_try_s, dtr, on_open, path, protocol, rts, usb_serial",
        ),
        ("[tcp]\nport = 'x'", "Expected `int`, got `str` - at `$.tcp.port`"),
        ("[[serial]]\nbaud = 3", "a serial port needs either path or usb_serial - at `$.serial[0]`"),
        ("[[serial]]\npath = 'x'\nbaud = []", "a serial port needs a baud rate - at `$.serial[0]`"),
        (
            "[[serial]]\npath = '/dev/ttyUSB0:115200'",
            "the baud rate is a setting of its own: path = '/dev/ttyUSB0', baud = 115200 - at `$.serial[0]`",
        ),
        (
            "[[serial]]\npath = '/dev/x'\non_open = 'reset'\ndtr = false",
            'on_open = "reset" needs dtr = true - at `$.serial[0]`',
        ),
        ("[[serial]]\npath = 'x'\non_open = 'jump'", "Invalid enum value 'jump' - at `$.serial[0].on_open`"),
        (
            "[tcp]\nallow = ['192.168.4.2/24']",
            "allow: 192.168.4.2/24 has host bits set; write an address, or a network such as 192.168.4.0/24"
            " - at `$.tcp`",
        ),
        ("[tcp]\nmax_connections = 0", "a bound on connections must be at least 1 - at `$.tcp`"),
        ("[link]\nmax_topics = 0", "max_topics must be at least 1, forget_robot_after_s zero or more - at `$.link`"),
        ("x = [", "is not TOML: Invalid value (at end of document)"),
    ],
)
def test_wrong_setting_is_named_with_its_place(tmp_path: Path, text: str, problem: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load(path)
    assert str(caught.value) == f"{path}: {problem}"


def test_endlessly_nested_lists_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nested too deeply"):
        load(write(tmp_path, "a=" + "[" * 50_000))


def test_endless_file_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hostlink.core.config.MAX_FILE_BYTES", 1000)
    with pytest.raises(ConfigError, match="more than 1000 bytes"):
        load(Path("/dev/zero"))


def test_missing_settings_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        load(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("value", "problem"),
    [("5", "a path is a text in quotes, not 5"), ('"~no-such-user/x"', "'~no-such-user/x': .*home directory")],
)
def test_a_path_that_cannot_be_read_is_refused_with_its_place(tmp_path: Path, value: str, problem: str) -> None:
    file = tmp_path / "hostlink.toml"
    file.write_text(f"[recording]\nfolder = {value}\n")
    with pytest.raises(ConfigError, match=rf"{problem}.* - at `\$\.recording\.folder`"):
        load(file)


# -- feedback of a robot ----------------------------------------------------------------------------------------------


def test_encoders_of_a_robot_are_read(tmp_path: Path) -> None:
    text = """
    [robots.car]
    kinematics = "differential"
    [robots.car.encoders]
    topics = ["left_ticks", "right_ticks"]
    directions = [1, -1]
    ticks_per_turn = 1440
    wheel_radius_m = 0.0325
    """
    path = tmp_path / "hostlink.toml"
    path.write_text(text)
    encoders = load(path).robots["car"].encoders
    assert encoders == EncodersConfig(
        topics=("left_ticks", "right_ticks"), directions=(1, -1), ticks_per_turn=1440, wheel_radius_m=0.0325
    )


def test_encoders_are_the_settings_of_the_wheel_feedback() -> None:
    assert WheelSettings(**dataclasses.asdict(EncodersConfig(topic="t"))) == WheelSettings(topic="t")
    assert set(typing.get_args(Unit)) == set(UNITS)


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        ("[robots.a.encoders]", "either topics"),
        ('[robots.a.encoders]\ntopics = ["l"]\ntopic = "t"', "either topics"),
        ('[robots.a.encoders]\ntopics = ["l", "l"]', "different names"),
        ('[robots.a.encoders]\ntopics = ["l", "r"]\nwheels = ["left"]', "one entry for each wheel"),
        (
            '[robots.a.encoders]\ntopic = "t"\nticks_per_turn = 0',
            "ticks_per_turn must be a finite number above zero, not 0",
        ),
        ('[robots.a.encoders]\ntopic = "t"\nwheel_radius_m = nan', "wheel_radius_m must be a finite number above zero"),
        ('[robots.a.encoders]\ntopic = "t"\ndirections = [1, 2]', "directions"),
        ('[robots.a.encoders]\ntopic = "t"\nunit = "km/h"', "unit"),
        ('[robots.a.encoders]\ntopic = "t"\nunit = "rpm"\ncounts = "differences"', "does not fit unit"),
        ('[robots.a.encoders]\ntopic = "t"\nticks = 3', "unknown key robots.a.encoders.ticks"),
        ('[robots.a.encoders]\ntopic = "t"\n[robots.a.feedback]\ntopic = "o"', "either encoders or feedback.topic"),
    ],
)
def test_encoders_that_are_wrong_are_refused_with_their_reason(tmp_path: Path, lines: str, problem: str) -> None:
    path = tmp_path / "hostlink.toml"
    path.write_text(lines)
    with pytest.raises(ConfigError, match=re.escape(problem)):
        load(path)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('words = {topic="c", forward="F", backward="B", left="L", right="R", stop=""}', "stop must not be empty"),
        ('words = {topic="c", forward="S", backward="B", left="L", right="R", stop="S"}', "must differ from the words"),
        (
            'words = {topic="c", forward="F", backward="F", left="L", right="R", stop="S"}',
            "words.forward and words.backward are one word, 'F': give each its own",
        ),
        (
            'words = {topic="c", forward="F", backward="B", left="L", right="B", stop="S"}',
            "words.backward and words.right are one word, 'B': give each its own",
        ),
        (
            f'words = {{topic="c", forward="F", backward="B", left="L", right="R", stop="{"S" * 1025}"}}',
            "words.stop has more than 1024 bytes: shorten it",
        ),
        (
            f'wheels = {{topics=["m"], unit="rad_s", joints=["l", "{"r" * 1024}"]}}',
            "the names in wheels.joints have more than 1024 bytes: shorten them",
        ),
        ('wheels = {topics=["m", "m"], unit="pwm"}', "names one topic twice"),
        ('wheels = {topics=["m", "/m"], unit="pwm"}', "wheels.topics names one topic twice: 'm'"),
        ('wheels = {topics=["j"], unit="rad_s", joints=["l", "l"]}', "wheels.joints names one joint twice: 'l'"),
        ('wheels = {topics=["l", ""]}', "wheels.topics must not have an empty name"),
        ('throttle = {topics=["t", "/t"]}', "throttle.topics must be two"),
        ('throttle = {topics=["t", "/"]}', "throttle.topics must not have an empty name"),
        ('command_topic = ""', "command_topic must not have an empty name: write the name, or remove it"),
        ('command_topic = "/"', "command_topic must not have an empty name"),
        ('stop_service = ""', "stop_service must not have an empty name"),
        ('not_commands = ["a", ""]', "not_commands must not have an empty name"),
        ('locked_topics = [""]', "locked_topics must not have an empty name"),
        ('locked_topics = ["a", "/a"]', "locked_topics names one topic twice: 'a'"),
        ('devices = ["", "10.0.0.2"]', "devices must not have an empty name: write an address, a port or a name"),
        ('joy = {topic=""}', "joy.topic must not have an empty name"),
        ('vector = {topic=""}', "vector.topic must not have an empty name"),
        (
            'words = {topic="", forward="F", backward="B", left="L", right="R", stop="S"}',
            "words.topic must not have an empty name",
        ),
        ('encoders = {topic=""}', "encoders.topic must not have an empty name"),
        ('encoders = {topics=["l", ""]}', "encoders.topics must not have an empty name"),
        ('encoders = {topics=["l", "/l"]}', "topics must be at most 8 different names"),
        ('encoders = {topics=["l", "r"], wheels=["left", "left"]}', "encoders.wheels names one wheel twice: 'left'"),
        ('encoders = {topic="j", joints=["a", "a"]}', "encoders.joints names one joint twice: 'a'"),
        ('vector = {fields=["yaw"]}', 'vector.fields must have "x" or "y": with "yaw" alone the robot only turns'),
        (
            'kinematics = "differential"\nvector = {fields=["y", "yaw"]}',
            'vector.fields must have "x": kinematics = "differential" cannot move sideways',
        ),
        ("joy = {button=11}", "joy.buttons = 11 are numbered 0 to 10: for 11 set 12"),
        ("joy = {x_axis=9, axes=2}", "joy.axes = 2 are numbered 0 to 1: for 9 set 10"),
        (
            'kinematics = "spatial"\nwheels = {topics=["l", "r"]}',
            'kinematics = "spatial" passes the six numbers of a Twist, not wheels: choose another kinematics, or',
        ),
        ('command_topic = "foo"\nnot_commands = ["/foo"]', "'/foo' is the command of the robot and one of not_comm"),
        (
            'command_topic = "foo"\nnot_commands = ["bar", "foo"]',
            "'foo' is the command of the robot and one of not_commands: remove it from one of them",
        ),
        ('wheels = {topics=["l", "r"]}\nnot_commands = ["r"]', "'r' is the command of the robot and one of not_com"),
        ('joy = {topic="j"}\nnot_commands = ["j"]', "'j' is the command of the robot and one of not_commands"),
        ('vector = {topic="j"}\nnot_commands = ["j"]', "'j' is the command of the robot and one of not_commands"),
        ('throttle = {topics=["a", "j"]}\nnot_commands = ["j"]', "'j' is the command of the robot and one of not_"),
        ("devices = []", "devices must not be empty: name the robot's boards, or remove the line"),
        ('wheels = {topics=["l"], unit="pwm", full=0}', "wheels.full must be a finite number above zero, not 0"),
        (
            'wheels = {topics=["l"], unit="pwm", full=-255}',
            "wheels.full must be a finite number above zero, not -255; a wheel that turns the other way has -1 in",
        ),
        ('wheels = {topics=["l"], unit="pwm", full=nan}', "wheels.full must be a finite number above zero, not nan"),
        ('wheels = {topics=["l"], unit="pwm", rest=inf}', "wheels.rest must be a finite number, not inf"),
        (
            'wheels = {topics=["l"], unit="pwm", full=2000, rest=1500}',
            "wheels.full is added to wheels.rest and subtracted from it: -500 to 3500; for 1000 to 2000 with "
            "rest = 1500 set full = 500",
        ),
        ('throttle = {topics=["a", "b"], unit="pwm", full=0}', "throttle.full must be a finite number, not zero"),
        ('throttle = {topics=["a", "b"], steering_full=nan}', "throttle.steering_full must be a finite number, not"),
        (
            'throttle = {topics=["a", "b"], steering_full=180, steering_rest=90}',
            "throttle.steering_full is added to throttle.steering_rest and subtracted from it: -90 to 270",
        ),
        ('joy = {topic="j", x_axis=1, yaw_axis=1}', "joy.x_axis and joy.yaw_axis are one axis, 1: give each its own"),
    ],
)
def test_settings_of_a_robot_that_contradict_each_other_are_refused(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "hostlink.toml"
    path.write_text(f"[robots.other]\n[robots.r]\n{text}\n")
    with pytest.raises(ConfigError, match=rf"{re.escape(problem)}.*`\$\.robots\.r[.`]"):
        load(path)


def test_motors_with_their_own_rest_and_a_reversed_throttle_are_accepted(tmp_path: Path) -> None:
    path = tmp_path / "hostlink.toml"
    path.write_text(
        '[robots.servo.wheels]\ntopics = ["l", "r"]\nunit = "pwm"\nfull = 90\nrest = 90\n'
        '[robots.car.throttle]\ntopics = ["t", "s"]\nunit = "pwm"\nfull = -500\nrest = 1500\nsteering_full = -0.5\n'
    )
    robots = load(path).robots
    assert (robots["servo"].wheels, robots["car"].throttle) != (None, None)


@pytest.mark.parametrize("second", ['devices = ["10.0.0.4", "10.0.0.2"]', 'address = "10.0.0.2"'])
def test_board_of_two_robots_is_refused(tmp_path: Path, second: str) -> None:
    path = tmp_path / "hostlink.toml"
    path.write_text(f'[robots.a]\ndevices = ["10.0.0.2", "10.0.0.3"]\n[robots.b]\n{second}\n')
    problem = "10.0.0.2 is a device of robots.a and of robots.b: remove it from one of them"
    with pytest.raises(ConfigError, match=re.escape(problem)):
        load(path)
    path.write_text('[robots.a]\ndevices = ["10.0.0.2:4001"]\n[robots.b]\ndevices = ["10.0.0.2:4002"]\n')
    assert len(load(path).robots) == 2
