"""Compiled codec alone: every type of the catalogue, and what it leaves to the validating codec."""

import struct

import pytest

from hostlink.core.messages import validating_codec
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.codec import UNCOMMON_LAYOUT, compile_decoder, compile_encoder
from hostlink.core.messages.fields import EMPTY_ELEMENTS_MAX, FORMATS, SCALAR, VARIABLE, Field, Layout
from hostlink.core.messages.message_type import MessageType, completed
from hostlink.errors import BadRequest

CATALOG = Catalog()
EMPTY = Layout("t/Empty", (), {})
PAIR = Layout("t/Pair", (Field("a", "uint8"), Field("b", "uint16")), {})
NAMED = Layout("t/Named", (Field("name", "string"),), {})
NESTED = {"t/Empty": EMPTY, "t/Pair": PAIR, "t/Named": NAMED}


def layout(*fields: Field) -> Layout:
    return Layout("t/Tried", fields, NESTED)


def every_type() -> list[MessageType]:
    services = map(CATALOG.service, CATALOG.service_names())
    found = [CATALOG.message(name) for name in CATALOG.message_names()]
    found += [part for service in services if service is not None for part in (service.request, service.response)]
    return [type_ for type_ in found if type_ is not None]


def plain(layout: Layout, *, elements: int) -> dict[str, object]:
    """Return a complete message whose variable arrays have that many elements, with no two adjacent numbers equal."""
    return {
        field.name: _field(layout, field, number, elements=elements) for number, field in enumerate(layout.fields, 1)
    }


def _field(layout: Layout, field: Field, number: int, *, elements: int) -> object:
    if field.array_length == SCALAR:
        return _one(layout, field, number, elements=elements)
    count = elements if field.array_length == VARIABLE else field.array_length
    if field.is_octets:
        return bytes(index % 251 for index in range(count))
    return [_one(layout, field, number + index, elements=elements) for index in range(count)]


def _one(layout: Layout, field: Field, number: int, *, elements: int) -> object:
    if field.type == "string":
        return f"text {number}"
    if field.type == "bool":
        return number % 2 == 1
    if field.type in FORMATS:
        return number / 2 if field.type.startswith("float") else number % 100
    return plain(layout.nested[field.type], elements=elements)


@pytest.mark.slow
@pytest.mark.parametrize("elements", [0, 1, 3])
def test_plain_messages_of_every_type_use_the_compiled_codec(elements: int) -> None:
    types = every_type()
    assert len(types) > 250
    for type_ in types:
        message = plain(type_.layout, elements=elements)
        payload = compile_encoder(type_.layout)(message)
        assert compile_decoder(type_.layout)(payload) == message, type_.name
        assert payload == validating_codec.encode(type_.layout, message), type_.name


def test_time_of_ros2_is_encoded_by_the_validating_codec() -> None:
    type_ = Catalog().message("std_msgs/Header")
    assert type_ is not None
    message = {"stamp": {"sec": 1, "nanosec": 2}}
    with pytest.raises(UNCOMMON_LAYOUT):
        compile_encoder(type_.layout)(message)
    assert type_.encode(message) == struct.pack("<4I", 0, 1, 2, 0)


def test_missing_fields_are_zero_without_the_validating_codec() -> None:
    type_ = Catalog().message("geometry_msgs/Twist")
    zero, encode = type_.decode(bytes(48)), compile_encoder(type_.layout)
    message = {"linear": {"x": 1.0}, "angular": {"z": 2.0}}
    assert encode(completed(message, zero)) == struct.pack("<6d", 1, 0, 0, 0, 0, 2) == type_.encode(message)
    assert encode(completed({}, zero)) == type_.encode({}) == bytes(48)
    for wrong in ({"linear": [1.0]}, {"linear": {"w": 1.0}}, {"linear": None}, {"speed": 1.0}):
        with pytest.raises(BadRequest):
            type_.encode(wrong)


def test_compiler_failure_is_not_hidden_by_the_fallback() -> None:
    """Otherwise the validating codec would do the work slowly and without a trace."""
    type_ = Catalog().message("geometry_msgs/Pose2D")
    type_.layout = Layout("t/Broken", (Field("x", "no such type"),), {})
    with pytest.raises(KeyError):
        type_.encode({"x": 1.0})
    with pytest.raises(KeyError):
        type_.decode(bytes(24))


