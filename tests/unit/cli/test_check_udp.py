"""Port for datagrams: the report of `--check-config`, the options and its share of the descriptors."""

import asyncio
import socket
from dataclasses import replace
from pathlib import Path

import pytest

from hostlink.cli.check import check, describe
from hostlink.cli.descriptors import FEWEST, fitted
from hostlink.cli.serve_command import merge
from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import (
    Config,
    MicroRosConfig,
    MicroRosTcpConfig,
    MicroRosUdpConfig,
    TcpConfig,
    UdpConfig,
    check_ports,
    load,
)
from hostlink.errors import ConfigError

QUIET = Config(tcp=TcpConfig(host="127.0.0.1", port=0), guardian=False).with_tables(api=ApiConfig(port=0))


def checked(udp: UdpConfig, descriptors: int = 2048) -> list[str]:
    return asyncio.run(check(replace(QUIET, udp=udp), descriptors=descriptors))


def test_udp_port_has_a_line_in_the_report() -> None:
    udp = UdpConfig(allow=("10.0.0.0/8",), trusted=("10.1.0.0/16",), devices=("192.168.4.2:11411",))
    assert describe(Config(udp=udp))[1] == (
        "devices on UDP 0.0.0.0:11411, from 10.0.0.0/8, at most 256; 10.1.0.0/16, 192.168.4.2:11411 trusted"
    )


def test_a_port_in_use_is_a_warning_and_a_wrong_one_an_error() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        assert checked(UdpConfig(host="127.0.0.1", port=port)) == [f"udp.port {port} is in use at this moment"]
    with pytest.raises(ConfigError, match=r"^udp\.port: 65536 is not a port"):
        checked(UdpConfig(port=65536))
    with pytest.raises(ConfigError, match=r"^UDP 192\.0\.2\.1:11411: cannot be listened on: "):
        checked(UdpConfig(host="192.0.2.1"))


def test_networks_that_need_no_key_where_there_is_none_are_suspicious() -> None:
    udp = UdpConfig(host="127.0.0.1", port=0, keyless=("10.0.0.7",))
    assert checked(udp) == ["udp.keyless has no effect without udp.key_file, because no device needs a key"]


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ("prot = 1", "unknown key udp.prot; did you mean port?"),
        ('allow = ["10.0.0.1/8"]', "allow: 10.0.0.1/8 has host bits set"),
        ('trusted = ["wifi"]', "trusted: 'wifi' does not appear to be"),
        ('devices = ["10.0.0.1"]', "'10.0.0.1' is not HOST:PORT"),
        ("max_connections = 1", "max_connections must be at least 2"),
    ],
)
def test_wrong_udp_setting_in_the_file_is_named(tmp_path: Path, settings: str, problem: str) -> None:
    file = tmp_path / "hostlink.toml"
    file.write_text(f"[udp]\n{settings}\n")
    with pytest.raises(ConfigError, match=problem.replace("[", r"\[")):
        load(file)


@pytest.mark.parametrize(
    ("text", "address"),
    [("11411", ("0.0.0.0", 11411)), ("127.0.0.1:5000", ("127.0.0.1", 5000)), ("[::1]:5000", ("::1", 5000))],
)
def test_the_flag_names_a_port_or_an_address(text: str, address: tuple[str, int]) -> None:
    udp = merge(Config(), udp=text).udp
    assert (udp.host, udp.port) == address


def test_udp_option_takes_precedence_and_keeps_other_settings_of_the_file() -> None:
    file = Config(udp=UdpConfig(host="10.0.0.1", trusted=("10.0.0.0/8",)))
    assert merge(file, udp="5000").udp == UdpConfig(host="10.0.0.1", port=5000, trusted=("10.0.0.0/8",))


@pytest.mark.parametrize("text", ["", "udp", "1:", "127.0.0.1:port", "70000"])
def test_udp_option_that_is_not_an_address_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"^--udp: .* is not HOST:PORT: .*; an example"):
        merge(Config(), udp=text)


@pytest.mark.parametrize(
    ("config", "problem"),
    [
        pytest.param(
            Config(udp=UdpConfig(port=8888), micro_ros=MicroRosConfig(udp=MicroRosUdpConfig())),
            "micro_ros.udp.port: UDP port 8888 is that of [udp], too; give each its own",
            id="UDP",
        ),
        pytest.param(
            Config(tcp=TcpConfig(port=8888), micro_ros=MicroRosConfig(tcp=MicroRosTcpConfig())),
            "micro_ros.tcp.port: TCP port 8888 is that of [tcp], too; give each its own",
            id="TCP",
        ),
    ],
)
def test_two_listeners_for_devices_with_one_port_are_refused(config: Config, problem: str) -> None:
    with pytest.raises(ConfigError) as refused:
        asyncio.run(check(config, descriptors=2048))
    assert str(refused.value) == problem


@pytest.mark.parametrize(
    ("host", "port"), [pytest.param("127.0.0.2", 8888, id="another address"), pytest.param("0.0.0.0", 0, id="any port")]
)
def test_listeners_for_devices_may_share_a_port_at_different_addresses(host: str, port: int) -> None:
    boards = MicroRosConfig(udp=MicroRosUdpConfig(port=port))
    check_ports(Config(udp=UdpConfig(host=host, port=port), micro_ros=boards))


@pytest.mark.parametrize("descriptors", [FEWEST, 200, 500, 1024, 2048])
def test_sessions_have_their_share_of_the_descriptors(descriptors: int) -> None:
    config = Config(udp=UdpConfig())
    fits = fitted(config, descriptors)
    devices = fits.tcp.max_connections + fits.udp.max_connections
    assert devices + fits.table("api", ApiConfig).max_connections <= descriptors
    assert fits.tcp.max_connections >= 1
    assert fits.udp.max_connections >= 2
