"""NameMap: by which name ROS knows what the hub knows by another, and the other way. Pure."""

from collections.abc import Iterable

from hostlink.graphs.ros1.names import Names


class NameMap:
    """The hub has full names alone; to ROS a device's `odom` is in the node's namespace, and `~odom` below the node."""

    def __init__(self, names: Names, announced: Iterable[tuple[str, str]] = ()) -> None:
        """`announced`: what devices name a topic or service, and its name in the hub."""
        self._names = names
        self._to_ros: dict[str, str] = {}
        self._to_hub: dict[str, str] = {}
        for own, shown in announced:
            is_renamed = shown != "/" + own.lstrip("/~")  # to the name of its robot, which is a full one
            name = names.resolve(shown if is_renamed else own)
            if name != shown:
                self._to_ros[shown] = name
                self._to_hub.setdefault(name, shown)

    def to_ros(self, name: str) -> str:
        """The name in ROS of what is so called in the hub."""
        return self._to_ros.get(name) or self._names.resolve(name)

    def to_hub(self, name: str) -> str:
        """The name in the hub of what is so called in ROS."""
        return self._to_hub.get(name, name)
