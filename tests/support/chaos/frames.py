"""Frames of hostile devices: what they announce, and floods of every kind of frame. Bytes from dice, no socket."""

import functools
import itertools
import math
import random
from collections.abc import Callable, Iterator

from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.events import LOG_LEVELS
from hostlink.core.protocol.rosserial.control import Log, encode_topic_info
from hostlink.core.protocol.rosserial.frame import FIRST_TOPIC_ID, SYNC, Id, encode
from tests.support.chaos.names import (
    CLASHING_NAMES,
    HONEST_ODOMETRY,
    HONEST_RESET,
    HONEST_VELOCITY,
    MESSAGE_TYPES,
    ROGUE_TOPICS,
    SERVICE_TYPES,
    SERVICES,
    WRONG_MD5,
    endpoint,
    payload_of,
    request_of,
)
from tests.support.device_codec import encode_log, encode_parameter_request

TIME = encode(Id.TIME, bytes(8))
BLOCK_BYTES = 128 * 1024  # of a flood, at once
FIRST_FROM_DEVICE = 125
MOST_TOPICS = 6000
ROBOT_TYPES = ["geometry_msgs/Twist", "geometry_msgs/Pose2D"]
Blocks = Iterator[bytes]

_MESSAGES = (EndpointKind.PUBLISHER, EndpointKind.SUBSCRIBER)


def info_frame(info: DeviceEndpoint) -> bytes:
    return encode(info.kind, encode_topic_info(info))


def introduction(infos: list[DeviceEndpoint]) -> bytes:
    """Return a device's answer to a topic request; the time request after it ends the negotiation."""
    return TIME + b"".join(map(info_frame, infos)) + TIME


def robot(name: str) -> list[DeviceEndpoint]:
    """A robot as the paper's, and a topic for floods."""
    return [
        endpoint(EndpointKind.SUBSCRIBER, 100, f"/{name}/velocity_commands", "geometry_msgs/Twist"),
        endpoint(EndpointKind.PUBLISHER, 125, f"/{name}/odometry", "geometry_msgs/Pose2D"),
        endpoint(EndpointKind.PUBLISHER, 126, f"/{name}/data", "std_msgs/UInt8MultiArray", buffer_bytes=20000),
    ]


def draw_announcement(dice: random.Random) -> list[DeviceEndpoint]:
    """One to thousands of endpoints: few or many names and types, right and wrong sums, ids in order or not."""
    count = int(math.exp(dice.uniform(0.7, math.log(MOST_TOPICS))))
    names = dice.sample(CLASHING_NAMES, dice.randint(1, 4))
    types = dice.choice((ROBOT_TYPES, dice.sample(MESSAGE_TYPES, dice.randint(1, 4))))
    own_share = 1.0 if count > 500 else dice.choice((0.0, 0.0, 0.3, 1.0))
    wrong_share = dice.choice((0.0, 0.0, 0.0, 0.2, 1.0))
    kinds = dice.choice((_MESSAGES, _MESSAGES, tuple(EndpointKind)))
    is_in_order = dice.random() < 0.8
    to_device, from_device = itertools.count(FIRST_TOPIC_ID), itertools.count(FIRST_FROM_DEVICE + count)
    infos = []
    for number in range(count):
        kind = dice.choice(kinds)
        name = f"/many_{number}/topic" if dice.random() < own_share else dice.choice(names)
        made = endpoint(kind, 0, name, dice.choice(types if kind in _MESSAGES else SERVICE_TYPES))
        ids = to_device if made.is_to_device else from_device
        topic_id = next(ids) if is_in_order else dice.randrange(FIRST_TOPIC_ID, 65536)
        md5 = WRONG_MD5 if dice.random() < wrong_share else made.md5
        infos.append(made._replace(id=topic_id, md5=md5, buffer_bytes=dice.choice((512, 512, 280, 0, -1, 70000))))
    return infos


def data_frame(info: DeviceEndpoint, dice: random.Random) -> bytes:
    """A frame that the endpoint might send."""
    if info.kind in _MESSAGES:
        return encode(info.id, payload_of(info.type, dice))
    return encode(info.id, request_of(info.type, dice))


# -- floods: each gives blocks without end ----------------------------------------------------------------------------


