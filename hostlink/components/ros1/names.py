"""Names of ROS 1: their resolution, the arguments that change it, and names of the hub. Pure."""

import functools
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from hostlink.errors import ConfigError

ASSIGNMENT = ":="
MAX_REMEMBERED = 16384  # names, of which each is resolved again at every change of the graph
_LEGAL = re.compile(r"[~/]?[A-Za-z][\w/]*\Z|[~/]\Z")


@functools.lru_cache(MAX_REMEMBERED)
def is_legal(name: str) -> bool:
    """Whether the master accepts it as the name of a topic, a service or a node."""
    return _LEGAL.match(name) is not None and "//" not in name


@functools.lru_cache(MAX_REMEMBERED)
def joined(namespace: str, name: str) -> str:
    """Return the full name of a relative name, without doubled or trailing slashes."""
    return "/" + "/".join(part for part in f"{namespace}/{name}".split("/") if part)


@dataclass(frozen=True, slots=True)
class NameResolver:
    """Name resolution of one node: `~` is private, a name without a slash is in the namespace."""

    node: str = "/hostlink"
    remappings: Mapping[str, str] = field(default_factory=dict)  # by full names

    @classmethod
    def of(cls, namespace: str, name: str, remappings: Mapping[str, str]) -> "NameResolver":
        """Make that of a node by its namespace and name, with remappings as they were written."""
        plain = cls(joined(namespace, name))
        return cls(plain.node, {plain.resolve(old): plain.resolve(new) for old, new in remappings.items()})

    @property
    def namespace(self) -> str:
        return self.node.rpartition("/")[0] or "/"

    def resolve(self, name: str) -> str:
        """Return the full name, after the remappings."""
        full = self._full(name)
        return self.remappings.get(full, full)

    def _full(self, name: str) -> str:
        if name.startswith("~"):
            return joined(self.node, name[1:])
        return joined("/" if name.startswith("/") else self.namespace, name)


@dataclass(frozen=True, slots=True)
class NodeArguments:
    """Arguments that roslaunch and rosrun give every node: `__name:=`, `_parameter:=`, `from:=to`; and the others."""

    specials: Mapping[str, str]  # name, ns, master, ip, hostname, log
    parameters: Mapping[str, str]  # of the node's own
    remappings: Mapping[str, str]  # as they were written
    others: tuple[str, ...]

    def names(self, default_node: str, default_namespace: str = "/") -> NameResolver:
        """Return the name resolution of the node, with remappings by full names.

        Raises:
            ConfigError: a name is invalid.
        """
        name = self.specials.get("name", default_node)
        if not is_legal(name) or "/" in name.strip("/") or name.startswith("~"):
            raise ConfigError(
                "__name",
                f"{name!r} is not a node name; use letters, digits and _, without a slash, and __ns:= for a namespace",
            )
        namespace = self.specials.get("ns", default_namespace)
        if namespace.strip("/") and not is_legal(namespace):
            raise ConfigError("__ns", f"{namespace!r} is not a namespace")
        return NameResolver.of(namespace, name, self.remappings)


def parse_arguments(words: Iterable[str]) -> NodeArguments:
    """Sort the words of a node's command line.

    Raises:
        ConfigError: an assignment lacks a name or a value.
    """
    specials: dict[str, str] = {}
    parameters: dict[str, str] = {}
    remappings: dict[str, str] = {}
    others: list[str] = []
    for word in words:
        name, assignment, value = word.partition(ASSIGNMENT)
        if not assignment:
            others.append(word)
        elif not name or not value:
            raise ConfigError(word, "an assignment needs a name and a value, as _port:=/dev/ttyACM0")
        elif name.startswith("__"):
            specials[name[2:]] = value
        elif name.startswith("_"):
            parameters[name[1:]] = value
        elif is_legal(name) and is_legal(value):
            remappings[name] = value
        else:
            raise ConfigError(word, "a remapping needs two names, as cmd_vel:=/robot_0/cmd_vel")
    return NodeArguments(specials, parameters, remappings, tuple(others))


class NameMap:
    """Names of the hub, which are full names, and their names in ROS. The author of a name decides:

    | the name                                      | in ROS                                                           |
    |-----------------------------------------------|------------------------------------------------------------------|
    | `odom`, `/odom`, `~odom` of a device          | in the node's namespace, global, below the node                  |
    | `/red/odom` for a robot that was named `red`  | in the namespace, however the device spells its own name         |
    | `red/odom`, `red/lock` of hostlink itself     | in the namespace; global where it is configured with a `/`       |
    | of programs, `/tf`, `/rosout`, `/diagnostics` | global                                                           |
    """

    def __init__(self, names: NameResolver, announced: Iterable[tuple[str, str]] = (), own: Iterable[str] = ()) -> None:
        """`announced`: what devices name a topic or service, and its name in the hub; `own`: what hostlink names."""
        self._names = names
        self._to_ros: dict[str, str] = {}
        self._to_hub: dict[str, str] = {}
        announced = list(announced)
        of_devices = {shown for _, shown in announced}
        for name in own:
            shown = "/" + name.lstrip("/")
            if shown not in of_devices:
                self._note(shown, names.resolve(name))
        for name, shown in announced:
            is_renamed = shown != "/" + name.lstrip("/~")
            self._note(shown, names.resolve(shown.lstrip("/") if is_renamed else name))

    def to_ros(self, name: str) -> str:
        """Convert a name of the hub to the name in ROS."""
        return self._to_ros.get(name) or self._names.resolve(name)

    def to_hub(self, name: str) -> str:
        """Convert a name in ROS to the name in the hub."""
        return self._to_hub.get(name, name)

    def _note(self, shown: str, name: str) -> None:
        if name != shown:
            self._to_ros[shown] = name
            self._to_hub.setdefault(name, shown)
