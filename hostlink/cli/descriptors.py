"""How the descriptors that a process may have are shared between devices and programs. Pure."""

import dataclasses
import resource

from hostlink.api.connections import KEPT_FOR_REQUESTS
from hostlink.config import Config
from hostlink.errors import ConfigError

OWN = 64  # of the daemon itself: listening sockets, the loop, the log, files that are read
NODE_SHARES = 3  # of nodes of ROS: those that connect to each of two ports, and those to which hostlink connects
FEWEST = OWN + 4 * KEPT_FOR_REQUESTS
FEWEST_DEVICES = 2  # of each port


def limit() -> int:
    """How many this process may have, by the system's soft limit."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return 1 << 30 if soft == resource.RLIM_INFINITY else soft


def fitted(config: Config, descriptors: int) -> Config:
    """The bounds on connections such that devices, programs and nodes of ROS cannot use up each other's descriptors.

    Where there are too few, each has its share of them by what it wanted.

    Raises:
        ConfigError: there are fewer than FEWEST.
    """
    if descriptors < FEWEST + len(config.serial):
        raise ConfigError("ulimit -n", f"{descriptors} descriptors are too few: at least {FEWEST + len(config.serial)}")
    room = descriptors - OWN - len(config.serial)
    datagrams = 0 if config.udp is None else config.udp.max_connections
    devices, programs = config.tcp.max_connections + datagrams, config.api.max_connections
    nodes = config.ros1.max_connections * NODE_SHARES if config.ros1.master else 0
    if devices + programs + nodes <= room:
        return config
    if nodes:
        nodes = min(room * nodes // (devices + programs + nodes), room - (FEWEST - OWN))
        ros1 = dataclasses.replace(config.ros1, max_connections=max(1, nodes // NODE_SHARES))
        config, room = dataclasses.replace(config, ros1=ros1), room - nodes
    kept = FEWEST_DEVICES * (2 if datagrams else 1)
    programs = min(max(KEPT_FOR_REQUESTS + 1, room * programs // (devices + programs)), programs, room - kept)
    room -= programs
    datagrams = min(max(FEWEST_DEVICES, room * datagrams // devices), datagrams, room - FEWEST_DEVICES)
    return dataclasses.replace(
        config,
        tcp=dataclasses.replace(config.tcp, max_connections=min(config.tcp.max_connections, room - datagrams)),
        udp=None if config.udp is None else dataclasses.replace(config.udp, max_connections=datagrams),
        api=dataclasses.replace(config.api, max_connections=programs),
    )