def same(frame: bytes) -> Blocks:
    """One frame again and again."""
    return itertools.repeat(frame * max(1, BLOCK_BYTES // len(frame)))


def messages(dice: random.Random) -> Blocks:
    """Return messages of the robot's own topics, small and large."""
    return same(data_frame(robot("x")[dice.choice((1, 2, 2))], dice))


def logs(dice: random.Random) -> Blocks:
    text = "x" * dice.choice((1, 60, 900))
    return same(encode(Id.LOG, encode_log(Log(dice.randrange(len(LOG_LEVELS)), text))))


def new_names(dice: random.Random) -> Blocks:
    """Return requests for parameters with new names."""
    word = f"p{dice.randrange(1 << 30)}_"
    numbers = itertools.count()
    size = dice.choice((8, 100, 900, 900))
    while True:
        frames = (encode(Id.PARAMETER, encode_parameter_request(f"{word}{next(numbers):0{size}}")) for _ in range(1000))
        yield b"".join(frames)


def parameters(_: random.Random) -> Blocks:
    return same(encode(Id.PARAMETER, encode_parameter_request("gain")))


def times(_: random.Random) -> Blocks:
    return same(TIME)


def wrong_topics(dice: random.Random) -> Blocks:
    """TopicInfos with sums that are not those of their types."""
    names = dice.choice((ROGUE_TOPICS, CLASHING_NAMES))
    infos = [
        endpoint(EndpointKind.PUBLISHER, 125 + number, name, "std_msgs/String")._replace(md5=WRONG_MD5)
        for number, name in enumerate(names)
    ]
    return same(b"".join(map(info_frame, infos)))


def right_topics(dice: random.Random) -> Blocks:
    """Return one negotiation repeatedly, with and without a message that ends it."""
    ending = dice.choice((b"", TIME))
    return same(b"".join(map(info_frame, robot(f"rogue_{dice.randrange(4)}"))) + ending)


def changing_topics(dice: random.Random) -> Blocks:
    """A negotiation, and another one."""
    introductions = [introduction(robot(f"rogue_{number}")) for number in dice.sample(range(100), 20)]
    return same(b"".join(introductions))


def requests(dice: random.Random) -> Blocks:
    """Calls of a service, of a type that is known or not."""
    type_name = dice.choice(SERVICE_TYPES)
    infos = service_client(dice.choice(SERVICES), type_name, 512)
    frame = encode(infos[0].id, request_of(type_name, dice))
    return itertools.chain([introduction(infos)], same(frame))


def unknown_ids(dice: random.Random) -> Blocks:
    ids = dice.sample(range(200, 65536), dice.choice((1, 500)))
    return same(b"".join(encode(topic_id, bytes(8)) for topic_id in ids))


def host_ids(dice: random.Random) -> Blocks:
    """Return frames with ids that only a host may use, and with unassigned ids."""
    return same(encode(dice.choice((Id.STOP, 8, 9, 12, 99)), dice.randbytes(8)))


def protocol_1(dice: random.Random) -> Blocks:
    """Frames of before 2013."""
    payload = dice.randbytes(24)
    body = bytes([125, 0, len(payload), 0]) + payload
    return same(b"\xff\xff" + body + bytes([255 - sum(body) % 256]))


def garbage(dice: random.Random) -> Blocks:
    return same(dice.randbytes(dice.choice((64, 5000))))


def half_frames(dice: random.Random) -> Blocks:
    frame = encode(125, bytes(24))
    return same(frame[: dice.randrange(1, len(frame))])


def huge_claims(dice: random.Random) -> Blocks:
    """Headers that claim a lot, one inside the other."""
    size = dice.choice((1000, 20000, 65535))
    header = SYNC + size.to_bytes(2, "little") + bytes([255 - (size % 256 + size // 256) % 256]) + b"\x7d\x00"
    return same(header + bytes(dice.choice((0, 3, 200))))


def mixture(dice: random.Random) -> Blocks:
    """A little of each, cut anywhere."""
    makers = dice.sample(SINGLE_FLOODS, 5)
    parts = [next(iter(maker(dice)))[: dice.randrange(200, 4000)] for maker in makers]
    return same(b"".join(parts))


SINGLE_FLOODS: list[Callable[[random.Random], Blocks]] = [
    messages, logs, new_names, parameters, times, wrong_topics, right_topics, changing_topics, requests, unknown_ids,
    host_ids, protocol_1, garbage, half_frames, huge_claims,
]  # fmt: skip
FLOODS = [*SINGLE_FLOODS, messages, new_names, requests, mixture]  # floods that add up are twice as frequent


def service_client(service: str, type_name: str, buffer_bytes: int) -> list[DeviceEndpoint]:
    """A device that calls a service: its requests come by the first id, answers go to the second."""
    return [
        endpoint(EndpointKind.SERVICE_CLIENT_PUBLISHER, 125, service, type_name, buffer_bytes=buffer_bytes),
        endpoint(EndpointKind.SERVICE_CLIENT_SUBSCRIBER, 100, service, type_name, buffer_bytes=buffer_bytes),
    ]


def service_server(service: str, type_name: str) -> list[DeviceEndpoint]:
    """A device that offers one: requests go to the first id, its answers come by the second."""
    return [
        endpoint(EndpointKind.SERVICE_SERVER_SUBSCRIBER, 100, service, type_name),
        endpoint(EndpointKind.SERVICE_SERVER_PUBLISHER, 125, service, type_name),
    ]


@functools.cache
def honest_introduction() -> bytes:
    """The honest robot's firmware, byte for byte."""
    return introduction(
        [
            endpoint(EndpointKind.SUBSCRIBER, 100, HONEST_VELOCITY, "geometry_msgs/Twist"),
            endpoint(EndpointKind.SUBSCRIBER, 101, HONEST_RESET, "std_msgs/Empty"),
            endpoint(EndpointKind.PUBLISHER, 125, HONEST_ODOMETRY, "geometry_msgs/Pose2D"),
        ]
    )
