"""Report of `--check-config` and `serve` on a configuration before it is served."""

import asyncio
import socket
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hostlink.cli.check import check, describe
from hostlink.cli.descriptors import FEWEST, fitted
from hostlink.cli.serve_command import merge, switched_on
from hostlink.components.gateway.settings import ApiConfig, TokenConfig
from hostlink.components.recorder.settings import RecordingConfig
from hostlink.components.ros1.settings import Ros1Config
from hostlink.components.zenoh.settings import ZenohSettings
from hostlink.core.config import Config, EncodersConfig, LinkConfig, RobotConfig, SerialConfig, TcpConfig, WheelsConfig
from hostlink.core.runtime.folders import FolderOwner, state_folder
from hostlink.errors import ConfigError

TOKEN = TokenConfig(name="phone", role="drive", token="a-token-of-a-driver")
OPEN = ApiConfig(host="0.0.0.0", port=0)


def checked(config: Config, descriptors: int = 1024) -> list[str]:
    """With ports that no daemon has."""
    if config.tcp.port == 11411:
        config = replace(config, tcp=replace(config.tcp, host="127.0.0.1", port=0))
    if config.table("api", ApiConfig).port == 9090:
        config = config.with_tables(api=replace(config.table("api", ApiConfig), port=0))
    return asyncio.run(check(config, descriptors=descriptors))