LEFT_TO_DECODE = [
    (layout(Field("a", "uint8")), b"\x01\x02"),  # longer than the message
    (layout(Field("a", "uint16")), b"\x01"),
    (layout(Field("a", "string")), b"\x03\0\0\0ab"),
    (layout(Field("a", "string", VARIABLE)), b"\x01\0\0\0\x03\0\0\0ab"),
    (layout(Field("a", "string", VARIABLE)), b"\x02\0\0\0\x01\0\0\0abc"),
    (layout(Field("a", "string", VARIABLE)), b"\xff\xff\xff\xff"),
    (layout(Field("a", "uint8", VARIABLE)), b"\x03\0\0\0ab"),
    (layout(Field("a", "uint16", VARIABLE)), b"\x02\0\0\0abc"),
    (layout(Field("a", "t/Pair", VARIABLE)), b"\x02\0\0\0abcde"),
    (layout(Field("a", "t/Named", VARIABLE)), b"\xff\xff\xff\xff"),
    (layout(Field("a", "t/Empty", VARIABLE)), struct.pack("<I", EMPTY_ELEMENTS_MAX + 1)),
]
LEFT_TO_ENCODE = [
    (layout(Field("a", "uint8"), Field("b", "uint8")), {"a": 1}),
    (layout(Field("a", "uint8")), {"a": 1, "b": 2}),
    (layout(Field("a", "bool")), {"a": 1}),
    (layout(Field("a", "bool", VARIABLE)), {"a": [True, 1]}),
    (layout(Field("a", "bool", 2)), {"a": [True, 1]}),
    (layout(Field("a", "uint8", VARIABLE)), {"a": [1, 2]}),
    (layout(Field("a", "uint8", 2)), {"a": b"abc"}),
    (layout(Field("a", "uint16", 2)), {"a": [1, 2, 3]}),
    (layout(Field("a", "uint16", VARIABLE)), {"a": (1, 2)}),
    (layout(Field("a", "t/Pair", 2)), {"a": [{"a": 1, "b": 2}]}),
    (layout(Field("a", "t/Empty", VARIABLE)), {"a": [{}] * (EMPTY_ELEMENTS_MAX + 1)}),
    (layout(Field("a", "uint8")), {"a": 256}),
    (layout(Field("a", "uint8")), {"a": True}),
    (layout(Field("a", "float64")), {"a": False}),
    (layout(Field("a", "float64", VARIABLE)), {"a": [1.0, True]}),
    (layout(Field("a", "float64", 2)), {"a": [1.0, True]}),
]


@pytest.mark.parametrize(("layout", "payload"), LEFT_TO_DECODE)
def test_compiled_decoder_raises_for_uncommon_payloads(layout: Layout, payload: bytes) -> None:
    decode = compile_decoder(layout)
    with pytest.raises(UNCOMMON_LAYOUT):
        decode(payload)


@pytest.mark.parametrize(("layout", "message"), LEFT_TO_ENCODE)
def test_compiled_encoder_raises_for_uncommon_values(layout: Layout, message: dict[str, object]) -> None:
    encode = compile_encoder(layout)
    with pytest.raises(UNCOMMON_LAYOUT):
        encode(message)


def test_compiled_codec_accepts_the_largest_messages() -> None:
    """The validating codec gets one more of each."""
    many = layout(Field("a", "t/Empty", VARIABLE))
    message = {"a": [{}] * EMPTY_ELEMENTS_MAX}
    payload = struct.pack("<I", EMPTY_ELEMENTS_MAX)
    assert compile_encoder(many)(message) == payload
    assert compile_decoder(many)(payload) == message
    endless = layout(Field("a", "string"), Field("b", "string", VARIABLE), Field("c", "t/Named", VARIABLE))
    full = {"a": "", "b": ["", "x"], "c": [{"name": "y"}, {"name": ""}]}
    assert compile_decoder(endless)(compile_encoder(endless)(full)) == full


@pytest.mark.parametrize(
    ("field", "element"),
    [
        (Field("a", "t/Named", VARIABLE), {"name": "x"}),
        (Field("a", "t/Pair", VARIABLE), {"a": 1, "b": 2}),
        (Field("a", "t/Empty", EMPTY_ELEMENTS_MAX + 1), {}),
    ],
)
def test_only_a_list_of_empty_messages_has_a_limit(field: Field, element: dict[str, object]) -> None:
    """Every other length is bounded by the payload or fixed by the definition."""
    them = layout(field)
    message = {"a": [element] * (EMPTY_ELEMENTS_MAX + 1)}
    assert compile_decoder(them)(compile_encoder(them)(message)) == message


def test_list_of_messages_is_decoded_as_it_was_encoded() -> None:
    deep = Layout("t/Deep", (Field("pair", "t/Pair"), Field("c", "uint8", 3)), NESTED)
    twice = Layout("t/Twice", (Field("pairs", "t/Pair", 2), Field("c", "uint8")), NESTED)
    nested = {**NESTED, "t/Deep": deep, "t/Twice": twice}
    pair = {"a": 1, "b": 2}
    for element, message in (
        ("t/Pair", pair),
        ("t/Deep", {"pair": pair, "c": b"xyz"}),
        ("t/Twice", {"pairs": [pair, {"a": 3, "b": 4}], "c": 5}),
        ("t/Named", {"name": "x"}),
    ):
        several = Layout("t/Tried", (Field("before", "uint16"), Field("them", element, VARIABLE)), nested)
        value = {"before": 7, "them": [message, message]}
        assert compile_decoder(several)(compile_encoder(several)(value)) == value
