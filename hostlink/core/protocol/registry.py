"""Protocols by name: rosserial, and those of installed packages (entry-point group `hostlink.protocols`)."""

from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.session import DeviceProtocol
from hostlink.core.runtime import plugins
from hostlink.errors import ConfigError

GROUP = "hostlink.protocols"


def find_protocol(name: str) -> DeviceProtocol:
    """Return the protocol of this name.

    Raises:
        ConfigError: no installed package has it, or the one that has it cannot be imported.
    """
    if name == ROSSERIAL.name:
        return ROSSERIAL
    found, where = plugins.entry_points(GROUP), f"protocol = {name!r}"
    protocol = plugins.load(found, name, where=where, what="protocol", own=(ROSSERIAL.name,))
    if not isinstance(protocol, DeviceProtocol):
        raise ConfigError(where, f"{found[name].value} is not a DeviceProtocol")
    return protocol
