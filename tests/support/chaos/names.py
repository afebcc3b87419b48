"""Names, types and addresses that hostile devices and programs draw from, and payloads that fit."""

import random
import struct

from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind

HONEST = "honest"
HONEST_ADDRESS = "127.0.0.50"
HONEST_PROGRAM_ADDRESS = "127.0.0.51"
WATCH_ADDRESS = "127.0.0.52"
HONEST_VELOCITY = f"/{HONEST}/velocity_commands"
HONEST_ODOMETRY = f"/{HONEST}/odometry"
HONEST_RESET = f"/{HONEST}/reset_odometry"
HONEST_LOCK, HONEST_UNLOCK = f"/{HONEST}/lock", f"/{HONEST}/unlock"
ADDRESSES = 8  # from which hostile connections come; each has a bound of its own at the host
VERIFIED_ADDRESSES = [f"127.0.9.{number}" for number in range(1, ADDRESSES // 2 + 1)]  # half of them, over UDP
HOSTILE_RAD_S = -0.75  # how fast the commands of hostile clients turn
ROGUES = 4  # names of robots that hostile devices share
ROGUE_TOPICS = [f"/rogue_{number}/data" for number in range(ROGUES)]
CLASHING_NAMES = (
    HONEST_VELOCITY, HONEST_ODOMETRY, HONEST_RESET, "/honest/odom", "/honest/cmd_vel", "/honest/cmd_vel_stamped",
    "honest/velocity_commands", "/tf", "/rosout", "cmd_vel", "odom", "/rogue_0/velocity_commands", "/rogue_0/odometry",
    "/rogue_0/cmd_vel", "/rogue_1/odom", "/rogue_1/velocity_commands", "~cmd_vel", "//", "/honest", HONEST_LOCK,
    *ROGUE_TOPICS,
)  # fmt: skip
UNKNOWN_MESSAGE, UNKNOWN_SERVICE = "nobody_msgs/Thing", "nobody_srvs/Ask"
MESSAGE_TYPES = (
    "geometry_msgs/Twist", "geometry_msgs/Twist", "geometry_msgs/Pose2D", "geometry_msgs/Pose2D", "nav_msgs/Odometry",
    "geometry_msgs/TwistStamped", "tf/tfMessage", "std_msgs/String", "std_msgs/Empty", "std_msgs/UInt8MultiArray",
    "rosgraph_msgs/Log", "geometry_msgs/Vector3", "sensor_msgs/Imu", UNKNOWN_MESSAGE,
)  # fmt: skip
SERVICE_TYPES = ("std_srvs/Trigger", "std_srvs/SetBool", "std_srvs/Empty", UNKNOWN_SERVICE)
SERVICES = ("/rogue_0/ask", "/rogue_1/ask", HONEST_LOCK, "/rosapi/topics", "ask")
WRONG_MD5 = "0" * 32
CATALOG = Catalog()


def hostile_address(dice: random.Random) -> str:
    """One of a few."""
    return f"127.0.9.{dice.randrange(ADDRESSES) + 1}"


def md5_of(kind: EndpointKind, type_name: str) -> str:
    """Return the md5 sum of a type as a device has it; any sum for an unknown type."""
    if kind in (EndpointKind.PUBLISHER, EndpointKind.SUBSCRIBER):
        message = CATALOG.message(type_name)
        return WRONG_MD5 if message is None else message.md5
    service = CATALOG.service(type_name)
    if service is None:
        return WRONG_MD5
    is_request = kind in (EndpointKind.SERVICE_SERVER_SUBSCRIBER, EndpointKind.SERVICE_CLIENT_PUBLISHER)
    return (service.request if is_request else service.response).md5


def endpoint(
    kind: EndpointKind, topic_id: int, name: str, type_name: str, *, buffer_bytes: int = 512
) -> DeviceEndpoint:
    """An endpoint with the sum that its type has.

    Nobody calls the honest robot's emergency stop: it works for every device, and ends the drive that is measured.
    """
    if kind is EndpointKind.SERVICE_CLIENT_PUBLISHER and name == HONEST_LOCK:
        name = HONEST_UNLOCK
    return DeviceEndpoint(kind, topic_id, name, type_name, md5_of(kind, type_name), buffer_bytes)


def payload_of(type_name: str, dice: random.Random) -> bytes:
    """A message of the type; a velocity differs from every one of the honest program."""
    if type_name == "geometry_msgs/Twist":
        return struct.pack("<6d", dice.uniform(-1, 1), 0, 0, 0, 0, HOSTILE_RAD_S)
    if type_name == "geometry_msgs/Pose2D":
        return struct.pack("<3d", dice.uniform(-9, 9), dice.uniform(-9, 9), dice.uniform(-9, 9))
    if type_name == "std_msgs/UInt8MultiArray":
        size = int(2 ** dice.uniform(0, 14))
        return bytes(8) + struct.pack("<I", size) + bytes(size)
    message = CATALOG.message(type_name)
    return dice.randbytes(dice.randrange(64)) if message is None else message.encode({})


def request_of(type_name: str, dice: random.Random) -> bytes:
    """A request of the service type."""
    service = CATALOG.service(type_name)
    return dice.randbytes(dice.randrange(16)) if service is None else service.request.encode({})
