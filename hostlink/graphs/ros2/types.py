"""Types: the classes of rclpy that routes need, each checked against the daemon's definition before it is used."""

from typing import Any

from hostlink.client import Host
from hostlink.errors import HostlinkError
from hostlink.graphs.ros2.conversion import Conversion
from hostlink.graphs.ros2.layout import Fields, added_bytes, nested_types, ros1_layout, ros2_fields, ros2_layout
from hostlink.graphs.ros2.names import ros2_type
from hostlink.graphs.ros2.node import load_type


class Types:
    """What is known of them stays known while the bridge runs."""

    def __init__(self) -> None:
        self.conversion = Conversion()
        self._classes: dict[tuple[str, str], Any] = {}  # by the daemon's type and ROS 2's

    async def message(self, host: Host, type_name: str, ros2: str = "") -> Any:
        """The class for a message type of the daemon, which `conversion` knows from now on.

        Raises:
            HostlinkError: it is not installed, or another message has this name in ROS 2.
        """
        ros2 = ros2 or ros2_type(type_name)
        key = (type_name, ros2)
        if key not in self._classes:
            cls = load_type(ros2)
            types = definitions(ros2)
            answer = await host.call("/rosapi/message_details", {"type": type_name})
            added = added_bytes(ros1_layout(answer["typedefs"], type_name), ros2_layout(types, ros2))
            if added is None:
                raise HostlinkError(f"{ros2} has other fields in ROS 2 than {type_name} here: it is not converted")
            self.conversion.add(types, ros2, added_bytes=added)
            self._classes[key] = cls
        return self._classes[key]


def definitions(type_name: str) -> dict[str, Fields]:
    """The fields of a message type and of all types in it, as the installed classes have them.

    Raises:
        HostlinkError: one is not installed, or ROS 1 has nothing like one of its fields.
    """
    found: dict[str, Fields] = {}
    wanted = [type_name]
    while wanted:
        name = wanted.pop()
        if name not in found:
            found[name] = ros2_fields(load_type(name).get_fields_and_field_types())
            wanted += nested_types(found[name])
    return found
