"""Rings: the newest messages of each robot, within time and memory, and after the end of the process."""

import itertools
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.recorder.channel import EVENTS, LOG, Channel
from hostlink.components.recorder.ring import (
    BLOCK_BYTES,
    HEADER_BYTES,
    MAX_MESSAGES,
    Entry,
    RingMemory,
    Rings,
    read_blocks,
    read_entries,
)

SECOND_NS = 1_000_000_000
KEEP_S = 10.0


def rings_of(blocks: int, *, keep_s: float = KEEP_S) -> Rings:
    return Rings(RingMemory(blocks * BLOCK_BYTES), keep_s=keep_s)


def entry(at_s: float, size_bytes: int = 0, channel: Channel = EVENTS) -> Entry:
    return Entry(channel, int(at_s * SECOND_NS), bytes(size_bytes), at_s)


def kept_of(rings: Rings, robot: str) -> list[Entry]:
    return list(itertools.chain(*rings.copies(robot)))


def left_of(rings: Rings, memory: bytes | None = None) -> dict[str, list[Entry]]:
    """Return the entries that another process reads from the memory."""
    schemas = rings._memory.schemas()
    blocks = read_blocks(rings._memory.bytes[:] if memory is None else memory)
    return {robot: list(read_entries(found, schemas)) for robot, found in blocks.items()}


