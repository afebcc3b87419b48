"""Encoding and decoding: accepted values, error texts, and the cost of a hostile payload."""

import math
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from hostlink.core.messages import validating_codec
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.fields import ENCODED_BYTES_MAX
from hostlink.core.messages.message_type import MessageType
from hostlink.errors import BadPayload, BadRequest

DEFINITIONS = {
    "Kinds": "bool on\nint8 small\nuint64 large\nfloat32 rough\nfloat64 fine\nstring text\ntime stamp\nduration span\n",
    "Arrays": "uint8[] blob\nchar[2] pair\nint16[] steps\nfloat32[3] axes\nbool[] flags\nstring[] names\n"
    "time[] times\n",
    "Nothing": "uint8 ONLY_A_CONSTANT=1\n",
    "OnlyEmpty": "Nothing inner\nNothing[2] two\n",
    "OnlyEmptys": "Nothing[] some\nOnlyEmpty[] more\n",
    "Named": "string name\nfloat32[2] size\n",
    "Nested": "Named[] many\nNamed[2] two\nKinds kinds\nstring[2] fixed\nbool[2] flags\n",
    "Grid": "geometry_msgs/Point[2] corners\n",
    "Grids": "Grid[] grids\n",
}


@pytest.fixture(scope="module")
def catalog(tmp_path_factory: pytest.TempPathFactory) -> Catalog:
    folder: Path = tmp_path_factory.mktemp("definitions")
    (folder / "t").mkdir()
    for name, text in DEFINITIONS.items():
        (folder / "t" / f"{name}.msg").write_text(text)
    return Catalog([folder])


def message(catalog: Catalog, name: str) -> MessageType:
    found = catalog.message(name)
    assert found is not None
    return found


KINDS = {
    "on": True,
    "small": -1,
    "large": 2**64 - 1,
    "rough": 0.5,
    "fine": -0.25,
    "text": "åäö ✓",
    "stamp": {"secs": 1, "nsecs": 2},
    "span": {"secs": -1, "nsecs": 5},
}
ARRAYS = {
    "blob": b"\x00\xff",
    "pair": b"ab",
    "steps": [-2, 3],
    "axes": [1.0, math.inf, -2.0],
    "flags": [True, False],
    "names": ["", "b"],
    "times": [{"secs": 1, "nsecs": 2}, {"secs": 3, "nsecs": 4}],
}
NAMED = {"name": "a", "size": [1.0, 2.0]}
NESTED = {
    "many": [NAMED, {"name": "", "size": [0.0, 0.5]}],
    "two": [NAMED, NAMED],
    "kinds": KINDS,
    "fixed": ["x", "yz"],
    "flags": [False, True],
}
EMPTY = {"inner": {}, "two": [{}, {}]}
CORNERS = {"corners": [{"x": 1.0, "y": 2.0, "z": 3.0}, {"x": 4.0, "y": 5.0, "z": 6.0}]}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("t/Kinds", KINDS),
        ("t/Arrays", ARRAYS),
        ("t/Nothing", {}),
        ("t/OnlyEmpty", EMPTY),
        ("t/OnlyEmptys", {"some": [{}] * 16, "more": [EMPTY] * 2}),
        ("t/Nested", NESTED),
        ("t/Grids", {"grids": [CORNERS, CORNERS]}),
    ],
)
def test_encoded_value_is_decoded(catalog: Catalog, name: str, value: dict[str, object]) -> None:
    ours = message(catalog, name)
    payload = ours.encode(value)
    decoded = ours.decode(payload)
    assert decoded == value
    assert validating_codec.encode(ours.layout, value) == payload
    assert validating_codec.decode(ours.layout, payload) == value
    assert list(decoded) == [field.name for field in ours.fields]


def test_encoded_bytes_of_every_kind_of_field(catalog: Catalog) -> None:
    assert message(catalog, "t/Kinds").encode({**KINDS, "text": "ab"}) == struct.pack(
        "<?bQfdI2sIIii", True, -1, 2**64 - 1, 0.5, -0.25, 2, b"ab", 1, 2, -1, 5
    )


