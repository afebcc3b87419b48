"""The configuration check refuses exactly what `serve` would refuse, for drawn right and wrong settings."""

import asyncio
import contextlib
import dataclasses
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hostlink.cli.check import check
from hostlink.cli.descriptors import FEWEST, fitted
from hostlink.cli.serve import running
from hostlink.components.gateway.settings import KEPT_FOR_REQUESTS, ApiConfig, TokenConfig
from hostlink.components.ros1.node import DESCRIPTORS
from hostlink.components.ros1.settings import Ros1Config
from hostlink.core.config import Config, LinkConfig, RobotConfig, SerialConfig, TcpConfig, UdpConfig
from hostlink.errors import ConfigError

NUMBERS = st.sampled_from([1.0, 0.5, 3.0, 0.0, -1.0, math.inf, -math.inf, math.nan, 1e-300])
WHOLE = st.sampled_from([1, 17, 512, 0, -1, 2**40])
HOSTS = st.sampled_from(["127.0.0.1", "localhost", "0.0.0.0", "256.1.1.1", "192.0.2.1", "a b", "x" * 70, "é..é", "::"])
PATHS = st.sampled_from([Path("/none"), Path("/"), Path("/etc/passwd")])
PORTS = st.sampled_from([0, 0, 0, 0, -1, 65536, 10**30])
TOKENS = st.sampled_from(
    [
        TokenConfig(name="a", role="drive", token="a-token-of-a-driver"),
        TokenConfig(name="b", token="a-token-of-a-driver"),
        TokenConfig(name="c", token="short"),
        TokenConfig(name="d"),
        TokenConfig(name="e", token_file=Path("/none")),
    ]
)


def table(kind: type[Any], **fields: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """One of its dataclass with a few of these settings; a draw that the dataclass refuses is not made."""

    def make(chosen: dict[str, Any]) -> Any:
        with contextlib.suppress(ValueError):
            return kind(**chosen)
        return kind()

    few = st.lists(st.sampled_from(sorted(fields)), max_size=2, unique=True)
    return few.flatmap(lambda names: st.fixed_dictionaries({name: fields[name] for name in names})).map(make)


configs = st.builds(
    lambda api, **parts: Config(**parts).with_tables(api=api),
    tcp=table(
        TcpConfig, host=HOSTS, port=PORTS, max_connections=WHOLE, max_connections_per_address=WHOLE, key_file=PATHS
    ),
    udp=st.none()
    | table(
        UdpConfig, host=HOSTS, port=PORTS, max_connections=WHOLE, max_connections_per_address=WHOLE, key_file=PATHS
    ),
    api=table(
        ApiConfig,
        host=HOSTS,
        port=PORTS,
        tokens=st.lists(TOKENS, max_size=2).map(tuple),
        origins=st.sampled_from([(), ("*",), ("https://a",), ("",)]),
        certificate=PATHS,
        key=PATHS,
        max_clients=WHOLE,
        max_connections=WHOLE,
        max_connections_per_address=WHOLE,
        max_message_bytes=WHOLE,
        max_requests_s=NUMBERS,
        request_timeout_s=NUMBERS,
    ),
    link=table(
        LinkConfig, silence_timeout_s=NUMBERS, idle_timeout_s=NUMBERS, write_timeout_s=NUMBERS, uart_bytes_s=WHOLE
    ),
    serial=st.lists(st.builds(SerialConfig, path=st.just("/dev/none"), baud=WHOLE, baud_try_s=NUMBERS), max_size=1).map(
        tuple
    ),
    robots=st.dictionaries(
        st.sampled_from(["robot_0", "", "a/b"]),
        table(
            RobotConfig,
            **{
                each.name: NUMBERS
                for each in dataclasses.fields(RobotConfig)
                if each.name.startswith(("max_", "wheel_", "cmd_vel_max"))
            },
        ),
        max_size=1,
    ),
    message_folders=st.sampled_from([(), (), (Path("/none"),)]),
)


def with_free_ports(config: Config) -> Config:
    """Replace ports that were not drawn by free ones, because another daemon may have them."""
    tcp = config.tcp if config.tcp.port != TcpConfig().port else dataclasses.replace(config.tcp, port=0)
    api = config.table("api", ApiConfig)
    api = api if api.port != ApiConfig().port else dataclasses.replace(api, port=0)
    return dataclasses.replace(config, tcp=tcp).with_tables(api=api)


async def begin(config: Config) -> None:
    async with running(config):
        await asyncio.sleep(0)


@pytest.mark.slow
@given(configs.map(with_free_ports))
@settings(max_examples=150, deadline=None)
def test_check_accepts_exactly_the_configurations_that_serve_accepts(config: Config) -> None:
    try:
        asyncio.run(check(config, descriptors=1024))
    except ConfigError:
        return  # and `serve`, which asks the check first, with it
    asyncio.run(begin(config))


WANTED = st.integers(2, 40) | st.integers(2, 2**40)


@given(WANTED, st.none() | WANTED, st.integers(17, 2**40), st.none() | WANTED, st.integers(FEWEST, 8192))
@example(256, None, 2**40, None, 1024)
@example(2, 2**40, 17, 2**40, FEWEST)
def test_every_part_has_a_share_of_the_descriptors(
    devices: int, sessions: int | None, programs: int, nodes: int | None, descriptors: int
) -> None:
    config = Config(
        tcp=TcpConfig(max_connections=devices), udp=None if sessions is None else UdpConfig(max_connections=sessions)
    ).with_tables(
        api=ApiConfig(max_connections=programs),
        ros1=Ros1Config() if nodes is None else Ros1Config(master="http://localhost:1", max_connections=nodes),
    )
    fits = fitted(config, descriptors)
    given_sessions = 0 if fits.udp is None else fits.udp.max_connections
    given_nodes = 0 if nodes is None else fits.table("ros1", Ros1Config).max_connections
    shares = (fits.tcp.max_connections, given_sessions, fits.table("api", ApiConfig).max_connections, given_nodes)
    assert all(
        share <= (wanted or 0) for share, wanted in zip(shares, (devices, sessions, programs, nodes), strict=True)
    )
    assert fits.table("api", ApiConfig).max_connections >= min(programs, KEPT_FOR_REQUESTS + 1)
    assert shares[0] + shares[1] + shares[2] + DESCRIPTORS * shares[3] <= descriptors
