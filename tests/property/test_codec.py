"""The codec compared with the serialisation of rosbags, and fed with any bytes."""

import math
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from hostlink.core.messages import validating_codec
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.fields import FLOATS, FORMATS, SCALAR, VARIABLE, Field, Layout, integer_range
from hostlink.core.messages.message_type import MessageType
from hostlink.errors import BadPayload
from tests.support.fake_device import message_type

STORE = get_typestore(Stores.ROS1_NOETIC)
CATALOG = Catalog()

NAMES = [
    "actionlib_msgs/GoalStatusArray",
    "diagnostic_msgs/DiagnosticArray",
    "dynamic_reconfigure/ConfigDescription",
    "geometry_msgs/PolygonStamped",
    "geometry_msgs/Pose2D",
    "geometry_msgs/PoseArray",
    "geometry_msgs/PoseWithCovarianceStamped",
    "geometry_msgs/TransformStamped",
    "geometry_msgs/Twist",
    "nav_msgs/OccupancyGrid",
    "nav_msgs/Odometry",
    "nav_msgs/Path",
    "rosgraph_msgs/Log",
    "rosgraph_msgs/TopicStatistics",
    "sensor_msgs/BatteryState",
    "sensor_msgs/CameraInfo",
    "sensor_msgs/CompressedImage",
    "sensor_msgs/Image",
    "sensor_msgs/Imu",
    "sensor_msgs/JointState",
    "sensor_msgs/JoyFeedbackArray",
    "sensor_msgs/LaserScan",
    "sensor_msgs/MultiEchoLaserScan",
    "sensor_msgs/NavSatFix",
    "sensor_msgs/PointCloud2",
    "sensor_msgs/Range",
    "shape_msgs/Mesh",
    "shape_msgs/SolidPrimitive",
    "std_msgs/Bool",
    "std_msgs/ByteMultiArray",
    "std_msgs/Char",
    "std_msgs/Duration",
    "std_msgs/Empty",
    "std_msgs/Int64MultiArray",
    "std_msgs/String",
    "std_msgs/Time",
    "std_msgs/UInt64",
    "stereo_msgs/DisparityImage",
    "trajectory_msgs/JointTrajectory",
    "visualization_msgs/ImageMarker",
    "visualization_msgs/InteractiveMarkerInit",
    "visualization_msgs/MarkerArray",
]
ELEMENTS_MAX = 3
PATIENT = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # the machine may be busy

# Fields that ROS 1 times and durations share with the ROS 2 type that rosbags uses for them.
SECONDS = {"time": st.integers(0, 2**31 - 1), "duration": st.integers(-(2**31), 2**31 - 1)}
NANOSECONDS = st.integers(0, 2**31 - 1)


messages = st.sampled_from(NAMES).map(message_type)


def numbers(type_name: str) -> st.SearchStrategy[object]:
    if type_name == "bool":
        return st.booleans()
    if type_name in FLOATS:
        return st.floats(width=32 if type_name == "float32" else 64)
    values = integer_range(type_name)
    return st.integers(values.start, values.stop - 1)


def draw_message(data: st.DataObject, layout: Layout) -> dict[str, object]:
    return {field.name: draw_field(data, layout, field) for field in layout.fields}


def draw_field(data: st.DataObject, layout: Layout, field: Field) -> object:
    if field.array_length == SCALAR:
        return draw_one(data, layout, field)
    count = field.array_length
    if count == VARIABLE:
        count = data.draw(st.integers(0, ELEMENTS_MAX))
    if field.is_octets:
        return data.draw(st.binary(min_size=count, max_size=count))
    if field.type in FORMATS:
        return data.draw(st.lists(numbers(field.type), min_size=count, max_size=count))
    return [draw_one(data, layout, field) for _ in range(count)]