def test_view_decodes_like_bytes(catalog: Catalog) -> None:
    ours = message(catalog, "std_msgs/UInt8MultiArray")
    payload = ours.encode({"data": b"abc"})
    assert ours.decode(memoryview(payload)) == ours.decode(payload)


@pytest.mark.parametrize(
    ("name", "given", "meant"),
    [
        ("t/Kinds", {"on": 1, "fine": 3}, {"on": True, "fine": 3.0}),
        ("t/Kinds", {"stamp": {"sec": 7, "nanosec": 8}}, {"stamp": {"secs": 7, "nsecs": 8}}),
        ("t/Kinds", {"span": {"sec": -7}}, {"span": {"secs": -7}}),
        ("t/Arrays", {"blob": "AP8="}, {"blob": b"\x00\xff"}),
        ("t/Arrays", {"blob": bytearray(b"ab")}, {"blob": b"ab"}),
        ("t/Arrays", {"blob": [0, 255], "pair": (97, 98)}, {"blob": b"\x00\xff", "pair": b"ab"}),
        ("t/Arrays", {"blob": np.array([1, 2], np.uint8)}, {"blob": b"\x01\x02"}),
        ("t/Arrays", {"steps": np.array([1, 2]), "axes": np.array([1, 2, 3.0])}, {"steps": [1, 2], "axes": [1, 2, 3]}),
        ("t/Arrays", {"flags": np.array([True]), "names": ("a",)}, {"flags": [True], "names": ["a"]}),
        ("t/Nested", {"many": ({"name": "x"},)}, {"many": [{"name": "x", "size": [0, 0]}]}),
        ("geometry_msgs/Point", {"x": np.float64(1), "y": np.int32(2)}, {"x": 1, "y": 2}),
    ],
)
def test_alternative_forms_of_a_value_are_accepted(
    catalog: Catalog, name: str, given: dict[str, object], meant: dict[str, object]
) -> None:
    ours = message(catalog, name)
    assert ours.encode(given) == ours.encode({**ours.decode(ours.encode({})), **meant})


