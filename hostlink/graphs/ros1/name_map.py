"""NameMap: by which name ROS knows what the hub knows by another, and the other way. Pure."""

from collections.abc import Iterable

from hostlink.graphs.ros1.names import Names


class NameMap:
    """The hub has full names alone. By whom a name was made decides what it is in ROS.

    | the name                                      | in ROS                                                           |
    |-----------------------------------------------|------------------------------------------------------------------|
    | `odom`, `/odom`, `~odom` of a device          | in the node's namespace, global, below the node                  |
    | `/red/odom` for a robot that was named `red`  | in the namespace, however the device spells its own name         |
    | `red/odom`, `red/lock` of hostlink itself     | in the namespace; global where it is configured with a `/`       |
    | of programs, `/tf`, `/rosout`, `/diagnostics` | global                                                           |
    """

    def __init__(self, names: Names, announced: Iterable[tuple[str, str]] = (), own: Iterable[str] = ()) -> None:
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
        """The name in ROS of what is so called in the hub."""
        return self._to_ros.get(name) or self._names.resolve(name)

    def to_hub(self, name: str) -> str:
        """The name in the hub of what is so called in ROS."""
        return self._to_hub.get(name, name)

    def _note(self, shown: str, name: str) -> None:
        if name != shown:
            self._to_ros[shown] = name
            self._to_hub.setdefault(name, shown)
