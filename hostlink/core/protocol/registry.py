"""Protocols by name: rosserial, micro-ROS, and those of installed packages (entry-point group `hostlink.protocols`)."""

from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.session import DeviceProtocol
from hostlink.core.protocol.xrce.protocol import Xrce
from hostlink.core.protocol.xrce.session import NAME as MICRO_ROS
from hostlink.core.runtime import plugins
from hostlink.errors import ConfigError

GROUP = "hostlink.protocols"


def find_protocol(name: str, transport: str = "", *, velocity_stream: int = 0) -> DeviceProtocol:
    """Return the protocol of this name on a transport, "tcp", "udp" or "serial". A capture's name has it behind a /.

    `velocity_stream`: of micro-ROS, as in Xrce.

    Raises:
        ConfigError: no installed package has it, or the one that has it cannot be imported.
    """
    if name == ROSSERIAL.name:
        return ROSSERIAL
    own, _, captured_on = name.partition("/")
    if own.lower() == MICRO_ROS.lower():
        return Xrce.on(captured_on or transport, velocity_stream=velocity_stream)
    found, where = plugins.entry_points(GROUP), f"protocol = {name!r}"
    protocol = plugins.load(found, name, where=where, what="protocol", own=(ROSSERIAL.name, MICRO_ROS.lower()))
    if not isinstance(protocol, DeviceProtocol):
        raise ConfigError(where, f"{found[name].value} is not a DeviceProtocol")
    return protocol