def test_ring_drops_what_is_older_than_the_time() -> None:
    rings = rings_of(16)
    for second in range(30):
        rings.add("robot_0", *entry(second))
    assert [each.stamp_ns // SECOND_NS for each in kept_of(rings, "robot_0")] == list(range(19, 30))
    assert rings.dropped == 0


def test_ring_copies_include_messages_without_a_robot_and_exclude_other_robots() -> None:
    rings = rings_of(16)
    for robot in ("robot_0", "robot_1", ""):
        rings.add(robot, *entry(1.0, len(robot)))
    assert [len(each.payload) for each in kept_of(rings, "robot_0")] == [7, 0]
    assert [len(each.payload) for each in kept_of(rings, "")] == [0]
    rings.forget("robot_0")
    assert [len(each.payload) for each in kept_of(rings, "robot_0")] == [0]


def test_flooding_robot_leaves_the_other_rings_their_share() -> None:
    rings = rings_of(16)
    for number in range(1000):
        rings.add("quiet", *entry(number / 1000, 100))
    for number in range(10_000):
        rings.add("loud", *entry(1 + number / 10_000, 100))
    assert len(kept_of(rings, "quiet")) == 1000
    kept = len(kept_of(rings, "loud"))
    assert 7 * BLOCK_BYTES < kept * (100 + HEADER_BYTES) <= 8 * BLOCK_BYTES
    assert rings.dropped == 10_000 - kept


channels = st.sampled_from((EVENTS, LOG))
robots = st.sampled_from(("a", "b", ""))
additions = st.lists(st.tuples(robots, st.floats(0, 9), st.integers(0, 40_000), channels), max_size=60)


@given(additions, st.integers(4, 12))
def test_rings_keep_the_newest_of_each_robot_in_order_within_the_room(
    drawn: list[tuple[str, float, int, Channel]], blocks: int
) -> None:
    """A later reader of the memory finds the same."""
    rings, added = rings_of(blocks), dict[str, list[Entry]]()
    for robot, at_s, size_bytes, channel in sorted(drawn, key=lambda each: each[1]):
        newest = Entry(channel, int(at_s * SECOND_NS), random.Random(size_bytes).randbytes(size_bytes), at_s)
        rings.add(robot, *newest)
        room = blocks // (len(added) + (robot not in added))
        kept = list(rings.copies(robot)[-1] if robot == "" else rings.copies(robot)[0])
        added.setdefault(robot, [])
        if size_bytes <= (room - 1) * BLOCK_BYTES - 4096:
            assert kept[-1] == newest
        if kept[-1:] == [newest]:
            added[robot].append(newest)
        assert kept == added[robot][len(added[robot]) - len(kept) :]
        assert rings.size_bytes <= blocks * BLOCK_BYTES
    left = left_of(rings)
    for robot, entries in added.items():
        copies = rings.copies(robot)
        has_own = len(copies) > (robot != "") * len(rings.copies(""))  # else its only message was too large
        kept = list(copies[0]) if has_own else []
        assert left.get(robot, []) == kept
        assert kept == entries[len(entries) - len(kept) :]


@pytest.mark.parametrize("jump_s", [-1000, 1000])
def test_ring_ignores_steps_of_the_wall_clock(jump_s: int) -> None:
    rings = rings_of(16)
    stamps_s = [2000 + second + (second >= 15) * jump_s for second in range(20)]
    for second, stamp_s in enumerate(stamps_s):
        rings.add("robot_0", *Entry(EVENTS, stamp_s * SECOND_NS, b"", second))
    assert [each.stamp_ns // SECOND_NS for each in kept_of(rings, "robot_0")] == stamps_s[9:]


def test_ring_drops_a_message_that_is_larger_than_the_room_and_nothing_else() -> None:
    rings = rings_of(4)
    rings.add("robot_0", *entry(1.0, 100))
    rings.add("robot_0", *entry(2.0, 4 * BLOCK_BYTES))
    assert [len(each.payload) for each in kept_of(rings, "robot_0")] == [100]
    assert rings.dropped == 1


def test_ring_drops_a_message_of_a_channel_whose_definition_fits_no_block() -> None:
    rings = rings_of(8)
    rings.add("robot_0", *entry(1.0, 100))
    rings.add("robot_0", *entry(2.0, 0, Channel("/" + BLOCK_BYTES * "x", "ros1", "", "")))
    assert rings.dropped == 1
    rings.add("robot_0", *entry(3.0, 100))
    assert [each.at_s for each in kept_of(rings, "robot_0")] == [1.0, 3.0]


def test_rings_of_more_robots_than_blocks_keep_the_newest() -> None:
    rings = rings_of(4)
    for number in range(40):
        rings.add(f"robot_{number}", *entry(number / 100, 100))
    assert [len(kept_of(rings, f"robot_{number}")) for number in range(40)] == [0] * 36 + [1] * 4


@pytest.mark.slow
def test_messages_of_a_ring_are_bounded() -> None:
    rings = Rings(RingMemory(2 * MAX_MESSAGES * HEADER_BYTES), keep_s=KEEP_S)
    for number in range(MAX_MESSAGES + 5000):
        rings.add("robot_0", *entry(number / 1e6))
    assert MAX_MESSAGES - 1000 < len(kept_of(rings, "robot_0")) <= MAX_MESSAGES + 1000


def test_ring_copy_is_not_changed_by_later_messages() -> None:
    rings = rings_of(4)
    rings.add("robot_0", *entry(1.0))
    (copy,) = rings.copies("robot_0")
    rings.add("robot_0", *entry(2.0))
    assert list(copy) == [entry(1.0)]


def test_unused_rings_leave_their_room_to_the_others() -> None:
    """A name may be that of a topic, or of a robot that was removed just before its last line."""
    rings = rings_of(10)
    for number in range(100):
        rings.add(f"name {number}", *entry(number / 100, 100))
    for number in range(1000):
        rings.add("robot_0", *entry(30 + number / 1000, 100))
    assert len(kept_of(rings, "robot_0")) == 1000


def test_ring_uses_blocks_again_before_it_needs_more() -> None:
    """Memory that was never needed is not allocated."""
    rings = rings_of(1000)
    for number in range(100_000):
        rings.add("robot_0", *entry(number / 100, 100))
    assert rings._taken * BLOCK_BYTES < 3 * KEEP_S * 100 * (100 + HEADER_BYTES)


@given(st.integers(0, 3 * BLOCK_BYTES), st.binary(min_size=1, max_size=64))
def test_damaged_bytes_lose_only_the_rest_of_their_block(place: int, damage: bytes) -> None:
    rings = rings_of(4)
    added = [Entry(EVENTS, number, number.to_bytes(4, "little") * 50, number / 1000) for number in range(200)]
    for each in added:
        rings.add("robot_0", *each)
    before = left_of(rings)["robot_0"]
    memory = bytearray(rings._memory.bytes[:])
    memory[place : place + len(damage)] = damage
    after = left_of(rings, bytes(memory)).get("robot_0", [])
    blocks_hit = {place // BLOCK_BYTES, (place + len(damage) - 1) // BLOCK_BYTES}
    lost = [each for each in before if each not in after]
    assert len(lost) <= len(blocks_hit) * BLOCK_BYTES // (200 + HEADER_BYTES)


def test_ring_memory_cut_within_a_message_has_all_the_others() -> None:
    """A killed process leaves a message in part, because its bytes are written in order."""
    rings = rings_of(4)
    for number in range(3):
        rings.add("robot_0", *entry(number, 20))
    (kept,) = rings._rings.values()
    begin = kept.end
    rings.add("robot_0", *Entry(EVENTS, 7, b"\xff" * 20, 7.0))
    for cut in range(begin, kept.end):
        memory = bytearray(rings._memory.bytes[:])
        memory[cut : kept.end] = bytes(kept.end - cut)
        assert [each.at_s for each in left_of(rings, bytes(memory))["robot_0"]] == [0.0, 1.0, 2.0]