def test_null_float_is_encoded_as_nan(catalog: Catalog) -> None:
    values = message(catalog, "t/Arrays").decode(message(catalog, "t/Arrays").encode({"axes": [1.0, None, 2.0]}))
    axes = values["axes"]
    assert isinstance(axes, list)
    assert [math.isnan(axis) for axis in axes] == [False, True, False]
    fine = message(catalog, "t/Kinds").decode(message(catalog, "t/Kinds").encode({"fine": None}))["fine"]
    assert isinstance(fine, float)
    assert math.isnan(fine)


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("t/Kinds", [], "t/Kinds: wanted an object with fields, got []"),
        (
            "t/Kinds",
            {"of": 1},
            "t/Kinds has no field 'of'; its fields: on, small, large, rough, fine, text, stamp, span",
        ),
        ("t/Nothing", {"a": 1}, "t/Nothing has no field 'a'; its fields: none"),
        ("t/Nested", {"kinds": {"x": 0}}, "t/Nested.kinds has no field 'x'; its fields: " + ", ".join(KINDS)),
        ("t/Kinds", {"stamp": {"sec": 1, "nsecs": 2}}, "t/Kinds.stamp has no field 'sec'; its fields: secs, nsecs"),
        ("t/Kinds", {**KINDS, "stamp": 5}, "t/Kinds.stamp: wanted an object with fields, got 5"),
        ("t/Kinds", {"on": 2}, "t/Kinds.on: wanted true or false, got 2"),
        ("t/Kinds", {**KINDS, "on": "yes"}, "t/Kinds.on: wanted true or false, got 'yes'"),
        ("t/Kinds", {**KINDS, "small": 128}, "t/Kinds.small: 128 is outside -128..127"),
        ("t/Kinds", {"large": -1}, "t/Kinds.large: -1 is outside 0..18446744073709551615"),
        ("t/Kinds", {"small": 1.5}, "t/Kinds.small: wanted a whole number, got 1.5"),
        ("t/Kinds", {"small": None}, "t/Kinds.small: wanted a whole number, got None"),
        ("t/Kinds", {**KINDS, "rough": 1e39}, "t/Kinds.rough: 1e+39 is too large for a float32"),
        ("t/Kinds", {"fine": "1"}, "t/Kinds.fine: wanted a number, got '1'"),
        ("t/Kinds", {"fine": True}, "t/Kinds.fine: wanted a number, got True"),
        ("t/Kinds", {**KINDS, "rough": False}, "t/Kinds.rough: wanted a number, got False"),
        ("t/Kinds", {**KINDS, "small": True}, "t/Kinds.small: wanted a whole number, got True"),
        ("t/Kinds", {**KINDS, "text": b"a"}, "t/Kinds.text: wanted text, got b'a'"),
        ("t/Kinds", {"text": "ab\ud800"}, "t/Kinds.text: half a surrogate pair at character 2"),
        ("t/Arrays", {"blob": "#"}, "t/Arrays.blob: wanted base64, got '#'"),
        ("t/Arrays", {"blob": "å"}, "t/Arrays.blob: wanted base64, got 'å'"),
        ("t/Arrays", {"blob": [1, 256]}, "t/Arrays.blob[1]: 256 is outside 0..255"),
        ("t/Arrays", {"blob": 5}, "t/Arrays.blob: wanted a list, got 5"),
        ("t/Arrays", {"pair": b"abc"}, "t/Arrays.pair: wanted 2 elements, got 3"),
        ("t/Arrays", {**ARRAYS, "axes": [1.0]}, "t/Arrays.axes: wanted 3 elements, got 1"),
        ("t/Arrays", {**ARRAYS, "pair": b"a"}, "t/Arrays.pair: wanted 2 elements, got 1"),
        ("t/Arrays", {"axes": [1.0, 2.0, "x"]}, "t/Arrays.axes[2]: wanted a number, got 'x'"),
        ("t/Arrays", {**ARRAYS, "axes": [1.0, True, 2.0]}, "t/Arrays.axes[1]: wanted a number, got True"),
        ("t/Arrays", {**ARRAYS, "steps": [1, False]}, "t/Arrays.steps[1]: wanted a whole number, got False"),
        ("t/Arrays", {"blob": [1, True]}, "t/Arrays.blob[1]: wanted a whole number, got True"),
        ("t/Arrays", {"steps": {1: 2}}, "t/Arrays.steps: wanted a list, got {1: 2}"),
        ("t/Arrays", {"steps": np.array(5)}, "t/Arrays.steps: wanted a list, got 5"),
        ("t/Arrays", {**ARRAYS, "flags": [True, 5]}, "t/Arrays.flags[1]: wanted true or false, got 5"),
        ("t/Arrays", {"names": "ab"}, "t/Arrays.names: wanted a list, got 'ab'"),
        ("t/Nested", {"many": [NAMED, {"name": 5}]}, "t/Nested.many[1].name: wanted text, got 5"),
        ("t/OnlyEmptys", {"some": [{}] * 17}, "t/OnlyEmptys.some: at most 16 elements without fields, got 17"),
        (
            "t/OnlyEmptys",
            {"some": [{}] * 17, "more": []},
            "t/OnlyEmptys.some: at most 16 elements without fields, got 17",
        ),
    ],
)
def test_bad_value_is_named_by_its_path(catalog: Catalog, name: str, value: dict[str, object], problem: str) -> None:
    with pytest.raises(BadRequest) as error:
        message(catalog, name).encode(value)
    assert str(error.value) == problem


