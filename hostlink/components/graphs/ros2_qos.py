"""Quality of service of ROS 2, for both bridges to it. Pure."""

from typing import Final, NamedTuple


class Qos(NamedTuple):
    """Policies of a publisher or a subscription. `depth`: messages that are kept; None: all."""

    is_reliable: bool = True
    is_latched: bool = False  # TRANSIENT_LOCAL
    depth: int | None = 10  # as `ros2 topic pub` and rclpy's examples have it


COMMANDS: Final = Qos(is_reliable=False, depth=1)  # every publisher matches it, and a newer velocity replaces an older
