"""Bytes of a device's line: frames, junk, damage, and every way to cut them."""

from itertools import pairwise
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st

from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.frame import Frame, encode

payloads = st.binary(max_size=60)
topic_ids = st.integers(0, 0xFFFF)
frames = st.builds(Frame, topic_ids, payloads)
# Syncs, half syncs and headers that lie, because plain random bytes hardly ever have one.
liars = st.builds(
    lambda size, rest: b"\xff\xfe" + size.to_bytes(2, "little") + bytes([~(size + (size >> 8)) & 0xFF]) + rest,
    st.integers(0, 1200),
    st.binary(max_size=12),
)
noise = st.one_of(st.binary(max_size=20), st.sampled_from([b"\xff", b"\xff\xff", b"\xff\xfe", b"\xff\xfe\x05"]), liars)

names = st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=20)
topic_infos = st.builds(
    DeviceEndpoint,
    st.sampled_from(EndpointKind),
    st.integers(100, 160),
    names,
    names,
    names,
    st.integers(-(2**31), 2**31 - 1),
)


def fewer_examples(divisor: int, **options: Any) -> settings:
    """Return settings with a fraction of the profile's examples, for tests whose examples are slow.

    `make fuzz` multiplies these examples too.
    """
    return settings(deadline=None, max_examples=max(1, settings().max_examples // divisor), **options)


def wire_of(frame: Frame) -> bytes:
    """The bytes of a frame."""
    return encode(frame.topic_id, frame.payload)


def split(wire: bytes, data: st.DataObject) -> list[bytes]:
    """Split the bytes into reads of any size."""
    cuts = data.draw(st.lists(st.integers(0, len(wire)), max_size=12).map(sorted), label="cuts")
    bounds = [0, *cuts, len(wire)]
    return [wire[begin:end] for begin, end in pairwise(bounds)]


def damaged(wire: bytes, data: st.DataObject) -> bytes:
    """The bytes with some lost, changed or added."""
    line = bytearray(wire)
    for _ in range(data.draw(st.integers(0, 4), label="faults")):
        if not line:
            break
        at = data.draw(st.integers(0, len(line) - 1), label="at")
        match data.draw(st.sampled_from(["lose", "change", "add"]), label="fault"):
            case "lose":
                del line[at : at + data.draw(st.integers(1, 10), label="lost")]
            case "change":
                line[at] ^= data.draw(st.integers(1, 255), label="flip")
            case _:
                line[at:at] = data.draw(st.binary(min_size=1, max_size=5), label="added")
    return bytes(line)
