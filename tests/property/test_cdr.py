"""The translation of CDR compared with rosbags for every type of the catalog, and fed with any bytes."""

import contextlib
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hostlink.components.graphs.wire_layout import ros1_layout, ros2_layout
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.cdr import Cdr, cdr_of
from hostlink.core.messages.fields import Field
from hostlink.core.messages.message_type import MessageType
from hostlink.core.messages.ros2_names import ros2_type
from hostlink.errors import BadPayload, WrongType
from tests.support.cdr_writer import has_array_of_texts, written, written_by_micro_ros
from tests.support.random_messages import damaged, random_message
from tests.support.strategies import fewer_examples

CATALOG = Catalog()
STORE = get_typestore(Stores.ROS2_HUMBLE)
SINCE_HUMBLE = (Stores.ROS2_HUMBLE, Stores.ROS2_IRON, Stores.ROS2_JAZZY, Stores.ROS2_KILTED, Stores.LATEST)
RANGE, VARIANCE_BYTES = "sensor_msgs/Range", 4  # that Humble does not have


def translated(type_: MessageType) -> Cdr | None:
    """The translation; None if the type is refused."""
    with contextlib.suppress(WrongType):
        return cdr_of(type_)
    return None


def every_type() -> dict[str, MessageType]:
    services = map(CATALOG.service, CATALOG.service_names())
    found = [CATALOG.message(name) for name in CATALOG.message_names()]
    found += [part for service in services if service is not None for part in (service.request, service.response)]
    return {type_.name: type_ for type_ in found if type_ is not None}


def in_store(type_: MessageType) -> str:
    """The name of the type in the store of rosbags, which reads the definitions of those that ROS 2 does not have."""
    name = ros2_type(type_.name)
    if name not in STORE.fielddefs:
        read = get_types_from_msg(type_.full_definition, name) if type_.fields else {name: ([], [PLACEHOLDER])}
        STORE.register({each: fields for each, fields in read.items() if each not in STORE.fielddefs})
    return name


PLACEHOLDER = ("structure_needs_at_least_one_member", (Nodetype.BASE, ("uint8", 0)))
TYPES = every_type()
TRANSLATED = [name for name, known in TYPES.items() if translated(known) is not None]
names = st.sampled_from(TRANSLATED)
seeds = st.integers(0, 2**32 - 1)


def check_type(name: str, random: Random) -> None:
    known = TYPES[name]
    ros1 = known.encode(random_message(random, known.layout))
    expected = bytes(STORE.ros1_to_cdr(ros1, in_store(known)))
    cdr = cdr_of(known)
    assert cdr.from_ros1(ros1, is_encapsulated=True) == expected + bytes(VARIANCE_BYTES * (name == RANGE)), name
    assert cdr.to_ros1(expected, is_encapsulated=True) == bytes(STORE.cdr_to_ros1(expected, in_store(known))), name


def test_most_types_are_translated() -> None:
    assert len(TRANSLATED) > 250


@pytest.mark.parametrize("part", range(8))
def test_every_type_is_translated_as_by_rosbags(part: int) -> None:
    random = Random(part)
    for name in TRANSLATED[part::8]:
        for _ in range(4):
            check_type(name, random)


@given(names, seeds)
@fewer_examples(1)
def test_message_is_translated_as_by_rosbags(name: str, seed: int) -> None:
    check_type(name, Random(seed))


@given(names, st.binary(max_size=200), st.booleans())
@fewer_examples(1)
def test_any_bytes_raise_only_bad_payload(name: str, payload: bytes, is_encapsulated: bool) -> None:
    cdr = cdr_of(TYPES[name])
    with contextlib.suppress(BadPayload):
        cdr.to_ros1(payload, is_encapsulated=is_encapsulated)
    with contextlib.suppress(BadPayload):
        cdr.from_ros1(payload, is_encapsulated=is_encapsulated)


@given(names, seeds)
@fewer_examples(1)
def test_damaged_message_is_another_one_or_refused(name: str, seed: int) -> None:
    """A translation without an error is a message: it can be decoded, and has the same CDR again."""
    random, known = Random(seed), TYPES[name]
    ros1 = known.encode(random_message(random, known.layout))
    cdr = cdr_of(known)
    with contextlib.suppress(BadPayload):
        payload = cdr.to_ros1(damaged(random, cdr.from_ros1(ros1)))
        known.decode(payload)
        assert cdr.to_ros1(cdr.from_ros1(payload)) == payload
    with contextlib.suppress(BadPayload):
        payload = damaged(random, ros1)
        message = cdr.from_ros1(payload)
        known.decode(payload)
        assert cdr.from_ros1(cdr.to_ros1(message)) == message


@given(names.filter(lambda name: not has_array_of_texts(TYPES[name].layout)), seeds)
@fewer_examples(1)
def test_message_of_micro_ros_with_texts_that_were_never_set_is_translated(name: str, seed: int) -> None:
    random, known = Random(seed), TYPES[name]
    message = random_message(random, known.layout)
    cdr = cdr_of(known)
    expected = cdr.to_ros1(written(known.layout, message))
    assert cdr.to_ros1(written_by_micro_ros(known.layout, message, random)) == expected


def test_types_that_ros_2_has_changed_are_those_that_are_refused() -> None:
    """Range has one more field at its end, which is appended."""
    differing = {RANGE}
    for name, known in TYPES.items():
        for store in map(get_typestore, SINCE_HUMBLE):
            ros2 = ros2_type(name)
            if ros2 in store.fielddefs and not is_same(known, ros2, dict(store.fielddefs)):
                differing.add(name)
    assert differing == {RANGE, *(TYPES.keys() - set(TRANSLATED))}


def is_same(known: MessageType, name: str, fielddefs: dict[str, Any]) -> bool:
    ros2 = ros2_layout(lambda each: dict(fielddefs[each][1]), name)
    return ros1_layout(fields_of(known).get, known.name) == ros2


def fields_of(known: MessageType) -> dict[str, tuple[Field, ...]]:
    found = {known.name: known.fields}
    for nested in known.nested.values():
        found |= fields_of(nested)
    return found
