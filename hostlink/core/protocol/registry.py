"""Protocols by name: rosserial, and those of installed packages (entry-point group `hostlink.protocols`)."""

from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.session import DeviceProtocol
from hostlink.errors import ConfigError

GROUP = "hostlink.protocols"


def find_protocol(name: str) -> DeviceProtocol:
    """Return the protocol of this name.

    Raises:
        ConfigError: no installed package has it, or the one that has it cannot be imported.
    """
    if name == ROSSERIAL.name:
        return ROSSERIAL
    from importlib.metadata import entry_points  # noqa: PLC0415 - it takes 20 ms, which few need

    found = {each.name: each for each in entry_points(group=GROUP)}
    if name not in found:
        known = ", ".join(sorted({ROSSERIAL.name, *found}))
        raise ConfigError(f"protocol = {name!r}", f"no installed package has this protocol; known: {known}")
    try:
        protocol = found[name].load()
    except Exception as error:  # a module of another package may raise anything
        raise ConfigError(f"protocol = {name!r}", f"{found[name].value} cannot be imported: {error!r}") from error
    if not isinstance(protocol, DeviceProtocol):
        raise ConfigError(f"protocol = {name!r}", f"{found[name].value} is not a DeviceProtocol")
    return protocol
