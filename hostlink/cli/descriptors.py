"""Shares of the process's descriptors: devices, programs and nodes of ROS cannot use up each other's."""

import dataclasses
import resource
from collections.abc import Mapping
from typing import Any, NamedTuple

from hostlink.cli.usual import chosen
from hostlink.core.config import Config, TcpConfig, UdpConfig
from hostlink.core.host import Connections
from hostlink.errors import ConfigError

OWN = 64  # descriptors of the daemon itself: listening sockets, the event loop, the log, files that are read
FEWEST = 2 * OWN
DEVICES = Connections(least=2)  # of each port for devices


class Claim(NamedTuple):
    """Connections that a part of the settings allows, and how they share the descriptors."""

    most: int
    sharing: Connections

    @property
    def descriptors(self) -> int:
        """Descriptors of all of its connections."""
        return self.most * self.sharing.descriptors

    @property
    def least(self) -> int:
        """Descriptors without which it does not work."""
        return min(self.most, self.sharing.least) * self.sharing.descriptors


def limit() -> int:
    """Return the number of descriptors that this process may have: the system's soft limit."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return 1 << 30 if soft == resource.RLIM_INFINITY else soft


def fitted(config: Config, descriptors: int) -> Config:
    """Limit the connections of ports and components so that all of them fit into the descriptors.

    Raises:
        ConfigError: the process has too few descriptors for what must work.
    """
    numbers = fewer(config, descriptors)
    return _with_connections(config, numbers) if numbers else config


def fewer(config: Config, descriptors: int) -> dict[str, int]:
    """Return the connections of each table whose configured maximum does not fit into the descriptors.

    With too few descriptors, each part of the settings gets a share in proportion to its configured maximum.

    Raises:
        ConfigError: the process has too few descriptors for what must work.
    """
    most = connections_of(config)
    fewest = max(FEWEST, OWN + sum(claim.least for claim in most.values())) + len(config.serial)
    if descriptors < fewest:
        largest = max(most, key=lambda name: most[name].least)
        part = f"; [{largest}] alone needs {most[largest].least}" if most[largest].least > FEWEST else ""
        raise ConfigError("ulimit -n", f"{descriptors} descriptors are too few; allow at least {fewest}{part}")
    found = shares(most, descriptors - OWN - len(config.serial))
    return {name: number for name, number in found.items() if number != most[name].most}


def connections_of(config: Config) -> dict[str, Claim]:
    """Return the connections of each part of the settings, by its table."""
    claims = {name: Claim(part.max_connections, DEVICES) for name, part in ports_of(config).items()}
    for each in chosen(config):
        claims |= {name: Claim(*found) for name, found in each.connections().items()}
    return claims


def ports_of(config: Config) -> dict[str, TcpConfig | UdpConfig]:
    """Return the settings of every port for devices, by table."""
    udp, tcp = config.micro_ros.udp, config.micro_ros.tcp
    found = {
        "tcp": config.tcp,
        "udp": config.udp,
        "micro_ros.udp": None if udp is None else udp.listening(),
        "micro_ros.tcp": None if tcp is None else tcp.listening(),
    }
    return {name: part for name, part in found.items() if part is not None}


def shares(claims: Mapping[str, Claim], room: int) -> dict[str, int]:
    """Return how many connections each part may have, which together take at most `room` descriptors."""
    wanted = sum(claim.descriptors for claim in claims.values())
    least = sum(claim.least for claim in claims.values())
    found = {}
    for name, claim in claims.items():
        least -= claim.least
        part = claim.descriptors if wanted <= room else max(claim.least, room * claim.descriptors // wanted)
        found[name] = min(claim.most, min(part, room - least) // claim.sharing.descriptors)
        wanted -= claim.descriptors
        room -= found[name] * claim.sharing.descriptors
    return found


def _with_connections(config: Config, numbers: Mapping[str, int]) -> Config:
    """Return the settings with another `max_connections` in these tables."""
    tables = {
        name: dataclasses.replace(each.table(name), max_connections=numbers[name])
        for each in chosen(config)
        for name in each.kind.connections
        if name in numbers
    }
    devices: dict[str, Any] = {}
    boards: dict[str, Any] = {}
    for name in numbers.keys() - tables.keys():
        *inside, port = name.split(".")
        parts, parent = (boards, config.micro_ros) if inside else (devices, config)
        parts[port] = dataclasses.replace(getattr(parent, port), max_connections=numbers[name])
    micro_ros = dataclasses.replace(config.micro_ros, **boards)
    return dataclasses.replace(config, micro_ros=micro_ros, **devices).with_tables(**tables)
