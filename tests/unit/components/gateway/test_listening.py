"""Addresses that devices connect to, and the command of a simulated robot."""

from pathlib import Path
from typing import Any

import pytest

from hostlink.cli.addresses import parse_address
from hostlink.components.gateway.rest import listening_text, listening_view
from hostlink.core.config import Config, SerialConfig, TcpConfig, UdpConfig
from hostlink.core.hub.hub import Listening

KEY = Path("key")


@pytest.mark.parametrize(
    ("address", "settings", "command"),
    [
        (("0.0.0.0", 11411), {}, "hostlink sim"),
        (("127.0.0.1", 11411), {}, "hostlink sim"),
        (("0.0.0.0", 11500), {}, "hostlink sim --connect 127.0.0.1:11500"),
        (("10.0.0.7", 11411), {}, "hostlink sim --connect 10.0.0.7:11411"),
        (("::", 11411), {}, "hostlink sim --connect [::1]:11411"),
        (("0.0.0.0", 11411), {"allow": ("10.0.0.0/8",)}, None),
        (("0.0.0.0", 11411), {"allow": ("10.0.0.0/8", "127.0.0.0/8")}, "hostlink sim"),
        (("0.0.0.0", 11411), {"key_file": KEY}, None),
        (("0.0.0.0", 11411), {"key_file": KEY, "keyless": ("127.0.0.1/32",)}, "hostlink sim"),
        (("::", 11411), {"allow": ("127.0.0.0/8",)}, None),
    ],
)
def test_listening_view_names_the_simulator_that_this_daemon_accepts(
    address: tuple[str, int], settings: dict[str, Any], command: str | None
) -> None:
    view = listening_view(Listening(tcp=address), Config(tcp=TcpConfig(**settings)))
    assert view["simulate"] == command
    assert view["tcp"] == {"host": address[0], "port": address[1]}
    if command is not None and "--connect" in command:
        host, port = parse_address("--connect", command.rpartition(" ")[2], "")
        assert port == address[1]
        assert host in (address[0], "127.0.0.1", "::1")


def test_listening_view_with_tcp_closed_to_this_computer_names_udp() -> None:
    config = Config(tcp=TcpConfig(key_file=KEY), udp=UdpConfig())
    view = listening_view(Listening(("0.0.0.0", 11411), ("0.0.0.0", 11412)), config)
    assert view["simulate"] == "hostlink sim --udp --connect 127.0.0.1:11412"
    assert view["udp"] == {"host": "0.0.0.0", "port": 11412}


def test_listening_view_names_serial_ports_with_their_rates() -> None:
    ports = (SerialConfig(path="/dev/ttyACM0"), SerialConfig(usb_serial="A1", baud=(57600, 115200)))
    view = listening_view(Listening(), Config(serial=ports))
    assert view == {
        "tcp": None,
        "udp": None,
        "micro_ros": [],
        "serial": [{"port": "/dev/ttyACM0", "bauds": [57600]}, {"port": "A1", "bauds": [57600, 115200]}],
        "simulate": None,
        "address": None,
    }


def test_listening_text_names_every_real_port() -> None:
    config = Config(serial=(SerialConfig(path="/dev/ttyACM0"),))
    listening = Listening(("0.0.0.0", 11500), ("fd00::7", 11412))
    assert listening_text(listening, config) == "listening on TCP 0.0.0.0:11500, UDP [fd00::7]:11412, /dev/ttyACM0"
    assert listening_text(Listening(), Config()) == "listening on no port"
