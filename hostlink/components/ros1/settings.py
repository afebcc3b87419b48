"""Settings of the node in a graph of ROS 1: the table [ros1] of hostlink.toml."""

import re
import urllib.parse
from dataclasses import dataclass, field

from hostlink.core.config import check_networks


@dataclass(frozen=True, slots=True, kw_only=True)
class Ros1Config:
    """Node of the daemon in a ROS 1 graph."""

    master: str = ""  # "http://localhost:11311"; empty: no node
    name: str = "hostlink"  # name of the node
    namespace: str = "/"
    # Name or address under which other nodes reach this one; None: its address towards the master.
    host: str | None = None
    port: int = 0  # of the slave API; 0: any free port
    tcpros_port: int = 0
    allow: tuple[str, ...] = ()  # networks from which nodes may connect; empty: all. ROS 1 has no passwords
    max_connections: int = 256  # on each of the two ports, and to other nodes
    max_message_bytes: int = 4 * 1024 * 1024  # from other nodes; a device's messages have a hundredth of it
    remappings: dict[str, str] = field(default_factory=dict)  # of topics and services

    def __post_init__(self) -> None:
        check_networks(allow=self.allow)
        if self.master and not _is_master(self.master):
            raise ValueError(f"{self.master!r} is not the address of a ROS master, such as http://localhost:11311")
        if not re.fullmatch(r"[A-Za-z]\w*", self.name, re.ASCII):
            raise ValueError(
                f"{self.name!r} is not a valid node name; use letters, digits and _, and begin with a letter"
            )
        if not re.fullmatch(r"/?([A-Za-z]\w*(/[A-Za-z]\w*)*)?/?", self.namespace, re.ASCII):
            raise ValueError(f"{self.namespace!r} is not a namespace, such as /lab")
        if min(self.max_connections, self.max_message_bytes) < 1:
            raise ValueError("a bound must be at least 1")


def _is_master(text: str) -> bool:
    """Whether the text is the URL of a ROS master.

    Raises:
        ValueError: it is not a URL, or its port is invalid.
    """
    url = urllib.parse.urlsplit(text)
    return url.scheme == "http" and bool(url.hostname) and url.port != 0
