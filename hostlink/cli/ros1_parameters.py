"""Parameters of the ROS master that set the port of `hostlink ros1`, read before the daemon is imported."""

import socket
import time
from collections.abc import Mapping
from typing import Any

from hostlink.cli.output import write_error
from hostlink.cli.serve_command import open_device_port
from hostlink.components.ros1.names import NameResolver, joined
from hostlink.components.ros1.settings import Ros1Config
from hostlink.components.ros1.xml_rpc import BadXml, CallRefused, EarlyMaster, Unreachable
from hostlink.core.config import TcpConfig
from hostlink.core.runtime.listening import close_all
from hostlink.errors import ConfigError

GLOBAL_TCP_PORT = "/rosserial_embeddedlinux/tcp_port"  # read if the node does not have its own
RETRY_S = 1.0


def read(
    config: Ros1Config, given: Mapping[str, str], tcp: TcpConfig, listening: list[socket.socket]
) -> tuple[dict[str, Any], list[socket.socket]]:
    """Set the given parameters at the master, and return those of the node's port with the sockets for devices.

    Wait for a master that does not answer, as every node of ROS does, because only the master may know the port. In
    this time devices are refused, and try again; the sockets are opened again afterwards.

    Raises:
        ConfigError: the master refuses a parameter.
    """
    names = NameResolver(joined(config.namespace, config.name))
    master = EarlyMaster(config.master, names.node)
    was_open = bool(listening)
    is_told = False
    try:
        while True:
            try:
                return _read(master, names, given), open_device_port(tcp) if was_open and not listening else listening
            except Unreachable as error:
                close_all(listening)
                listening = []
                if not is_told:
                    write_error(
                        f"hostlink: waiting for the master at {config.master}: {error}; start it with `roscore`, or "
                        "name another with --master URL; Ctrl-C ends"
                    )
                is_told = True
            time.sleep(RETRY_S)
    finally:
        master.close()


def _read(master: EarlyMaster, names: NameResolver, given: Mapping[str, str]) -> dict[str, Any]:
    for name, text in given.items():
        try:
            master.call("setParam", names.resolve(f"~{name}"), scalar(text))
        except (BadXml, CallRefused) as error:
            raise ConfigError(f"_{name}:={text}", f"the master refuses this parameter: {error}") from error
    found: dict[str, Any] = {}
    for key, name in (("tcp_port", GLOBAL_TCP_PORT), ("port", "~port"), ("baud", "~baud"), ("tcp_port", "~tcp_port")):
        try:
            found[key] = master.call("getParam", names.resolve(name))
        except CallRefused:  # the parameter is not set
            continue
    return found


def scalar(text: str) -> bool | int | float | str:
    """Read a parameter of the command line as ROS does: a number, true or false, else a string."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return {"true": True, "false": False}.get(text.lower(), text)
