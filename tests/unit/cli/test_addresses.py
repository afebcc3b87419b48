"""HOST:PORT on the command line."""

import pytest

from hostlink.cli.addresses import parse_address, parse_serial
from hostlink.core.config import SerialConfig
from hostlink.errors import ConfigError


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("robot.local:11411", ("robot.local", 11411)),
        (":80", ("127.0.0.1", 80)),
        ("11411", ("127.0.0.1", 11411)),
        ("[fe80::1%eth0]:80", ("fe80::1%eth0", 80)),
    ],
)
def test_address_is_a_host_and_a_port(text: str, address: tuple[str, int]) -> None:
    assert parse_address("--connect", text, "127.0.0.1") == address


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ("robot..local:11411", "the host has an empty part, or one of more than 63 characters"),
        (f"{'x' * 64}:11411", "the host has an empty part, or one of more than 63 characters"),
        ("robot.local", "the port is missing"),
        ("", "the port is missing"),
        ("robot.local:", "the port is missing"),
        ("robot.local:rosserial", "the port 'rosserial' is not a number"),
        ("robot.local:99999", "the highest port is 65535"),
        ("[::1:8888", "a bracket is missing"),
    ],
)
def test_text_that_is_not_an_address_is_refused_with_the_cause_and_an_example(text: str, cause: str) -> None:
    with pytest.raises(ConfigError) as refused:
        parse_address("--connect", text, "127.0.0.1")
    assert str(refused.value) == f"--connect: {text!r} is not HOST:PORT: {cause}; an example: 192.168.4.1:11411"


def test_baud_rate_behind_a_colon_is_refused_with_the_right_form() -> None:
    with pytest.raises(ConfigError, match=r"'/dev/ttyUSB0:115200': .* follows an @: --serial /dev/ttyUSB0@115200"):
        parse_serial("/dev/ttyUSB0:115200")


def test_path_with_colons_is_a_port() -> None:
    path = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0"
    assert parse_serial(f"{path}@9600") == SerialConfig(path=path, baud=(9600,))


@pytest.mark.parametrize("text", ["COM3", "com3", "/dev/ttyUSB0"])
def test_a_serial_port_is_refused_as_an_address_with_its_option(text: str) -> None:
    with pytest.raises(ConfigError, match="is not HOST:PORT; a serial port is --serial /dev/ttyUSB0"):
        parse_address("--listen", text, "127.0.0.1")
