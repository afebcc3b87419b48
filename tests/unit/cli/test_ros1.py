"""Device port that `hostlink ros1` serves: options, arguments, parameters, rosserial_python's defaults."""

from typing import Any

import pytest

from hostlink.cli.ros1 import MASTER, NODE, _catkin_version, _PortOptions, node_of, with_devices
from hostlink.cli.ros1_parameters import scalar
from hostlink.components.ros1.names import parse_arguments
from hostlink.components.ros1.settings import Ros1Config
from hostlink.core.config import Config
from hostlink.errors import ConfigError


def devices(*others: str, parameters: dict[str, Any] | None = None, **options: Any) -> tuple[object, ...]:
    """(the serial port, its rate, the TCP port or None where devices cannot connect)."""
    made = _PortOptions(**{"tcp": None, "serial": None, "baud": None, **options})
    found = with_devices(Config(), parameters or {}, others, made)
    serial = [(port.path, port.bauds) for port in found.serial]
    return (*serial, found.tcp.port if found.tcp.host == "0.0.0.0" else None)


@pytest.mark.parametrize(
    ("others", "parameters", "options", "expected"),
    [
        ((), {}, {}, (("/dev/ttyUSB0", (57600,)), None)),
        ((), {"port": "/dev/ttyACM0", "baud": 115200}, {}, (("/dev/ttyACM0", (115200,)), None)),
        ((), {"port": "/dev/ttyACM0", "baud": "115200"}, {}, (("/dev/ttyACM0", (115200,)), None)),
        (("/dev/ttyACM1",), {"port": "/dev/ttyACM0"}, {}, (("/dev/ttyACM1", (57600,)), None)),
        ((), {}, {"serial": "/dev/ttyACM2", "baud": 9600}, (("/dev/ttyACM2", (9600,)), None)),
        ((), {"port": "tcp"}, {}, (11411,)),
        ((), {"port": "tcp", "tcp_port": 11412}, {}, (11412,)),
        (("tcp",), {"port": "/dev/ttyACM0"}, {}, (11411,)),
        (("tcp", "11413"), {"tcp_port": 11412}, {}, (11413,)),
        ((), {"port": "/dev/ttyACM0"}, {"tcp": 11414}, (11414,)),
        ((), {}, {"tcp": 11414, "serial": "/dev/ttyACM0"}, (("/dev/ttyACM0", (57600,)), 11414)),
    ],
)
def test_the_port(
    others: tuple[str, ...], parameters: dict[str, Any], options: dict[str, Any], expected: object
) -> None:
    assert devices(*others, parameters=parameters, **options) == expected


@pytest.mark.parametrize("others", [("/dev/a", "1"), ("tcp", "1", "2"), ("tcp", "x"), ("tcp", "70000"), ("tcp", "-1")])
def test_arguments_that_mean_no_port(others: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError):
        devices(*others)


def test_wrong_baud_rate_is_refused() -> None:
    with pytest.raises(ConfigError, match="baud"):
        devices("/dev/ttyACM0", parameters={"baud": "fast"})


@pytest.mark.parametrize(
    ("text", "value"), [("1", 1), ("1.5", 1.5), ("true", True), ("False", False), ("/dev/ttyACM0", "/dev/ttyACM0")]
)
def test_a_parameter_of_the_command_line(text: str, value: object) -> None:
    assert scalar(text) == value
    assert type(scalar(text)) is type(value)


@pytest.mark.parametrize(
    ("text", "expected"), [("0.1.0", "0.1.0"), ("1.2", "1.2.0"), ("0.2.0.dev1", "0.2.0"), ("1.0rc1+local", "1.0.0")]
)
def test_version_of_the_package_is_three_numbers(text: str, expected: str) -> None:
    assert _catkin_version(text) == expected


FILE = Ros1Config(master="http://file:1", name="bridge", namespace="/lab", host="10.0.0.7")
OPTIONS = {"master": "http://option:2", "host": "10.0.0.8", "namespace": "/hall"}
WORDS = ["__master:=http://word:3", "__name:=node", "__ns:=/yard", "__hostname:=10.0.0.9"]


@pytest.mark.parametrize(
    ("config", "options", "words", "expected"),
    [
        (Ros1Config(), {}, [], (MASTER, NODE, "/", None)),
        (FILE, {}, [], ("http://file:1", "bridge", "/lab", "10.0.0.7")),
        (FILE, OPTIONS, [], ("http://option:2", "bridge", "/hall", "10.0.0.8")),
        (FILE, OPTIONS, WORDS, ("http://word:3", "node", "/yard", "10.0.0.9")),
    ],
)
def test_the_node_is_of_its_arguments_else_the_options_else_the_configuration(
    config: Ros1Config, options: dict[str, str], words: list[str], expected: tuple[object, ...]
) -> None:
    found = node_of(config, parse_arguments(words), **options)
    assert (found.master, found.name, found.namespace, found.host) == expected