def test_everything_that_would_be_served_has_a_line(tmp_path: Path) -> None:
    config = Config(
        tcp=TcpConfig(allow=("192.168.4.0/24", "10.0.0.7")),
        serial=(SerialConfig(path="/dev/ttyACM0"), SerialConfig(usb_serial="7543", baud=(57600, 115200))),
        robots={
            "robot_0": RobotConfig(address="7543"),
            "robot_1": RobotConfig(),
            "robot_2": RobotConfig(devices=("10.0.0.8", "10.0.0.9")),
        },
        parameters={"gain": 1.0},
        message_folders=(tmp_path,),
    )
    (tmp_path / "my_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "my_msgs" / "msg" / "Odd.msg").write_text("int32 data\n")
    assert describe(config) == [
        "devices on TCP 0.0.0.0:11411, from 192.168.4.0/24, 10.0.0.7, at most 256",
        "a device on /dev/ttyACM0 at 57600 baud",
        "a device on 7543 at 57600 or 115200 baud",
        "programs on http://127.0.0.1:9090",
        f"recordings in {state_folder() / 'recordings'}, at most 4096 MB; black box of 120 s before an incident",
        "robot robot_0, 7543",
        "robot robot_1, known by its topics",
        "robot robot_2, 10.0.0.8 and 10.0.0.9",
        f"messages in {tmp_path}",
        "1 parameter",
    ]


def test_report_says_from_where_a_zenoh_session_can_be_reached() -> None:
    plain = Config(component_settings={"zenoh": ZenohSettings(connect=("tcp/10.0.0.2:7447",))})
    reach = (
        "listens on tcp/[::]:0; connects to tcp/10.0.0.2:7447; no TLS, found by multicast and gossip: everybody who "
        "reaches it can drive"
    )
    assert f"Zenoh, a peer: the fleet hostlink; {reach}" in describe(plain)
    (warning,) = checked(plain)
    assert "everybody who reaches its port can drive the robots" in warning
    files = {"ca": Path("/ca.pem"), "certificate": Path("/a.pem"), "key": Path("/a.key")}
    closed = Config(component_settings={"zenoh": ZenohSettings(drivers=("desk",), **files)})
    reach = (
        "listens on nothing; TLS alone: reached by certificates of /ca.pem; of them desk may drive, by the name in the "
        "certificate"
    )
    assert f"Zenoh, a peer: the fleet hostlink; {reach}" in describe(closed)
    assert checked(closed) == []


@pytest.mark.parametrize(
    ("config", "problem"),
    [
        (Config(tcp=TcpConfig(port=65536)), r"tcp.port: 65536 is not a port; choose 0 \(any free one\) to 65535"),
        (Config().with_tables(api=ApiConfig(port=-1)), "api.port: -1 is not a port"),
        (Config(message_folders=(Path("/none"),)), "/none: "),
        (
            Config().with_tables(api=OPEN),
            r"every program on the network could drive the robots: set \[\[api.tokens\]\]",
        ),
        (
            Config(robots={"a": RobotConfig(max_linear_m_s=-1.0)}),
            "max_linear_m_s must be a finite number, zero or more",
        ),
        (
            Config(robots={"a": RobotConfig(kinematics="omni3", wheel_angles_deg=(0.0, 90.0))}),
            r"robots.a: wheel_angles_deg must be 3 angles in degrees, not \[0.0, 90.0\]",
        ),
        (
            Config(robots={"a": RobotConfig(kinematics="omni4", wheelbase_m=0.2)}),
            'robots.a: wheelbase_m is not a setting of kinematics = "omni4", which takes wheel_distance_m',
        ),
        (
            Config(robots={"a": RobotConfig(kinematics="mecanum", wheelbase_m=-0.2)}),
            "robots.a.wheelbase_m: -0.2 is not allowed; choose a finite number above 0",
        ),
        *(
            (Config(robots={"a": RobotConfig(wheels=WheelsConfig(topics=topics), kinematics=kinematics)}), problem)  # type: ignore[arg-type]
            for topics, kinematics, problem in [
                (
                    ("fl", "fr", "rl", "rr"),
                    "mecanum",
                    'robots.a: kinematics = "mecanum" needs wheel_separation_m and wheelbase_m, without which the',
                ),
                (("1", "2", "3"), "omni3", 'robots.a: kinematics = "omni3" needs wheel_distance_m, without which the'),
                (("l", "r"), "ackermann", 'robots.a: kinematics = "ackermann" needs wheel_separation_m, without which'),
                (
                    ("l", "r"),
                    "planar",
                    'robots.a: kinematics = "planar" has no wheels: choose the drive of the robot, ',
                ),
                (("l", "r", "m"), "", "robots.a: 3 topics for 2 wheels; give one for each, in order"),
                (("l", "r"), "skid_steer", "robots.a: 2 topics for 4 wheels; give one for each, in order"),
            ]
        ),
        (
            Config(robots={"a": RobotConfig(wheels=WheelsConfig(topics=("l", "r"), unit="rpm"))}),
            'robots.a: unit = "rpm" needs wheel_radius_m',
        ),
        (
            Config(robots={"a": RobotConfig(wheels=WheelsConfig(topics=("m",), unit="rpm"))}),
            'robots.a: unit = "rpm" needs wheel_radius_m',
        ),
        (
            Config(robots={"a": RobotConfig(wheels=WheelsConfig(topics=("j",), joints=("l", "r", "m")))}),
            "robots.a: a JointState for 2 wheels needs as many names in `joints`",
        ),
        *(
            (Config(robots={"a": RobotConfig(wheel_separation_m=0.2, encoders=encoders)}), problem)
            for encoders, problem in [
                (
                    EncodersConfig(topics=("l", "r"), wheels=("front_left", "right"), unit="m"),
                    "robots.a: 'front_left' is not a wheel of this drive: left or right",
                ),
                (EncodersConfig(topics=("l",), unit="m"), "robots.a: a pose needs wheels = .*, which names 1 of left"),
                (EncodersConfig(topics=("l", "r", "m"), unit="m"), "robots.a: a pose needs wheels = .*, which names 3"),
                (
                    EncodersConfig(topic="j", joints=("l",), wheels=("left",), unit="m"),
                    "robots.a: a pose needs the encoders of right",
                ),
            ]
        ),
        (
            Config(robots={"a": RobotConfig(uart_bytes_s=0)}),
            "robots.a.uart_bytes_s: 0 is not allowed; choose a finite number above 0",
        ),
        (
            Config(link=LinkConfig(write_timeout_s=float("nan"))),
            "link.write_timeout_s: nan is not allowed; choose a finite number above 0",
        ),
        (
            Config(serial=(SerialConfig(path="/dev/x", baud=(57600, -1)),)),
            "serial /dev/x.baud: -1 is not allowed; choose a finite number above 0",
        ),
        (Config().with_tables(api=ApiConfig(max_requests_s=-1.0)), "api.max_requests_s: must be 1 or more"),
        (Config().with_tables(api=ApiConfig(host="192.0.2.7")), "set .*api.tokens"),
        (
            Config().with_tables(api=ApiConfig(host="192.0.2.7", tokens=(TOKEN,))),
            "cannot be listened on: Cannot assign requested",
        ),
        (Config().with_tables(api=ApiConfig(certificate=Path("/none.pem"), key=Path("/none.key"))), "No such file"),
        (Config().with_tables(api=ApiConfig(certificate=Path("/none.pem"))), "TLS needs both certificate and key"),
        (Config(tcp=TcpConfig(key_file=Path("/none"))), "tcp.key_file: /none: No such file"),
    ],
)
def test_configuration_that_cannot_be_served_is_refused(config: Config, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        checked(config)


@pytest.mark.parametrize(
    ("config", "warning"),
    [
        (
            Config(robots={"a": RobotConfig(address="192.168.4:80")}),
            "robots.a.address 192.168.4:80 is neither an IP address, with or without a port, nor the name of a [[seri",
        ),
        (
            Config(robots={"a": RobotConfig(address="10.0.0.1:99999")}),
            "robots.a.address 10.0.0.1:99999 is neither an IP address",
        ),
        (
            Config(robots={"a": RobotConfig(address="192.168.4")}),
            "robots.a.address 192.168.4 is neither an IP address, with or without a port, nor the name of a [[seri",
        ),
        (
            Config(robots={"a": RobotConfig(address="10.0.0.1"), "b": RobotConfig(address="10.0.0.1")}),
            "robots.b and robots.a have the same address, 10.0.0.1; the devices can "
            "be told apart only if the firmware of each has its own name",
        ),
        (
            Config().with_tables(api=replace(OPEN, tokens=(TOKEN,))),
            "api.host 0.0.0.0 without a certificate: others on the network can read the tokens",
        ),
        (
            Config(serial=(SerialConfig(path="/dev/[nz][ue][lr][lo]"),)),
            "serial /dev/[nz][ue][lr][lo]: matches 2 ports: /dev/null, /dev/zero; name one of them",
        ),
        (
            Config(tcp=TcpConfig(keyless=("10.0.0.1",))),
            "tcp.keyless has no effect without tcp.key_file, because no device needs",
        ),
        (Config(parameters={"a": 2**40}), "parameters.a cannot be sent: "),
        (Config(robots={"a": RobotConfig(max_wheel_m_s=0.3)}), "robots.a.max_wheel_m_s needs wheel_separation_m"),
        (
            Config(robots={"a": RobotConfig(max_wheel_m_s=0.3, kinematics="mecanum", wheelbase_m=0.2)}),
            "robots.a.max_wheel_m_s needs wheel_separation_m, without which",
        ),
        (
            Config(robots={"a": RobotConfig(encoders=EncodersConfig(topic="ticks"))}),
            "robots.a.encoders needs wheel_separation_m, ticks_per_turn and wheel_radius_m, without which they tell "
            "only whether the robot moves",
        ),
        (
            Config(robots={"a": RobotConfig(kinematics="ackermann", wheelbase_m=0.2)}),
            "robots.a: measure the car for wheelbase_m and max_steering_rad",
        ),
        (
            Config().with_tables(api=ApiConfig(max_clients=1000)),
            "api.max_clients 1000 is too large: api.max_connections 512 leaves 496 connections for clients",
        ),
        (Config().with_tables(api=ApiConfig(origins=("panel.example",))), "api.origins panel.example is not an origin"),
        (
            Config().with_tables(api=ApiConfig(max_message_bytes=1)),
            "api.max_message_bytes 1 is very small: a message of a program",
        ),
        (
            Config().with_tables(api=ApiConfig(max_requests_s=2.5)),
            "api.max_requests_s 2.5 is very small: a program that drives",
        ),
        (Config(link=LinkConfig(max_topics=1)), "link.max_topics 1 is very small: a robot has a velocity and an"),
        (Config(link=LinkConfig(silence_timeout_s=1.0)), "link.silence_timeout_s 1 is very small: a device requests"),
        (Config(robots={"a": RobotConfig(uart_bytes_s=1)}), "robots.a.uart_bytes_s 1 is very small: no UART is slower"),
        (Config(robots={"my robot": RobotConfig()}), "robots.my robot: ROS programs cannot use this name"),
        (Config(robots={"0": RobotConfig()}), "robots.0: ROS programs cannot use this name"),
        (Config(robots={"größe": RobotConfig()}), "robots.größe: ROS programs cannot use this name"),
        (
            Config(robots={"a": RobotConfig(cmd_vel_topic="cmd_vel"), "b": RobotConfig(cmd_vel_topic="/cmd_vel")}),
            "robots.b.cmd_vel_topic and robots.a.cmd_vel_topic are the same topic, /cmd_vel; give each its own name",
        ),
        (
            Config(robots={"a": RobotConfig(odom_topic="b/odom"), "b": RobotConfig()}),
            "robots.b.odom_topic and robots.a.odom_topic are the same topic, /b/odom",
        ),
        (
            Config(robots={"a": RobotConfig(cmd_vel_topic="drive", cmd_vel_stamped_topic="drive")}),
            "robots.a.cmd_vel_stamped_topic and robots.a.cmd_vel_topic are the same topic, /drive",
        ),
        (
            Config(robots={"a": RobotConfig(base_frame="base_link"), "b": RobotConfig(base_frame="base_link")}),
            "robots.b.base_frame and robots.a.base_frame are the same frame, base_link; give each its own name",
        ),
    ],
)
def test_suspicious_setting_is_a_warning(config: Config, warning: str) -> None:
    warnings = checked(config)
    assert len(warnings) == 1
    assert warnings[0].startswith(warning)


def test_sensible_settings_have_no_warning() -> None:
    robots = {
        "fleet/robot_0": RobotConfig(odom_topic="", cmd_vel_topic="", uart_bytes_s=120),
        "robot_1": RobotConfig(odom_topic="", cmd_vel_topic=""),
    }
    assert checked(Config(robots=robots)) == []


@pytest.mark.parametrize("address", ["10.0.0.1", "10.0.0.1:11411", "fe80::1", "[fe80::1]:11411"])
def test_address_with_or_without_a_port_has_no_warning(address: str) -> None:
    assert checked(Config(robots={"a": RobotConfig(address=address)})) == []


def test_six_numbers_with_a_limit_of_wheels_and_one_wheel_topic_are_checked() -> None:
    assert checked(Config(robots={"a": RobotConfig(kinematics="spatial", max_wheel_m_s=0.3)})) == []
    assert checked(Config(robots={"a": RobotConfig(wheels=WheelsConfig(topics=("speeds",)))})) == []


def test_the_address_of_a_port_is_none_of_a_network() -> None:
    serial = SerialConfig(usb_serial="7543")
    warnings = checked(Config(serial=(serial,), robots={"a": RobotConfig(address="7543")}))
    assert [warning for warning in warnings if "robots.a" in warning] == []


def test_a_port_that_is_in_use_is_a_warning_because_it_may_be_the_same_daemon() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert checked(Config().with_tables(api=ApiConfig(port=port))) == [f"api.port {port} is in use at this moment"]


def test_folder_of_recordings_that_another_daemon_owns_is_a_warning_that_names_the_daemon(tmp_path: Path) -> None:
    config = Config().with_tables(recording=RecordingConfig(folder=tmp_path))
    owner = FolderOwner(tmp_path, "the daemon with process id 7")
    owner.claim()
    (warning,) = checked(config)
    assert f"recording.folder {tmp_path} belongs to the daemon with process id 7" in warning
    owner.release()
    assert checked(config) == []


@pytest.mark.parametrize(
    ("node", "problem"),
    [
        ({"port": 70000}, "ros1.port: 70000 is not a port; choose 0 (any free one) to 65535"),
        ({"tcpros_port": -1}, "ros1.tcpros_port: -1 is not a port; choose 0 (any free one) to 65535"),
        ({"master": ""}, "ros1.master: is missing; write the address of the ROS master: http://localhost:11311"),
    ],
)
def test_node_of_ros_1_that_cannot_be_served_is_refused(node: dict[str, Any], problem: str) -> None:
    config = Config(components={"ros1": True}).with_tables(ros1=Ros1Config(**{"master": "http://m:1", **node}))
    with pytest.raises(ConfigError) as refused:
        checked(config)
    assert str(refused.value) == problem


@pytest.mark.parametrize(
    ("host", "is_refused"),
    [("127.0.0.1", True), ("0.0.0.0", True), ("127.0.0.2", False)],
)
def test_port_of_a_component_that_a_listener_for_devices_has_is_refused(host: str, is_refused: bool) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    config = Config(tcp=TcpConfig(host="127.0.0.1", port=port)).with_tables(
        api=ApiConfig(host=host, port=port, tokens=(TOKEN,))
    )
    if not is_refused:
        checked(config)
        return
    with pytest.raises(ConfigError) as refused:
        checked(config)
    assert str(refused.value) == f"api.port: TCP port {port} is that of [tcp], too; give each its own"


def test_option_precedes_a_switch_of_the_file() -> None:
    off = Config(components={"gateway": False, "ros1": False})
    assert merge(off, api="127.0.0.1:0").components == {"gateway": True, "ros1": False}
    assert switched_on(off, "ros1").components == {"gateway": False, "ros1": True}


def test_node_of_ros_1_is_described_by_its_full_name() -> None:
    config = Config().with_tables(ros1=Ros1Config(master="http://m:1", namespace="/lab/", name="cars"))
    assert "node /lab/cars of the ROS 1 master at http://m:1" in describe(config)
    assert not any("ROS 1" in line for line in describe(Config().with_tables(ros1=Ros1Config(name="cars"))))


def test_devices_and_programs_have_their_share_of_few_descriptors() -> None:
    assert fitted(Config(), 1024) == Config()
    small = fitted(Config(), 256)
    assert (small.tcp.max_connections, small.table("api", ApiConfig).max_connections) == (64, 128)
    few = "256 descriptors (ulimit -n) are enough only for tcp.max_connections 64, api.max_connections 128"
    assert few in checked(Config(), 256)
    for descriptors in range(FEWEST, 1024):
        fits = fitted(Config(), descriptors)
        assert fits.tcp.max_connections + fits.table("api", ApiConfig).max_connections <= descriptors - 64
        assert fits.tcp.max_connections >= 1
    with pytest.raises(ConfigError, match="127 descriptors are too few; allow at least 128"):
        fitted(Config(), 127)