def draw_one(data: st.DataObject, layout: Layout, field: Field) -> object:
    if field.type == "string":
        return data.draw(st.text(st.characters(exclude_categories=["Cs"]), max_size=5))
    if field.type in FORMATS:
        return data.draw(numbers(field.type))
    if field.type in SECONDS:
        return {"secs": data.draw(SECONDS[field.type]), "nsecs": data.draw(NANOSECONDS)}
    return draw_message(data, layout.nested[field.type])


def stored(layout: Layout, value: dict[str, object]) -> object:
    """Return the value as an object of the typestore."""
    if layout.name in {"time", "duration"}:
        kind = STORE.types[f"builtin_interfaces/msg/{layout.name.title()}"]
        return kind(sec=value["secs"], nanosec=value["nsecs"])
    kind = STORE.types[layout.name.replace("/", "/msg/")]
    return kind(*[stored_field(layout, field, value[field.name]) for field in layout.fields])


def stored_field(layout: Layout, field: Field, value: object) -> object:
    if field.type in FORMATS and field.array_length != SCALAR:
        dtype = "?" if field.type == "bool" else f"<{FORMATS[field.type]}"
        return np.frombuffer(value, dtype) if field.is_octets else np.array(value, dtype)
    if field.type not in layout.nested:
        return value
    if field.array_length == SCALAR:
        return stored(layout.nested[field.type], value)
    return [stored(layout.nested[field.type], element) for element in value]


def same(ours: object, theirs: object) -> bool:
    """Whether two values are equal, with NaN equal to NaN."""
    if isinstance(ours, dict) and isinstance(theirs, dict):
        return list(ours) == list(theirs) and all(same(ours[name], theirs[name]) for name in ours)
    if isinstance(ours, list) and isinstance(theirs, list):
        return len(ours) == len(theirs) and all(map(same, ours, theirs))
    if isinstance(ours, float) and isinstance(theirs, float) and math.isnan(ours):
        return math.isnan(theirs)
    return type(ours) is type(theirs) and ours == theirs


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@settings(PATIENT, max_examples=settings().max_examples // 5)
@given(data=st.data())
def test_encoded_bytes_equal_those_of_rosbags(name: str, data: st.DataObject) -> None:
    ours = message_type(name)
    value = draw_message(data, ours.layout)
    payload = bytes(STORE.serialize_ros1(stored(ours.layout, value), ours.name.replace("/", "/msg/")))
    assert ours.encode(value) == payload
    decoded = ours.decode(payload)
    assert same(decoded, value)
    assert ours.encode(decoded) == payload


@PATIENT
@given(messages, st.data())
def test_validating_codec_agrees_with_the_compiled_one(ours: MessageType, data: st.DataObject) -> None:
    value = draw_message(data, ours.layout)
    payload = ours.encode(value)
    assert validating_codec.encode(ours.layout, value) == payload
    assert same(validating_codec.decode(ours.layout, payload), ours.decode(payload))


@PATIENT
@given(messages, st.data())
def test_cut_or_longer_payload_is_refused(ours: MessageType, data: st.DataObject) -> None:
    payload = ours.encode(draw_message(data, ours.layout))
    cuts = [payload[:end] for end in range(max(0, len(payload) - 64), len(payload))]
    for wrong in (*cuts, payload + data.draw(st.binary(min_size=1, max_size=3))):
        with pytest.raises(BadPayload):
            ours.decode(wrong)


@PATIENT
@given(messages, st.lists(st.binary(max_size=60) | st.integers(0, 4).map(lambda n: struct.pack("<I", n)), max_size=12))
def test_any_bytes_decode_or_raise_bad_payload(ours: MessageType, parts: list[bytes]) -> None:
    payload = b"".join(parts)
    try:
        decoded = ours.decode(payload)
    except BadPayload as error:
        assert error.type_name == ours.name  # noqa: PT017 -- most random bytes are bad, a few are not
    else:
        assert same(validating_codec.decode(ours.layout, payload), decoded)
        assert same(ours.decode(ours.encode(decoded)), decoded)
