"""Targets of the fuzzer, for any bytes, and the laws that must hold: one function a target, an error is a find.

`tools/fuzz.py` lets atheris search for such bytes; tests/unit/test_corpus.py tries those that it has found.
"""

import contextlib
import math
from collections.abc import Callable

from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.cdr import cdr_of
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.events import TopicsRequested
from hostlink.core.protocol.rosserial import control
from hostlink.core.protocol.rosserial.frame import FIRST_TOPIC_ID, OVERHEAD_BYTES, Frame, encode
from hostlink.core.protocol.rosserial.negotiation import REQUEST_INTERVAL_S
from hostlink.core.protocol.rosserial.session import Session
from hostlink.core.protocol.rosserial.stream import FrameStream, Skipped
from hostlink.errors import BadPayload, HostlinkError
from tests.support.device_codec import encode_log, encode_parameter_request

LIMIT_BYTES = 1024
SIZES = {"geometry_msgs/Pose2D": 24, "geometry_msgs/Twist": 48}
CATALOG = Catalog()
TYPES = [
    found
    for name in (
        "std_msgs/Bool", "std_msgs/String", "std_msgs/Float32MultiArray", "geometry_msgs/Twist", "nav_msgs/Odometry",
        "sensor_msgs/LaserScan", "sensor_msgs/JointState", "sensor_msgs/PointCloud2", "diagnostic_msgs/DiagnosticArray",
        "tf2_msgs/TFMessage", "rosgraph_msgs/Log",
    )
    if (found := CATALOG.message(name)) is not None
]  # fmt: skip
TRANSLATED = [cdr_of(type_) for type_ in TYPES if type_.name != "rosgraph_msgs/Log"]  # ROS 2 has another


def stream(data: bytes) -> None:
    """No byte is lost, and how they were cut changes no frame."""
    cut = data[0] if data else 0
    whole, pieces = FrameStream(limit_bytes=LIMIT_BYTES), FrameStream(limit_bytes=LIMIT_BYTES)
    found = list(whole.feed(data))
    apart = [*pieces.feed(data[:cut]), *pieces.feed(data[cut:])]
    assert [item for item in found if isinstance(item, Frame)] == [item for item in apart if isinstance(item, Frame)]
    assert len(whole.pending) <= LIMIT_BYTES + OVERHEAD_BYTES
    while whole.pending:
        found += whole.give_up()
    wires = (item.data if isinstance(item, Skipped) else encode(item.topic_id, item.payload) for item in found)
    assert b"".join(wires) == data


def session(data: bytes) -> None:
    """Any bytes at any time: no error, no two requests for topics within a second, nothing too large to a device."""
    tried = Session(check=lambda info: SIZES.get(info.type))
    now_s = 0.0
    found = tried.open(now_s=now_s)
    requested_at_s = -REQUEST_INTERVAL_S
    while True:
        for event in found:
            if isinstance(event, TopicsRequested):
                assert now_s >= requested_at_s + REQUEST_INTERVAL_S
                requested_at_s = now_s
        send_all(tried, now_s)
        if now_s >= tried.deadline_s():
            found = tried.tick(now_s=now_s)
        elif data:
            size = data[0] % 64
            now_s += data[0] // 64 * 0.7  # before the bytes
            found = tried.receive(data[1 : 1 + size], now_s=now_s)
            data = data[1 + size :]
        else:
            return


def send_all(tried: Session, now_s: float) -> None:
    """Send something on each topic, and check what leaves for the device."""
    for info in tried.topics:
        with contextlib.suppress(HostlinkError):  # refused before it is queued
            tried.publish(info.name, bytes(SIZES.get(info.type, 3)))
    buffers = {info.id: info.buffer_bytes for info in tried.topics if info.is_to_device}
    while (outgoing := tried.pop_frame(now_s=now_s, wall_ns=0)) is not None:
        frame = outgoing.frame
        topic_id = int.from_bytes(frame[5:7], "little")
        assert topic_id < FIRST_TOPIC_ID or topic_id in buffers
        assert buffers.get(topic_id, 0) <= 0 or len(frame) <= buffers[topic_id]


def control_payloads(data: bytes) -> None:
    """Each payload is nothing, or something that is the same when it is written and read again."""
    for kind in EndpointKind:
        info = control.decode_topic_info(kind, data)
        assert info is None or control.decode_topic_info(kind, control.encode_topic_info(info)) == info
    log = control.decode_log(data)
    assert log is None or control.decode_log(encode_log(log)) == log
    name = control.decode_parameter_request(data)
    assert name is None or control.decode_parameter_request(encode_parameter_request(name)) == name
    parameter = control.decode_parameter(data)
    if parameter is not None and not any(map(math.isnan, parameter.floats)):
        assert control.decode_parameter(control.encode_parameter(parameter)) == parameter


def codec(data: bytes) -> None:
    """A payload fits its type or is refused; what fits is the same when it is written and read again."""
    if not data:
        return
    type_ = TYPES[data[0] % len(TYPES)]
    try:
        message = type_.decode(data[1:])
    except BadPayload:
        return
    again = type_.encode(message)
    assert type_.encode(type_.decode(again)) == again


def cdr(data: bytes) -> None:
    """CDR and bytes of ROS 1 are translated or refused; what is translated is the same when it is translated back."""
    if not data:
        return
    type_, payload = TRANSLATED[data[0] % len(TRANSLATED)], data[1:]
    with contextlib.suppress(BadPayload):
        ros1 = type_.to_ros1(payload)
        assert type_.to_ros1(type_.from_ros1(ros1)) == ros1
    with contextlib.suppress(BadPayload):
        ros2 = type_.from_ros1(payload)
        assert type_.from_ros1(type_.to_ros1(ros2)) == ros2


TARGETS: dict[str, Callable[[bytes], None]] = {
    "stream": stream,
    "session": session,
    "control": control_payloads,
    "codec": codec,
    "cdr": cdr,
}
