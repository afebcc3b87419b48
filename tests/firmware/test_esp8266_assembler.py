"""Laws of the frame assembler: order, no loss, whole frames, no old bytes, no delay."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.rosserial.frame import encode
from tests.firmware.esp8266 import Assembler

pytestmark = pytest.mark.usefixtures("esp8266_built")

frames = st.builds(encode, st.integers(0, 300), st.binary(max_size=120) | st.binary(min_size=900, max_size=1024))
noise = st.binary(max_size=60) | st.lists(st.sampled_from([0xFF, 0xFE, 0, 1, 254, 255]), max_size=30).map(bytes)
cut_frames = st.tuples(frames, st.integers(0, 1100)).map(lambda cut: cut[0][: cut[1]])
sizes = st.integers(1, 300)
pauses_ms = st.integers(0, 60)


def pieces(data: bytes, draw: st.DataObject) -> list[bytes]:
    parts = []
    while data:
        size = draw.draw(sizes)
        parts.append(data[:size])
        data = data[size:]
    return parts


def pumped(assembler: Assembler, part: bytes, limit_bytes: int, now_ms: int) -> list[bytes]:
    """Put in all of `part`, and take the ready bytes at each step."""
    writes = []
    while part:
        part = part[assembler.put(part, now_ms) :]
        assert assembler.size() <= assembler.capacity
        writes.append(assembler.pop_ready(limit_bytes, now_ms))
    return [write for write in writes if write]


@given(st.lists(frames | noise | cut_frames, max_size=8), st.data())
def test_the_same_bytes_come_out_in_the_same_order(parts: list[bytes], data: st.DataObject) -> None:
    wire = b"".join(parts)
    now_ms, out = 2**32 - 50, b""
    with Assembler() as assembler:
        for part in pieces(wire, data):
            now_ms = (now_ms + data.draw(pauses_ms)) % 2**32
            out += b"".join(pumped(assembler, part, data.draw(st.sampled_from([128, 1072, 2920])), now_ms))
            while assembler.size() > 1032:  # the port has room again
                out += assembler.pop_ready(1072, now_ms)
        now_ms = (now_ms + Assembler.QUIET_MS) % 2**32
        out += assembler.pop_ready(assembler.capacity, now_ms)
        assert assembler.size() == 0
    assert out == wire


@given(st.lists(frames, max_size=8), st.data())
def test_a_frame_is_never_cut(parts: list[bytes], data: st.DataObject) -> None:
    ends, at = {0}, 0
    for part in parts:
        at += len(part)
        ends.add(at)
    now_ms, sent = 0, 0
    with Assembler() as assembler:
        for part in pieces(b"".join(parts), data):
            for write in pumped(assembler, part, 1072, now_ms):
                sent += len(write)
                assert sent in ends
        while write := assembler.pop_ready(1072, now_ms):
            sent += len(write)
            assert sent in ends
    assert sent == at


@given(frames | noise | cut_frames, frames, st.integers(1, 1100), st.lists(frames, max_size=4), st.data())
def test_assembler_after_a_restart_sends_no_earlier_byte(
    before: bytes, cut: bytes, cut_at: int, after: list[bytes], data: st.DataObject
) -> None:
    """First the rest of a frame whose start was lost: it is dropped too, up to the next header."""
    rest = cut[min(cut_at, len(cut) - 1) :].replace(b"\xff", b"\xfa")
    wire = b"".join(after)
    out = b""
    with Assembler() as assembler:
        assembler.put(before, 0)
        assembler.restart(100)
        for part in pieces(rest + wire, data):
            out += b"".join(pumped(assembler, part, 1072, 101))
        while ready := assembler.pop_ready(1072, 101):
            out += ready
        assert assembler.size() <= 4 or not wire
    assert out in (wire, rest[1024:] + wire)