@pytest.mark.parametrize(
    ("name", "payload", "problem"),
    [
        ("geometry_msgs/Vector3", bytes(20), "geometry_msgs/Vector3: z: needs 8 bytes at 16, 4 left"),
        (
            "geometry_msgs/Vector3",
            bytes(25),
            "geometry_msgs/Vector3: the message ends after 24 bytes, the payload has 25",
        ),
        ("std_msgs/Empty", b"\x00", "std_msgs/Empty: the message ends after 0 bytes, the payload has 1"),
        ("std_msgs/String", b"\x05\x00\x00\x00abc", "std_msgs/String: data: 5 bytes announced, 3 left"),
        ("std_msgs/String", b"\x05\x00", "std_msgs/String: data: needs 4 bytes at 0, 2 left"),
        (
            "std_msgs/Float32MultiArray",
            struct.pack("<IIIf", 0, 0, 9, 1.0),
            "std_msgs/Float32MultiArray: data: 9 elements of at least 4 bytes announced, 4 left",
        ),
        (
            "std_msgs/Header",
            struct.pack("<IIII", 1, 2, 3, 2**32 - 1),
            "std_msgs/Header: frame_id: 4294967295 bytes announced, 0 left",
        ),
        (
            "geometry_msgs/PoseArray",
            bytes(16) + struct.pack("<I", 2**32 - 1) + bytes(56),
            "geometry_msgs/PoseArray: poses: 4294967295 elements of at least 56 bytes announced, 56 left",
        ),
        (
            "t/Nested",
            struct.pack("<II", 1, 0) + bytes(5),
            "t/Nested: many: 1 elements of at least 12 bytes announced, 9 left",
        ),
        ("t/Nested", struct.pack("<II", 0, 0) + bytes(5), "t/Nested: two[0].size[1]: needs 4 bytes at 12, 1 left"),
        (
            "t/OnlyEmptys",
            struct.pack("<II", 17, 0),
            "t/OnlyEmptys: some: 17 elements without fields, at most 16 are accepted",
        ),
        (
            "t/OnlyEmptys",
            struct.pack("<II", 0, 2**32 - 1),
            "t/OnlyEmptys: more: 4294967295 elements without fields, at most 16 are accepted",
        ),
        ("t/Arrays", struct.pack("<I", 9) + b"ab", "t/Arrays: blob: 9 bytes announced, 2 left"),
    ],
)
def test_bad_payload_is_refused_with_its_numbers(catalog: Catalog, name: str, payload: bytes, problem: str) -> None:
    with pytest.raises(BadPayload) as error:
        message(catalog, name).decode(payload)
    assert str(error.value) == problem


@pytest.mark.parametrize(
    ("name", "value"),
    [("t/Kinds", KINDS), ("t/Arrays", ARRAYS), ("t/OnlyEmptys", {"some": [{}]}), ("t/Nested", NESTED)],
)
def test_every_cut_and_every_extra_byte_is_a_bad_payload(catalog: Catalog, name: str, value: dict[str, object]) -> None:
    ours = message(catalog, name)
    payload = ours.encode(value)
    for wrong in (*(payload[:end] for end in range(len(payload))), payload + b"\x00"):
        with pytest.raises(BadPayload):
            ours.decode(wrong)


@pytest.mark.parametrize(
    "name",
    [
        "std_msgs/String",
        "std_msgs/UInt8MultiArray",
        "sensor_msgs/LaserScan",
        "sensor_msgs/JointState",
        "geometry_msgs/PoseArray",
        "diagnostic_msgs/DiagnosticArray",
        "t/OnlyEmptys",
        "t/Nested",
        "t/Arrays",
    ],
)
def test_length_field_alone_allocates_no_memory(catalog: Catalog, name: str) -> None:
    ours = message(catalog, name)
    with pytest.raises(BadPayload):
        ours.decode(b"\xff" * 100)
    tracemalloc.start()
    try:
        for zeros in range(0, 100, 4):
            with pytest.raises(BadPayload):
                ours.decode(bytes(zeros) + b"\xff" * (200 - zeros))
        peak_bytes = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak_bytes < 100_000


def test_text_that_is_not_utf_8_can_still_become_json(catalog: Catalog) -> None:
    ours = message(catalog, "std_msgs/String")
    assert ours.decode(struct.pack("<I", 4) + b"caf\xe9") == {"data": "caf\ufffd"}
    names = message(catalog, "t/Arrays").encode({"names": ["?"]}).replace(b"?", b"\xff")
    assert message(catalog, "t/Arrays").decode(names)["names"] == ["\ufffd"]


def test_message_that_is_larger_than_any_receiver_must_accept_is_refused(catalog: Catalog) -> None:
    type_, value = message(catalog, "t/Arrays"), {"names": [""] * (ENCODED_BYTES_MAX // 4 + 1)}
    with pytest.raises(BadRequest, match=f"t/Arrays: more than {ENCODED_BYTES_MAX} bytes"):
        type_.encode(value)
    with pytest.raises(BadRequest, match=f"names: more than {ENCODED_BYTES_MAX} bytes"):
        validating_codec.encode(type_.layout, value)
