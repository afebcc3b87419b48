"""Control payloads: encoding, decoding and damage."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.events import Parameter
from hostlink.core.protocol.rosserial.control import (
    Log,
    decode_log,
    decode_parameter,
    decode_parameter_request,
    decode_topic_info,
    encode_parameter,
    encode_time,
    encode_topic_info,
)
from tests.support.device_codec import decode_time, encode_log, encode_parameter_request
from tests.support.strategies import topic_infos

RECORDED = bytes.fromhex(  # first TopicInfo of the robot in tests/captures
    "7d00110000002f726f626f745f302f6f646f6d657472791400000067656f6d657472795f6d7367732f506f73653244"
    "20000000393338666136353730393538346164386537376432333835323962653133623800020000"
)
INFO = DeviceEndpoint(
    EndpointKind.PUBLISHER, 125, "/robot_0/odometry", "geometry_msgs/Pose2D", "938fa65709584ad8e77d238529be13b8", 512
)


def test_recorded_topic_info_is_decoded() -> None:
    assert decode_topic_info(EndpointKind.PUBLISHER, RECORDED) == INFO
    assert encode_topic_info(INFO) == RECORDED


@pytest.mark.parametrize("size", range(len(RECORDED)))
def test_cut_topic_info_decodes_to_none(size: int) -> None:
    assert decode_topic_info(EndpointKind.PUBLISHER, RECORDED[:size]) is None


@pytest.mark.parametrize(
    "payload",
    [
        RECORDED + b"\x00",
        struct.pack("<HI", 125, 0xFFFFFFFF) + b"x",
        encode_topic_info(INFO._replace(name="")),
        encode_topic_info(INFO._replace(name="two words")),
        encode_topic_info(INFO._replace(name="\x1b[31m")),
        encode_topic_info(INFO._replace(type="é")),
        encode_topic_info(INFO._replace(name="x" * 256)),
    ],
    ids=["bytes after it", "4 GB", "no name", "space", "escape", "no ASCII", "long"],
)
def test_malformed_names_decode_to_none(payload: bytes) -> None:
    assert decode_topic_info(EndpointKind.PUBLISHER, payload) is None


@pytest.mark.parametrize(
    ("kind", "is_to_device"), [(0, False), (1, True), (2, False), (3, True), (4, False), (5, True)]
)
def test_kind_has_its_direction(kind: int, is_to_device: bool) -> None:
    assert INFO._replace(kind=EndpointKind(kind)).is_to_device is is_to_device


@given(topic_infos)
def test_topic_infos_round_trip(info: DeviceEndpoint) -> None:
    assert decode_topic_info(info.kind, encode_topic_info(info)) == info


@given(
    st.builds(
        Parameter,
        st.lists(st.integers(-(2**31), 2**31 - 1)).map(tuple),
        st.lists(st.floats(width=32, allow_nan=False)).map(tuple),
        st.lists(st.text()).map(tuple),
    )
)
def test_parameters_round_trip(parameter: Parameter) -> None:
    assert decode_parameter(encode_parameter(parameter)) == parameter


@given(st.text())
def test_parameter_requests_round_trip(name: str) -> None:
    assert decode_parameter_request(encode_parameter_request(name)) == name


@given(st.integers(0, 4), st.text())
def test_logs_round_trip(level: int, text: str) -> None:
    assert decode_log(encode_log(Log(level, text))) == Log(level, text)


def test_unknown_log_level_is_fatal_and_bad_text_is_replaced() -> None:
    assert decode_log(b"\xc8\x02\x00\x00\x00\xff!") == Log(4, "\ufffd!")


@given(st.integers(0, 2**32 * 10**9 - 1))
def test_times_round_trip(wall_ns: int) -> None:
    assert decode_time(encode_time(wall_ns)) == wall_ns


def test_time_wraps_after_136_years() -> None:
    assert decode_time(encode_time(2**32 * 10**9 + 5)) == 5


@given(st.binary(max_size=80))
def test_any_bytes_give_a_value_or_none(payload: bytes) -> None:
    for decode in (decode_log, decode_parameter, decode_parameter_request):
        decode(payload)  # type: ignore[operator]
    found = decode_topic_info(EndpointKind.SUBSCRIBER, payload)
    assert found is None or encode_topic_info(found) == payload


def test_count_over_the_payload_is_refused_before_anything_is_allocated() -> None:
    assert decode_parameter(b"\xff\xff\xff\x7f" + bytes(8)) is None
