"""What `--check-config` says of a configuration."""

from pathlib import Path

import pytest

from hostlink.cli.check import describe
from hostlink.config import ApiConfig, Config, RobotConfig, SerialConfig, TcpConfig
from hostlink.errors import ConfigError


def test_everything_that_would_be_served_has_a_line(tmp_path: Path) -> None:
    config = Config(
        tcp=TcpConfig(allow=("192.168.4.0/24", "10.0.0.7")),
        serial=(SerialConfig(path="/dev/ttyACM0"), SerialConfig(usb_serial="7543", baud=(57600, 115200))),
        robots={"robot_0": RobotConfig(address="7543"), "robot_1": RobotConfig()},
        parameters={"gain": 1.0},
        message_folders=(tmp_path,),
    )
    (tmp_path / "my_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "my_msgs" / "msg" / "Odd.msg").write_text("int32 data\n")
    assert describe(config).splitlines() == [
        "devices on TCP 0.0.0.0:11411, from 192.168.4.0/24, 10.0.0.7, at most 256",
        "a device on /dev/ttyACM0 at 57600 baud",
        "a device on 7543 at 57600 or 115200 baud",
        "programs on http://127.0.0.1:9090",
        "robot robot_0, 7543",
        "robot robot_1, known by its topics",
        f"messages in {tmp_path}",
        "1 parameters",
    ]


@pytest.mark.parametrize(
    ("config", "problem"),
    [
        (Config(tcp=TcpConfig(port=65536)), r"tcp.port: 65536 is no port; they go from 0 \(any free one\) to 65535"),
        (Config(api=ApiConfig(port=-1)), "api.port: -1 is no port"),
        (Config(message_folders=(Path("/none"),)), "/none: "),
    ],
)
def test_what_only_shows_when_it_is_used_is_found(config: Config, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        describe(config)
