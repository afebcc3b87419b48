"""The generator's decisions: one seed gives the same steps, and every kind of action is drawn with its bytes."""

import itertools
import random
import re
import struct

import pytest

from hostlink.core.protocol.rosserial.frame import Frame
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.protocol.xrce.protocol import MICRO_ROS_UDP
from tests.support import xrce_board as board
from tests.support.chaos import boards, frames, requests
from tests.support.chaos.names import CATALOG, HOSTILE_RAD_S, payload_of
from tests.support.chaos.plan import KINDS, PHASE_STEPS, draw_mix, draw_step
from tests.support.chaos.player import PLAY
from tests.support.chaos.stage import DEVICE, ROOM

SEEDS = range(30)
DAMAGED = {"garbage", "claims_0", "claims_80"}  # floods of which a host reads little
RIGHT = {"messages", "logs", "new_names", "parameters", "times", "wrong_topics", "requests", "unknown_ids", "host_ids"}


def test_the_same_seed_gives_the_same_steps_and_another_gives_others() -> None:
    steps = [draw_step(7, number) for number in range(12)]
    assert steps == [draw_step(7, number) for number in range(12)]
    assert steps != [draw_step(8, number) for number in range(12)]


def test_every_kind_of_action_is_played_and_is_drawn_by_some_seed() -> None:
    assert set(PLAY) == set(KINDS)
    drawn = {action.kind for seed in SEEDS for number in range(8) for action in draw_step(seed, number).actions}
    assert drawn == set(KINDS)


def test_a_phase_is_a_mix_of_a_few_kinds() -> None:
    mixes = [draw_mix(seed, 0) for seed in SEEDS]
    assert all(0 < len(mix) <= 5 for mix in mixes)
    assert len({tuple(sorted(mix)) for mix in mixes}) > len(SEEDS) / 2
    kinds = {action.kind for number in range(PHASE_STEPS) for action in draw_step(3, number).actions}
    assert kinds <= set(draw_mix(3, 0))


def test_only_the_kinds_that_are_named_are_played() -> None:
    step = draw_step(1, 0, ("idle",))
    assert {action.kind for action in step.actions} == {"idle"}


@pytest.mark.parametrize("maker", frames.FLOODS, ids=lambda maker: maker.__name__)
def test_a_flood_gives_large_blocks_without_end(maker) -> None:  # type: ignore[no-untyped-def]
    blocks = list(itertools.islice(maker(random.Random(1)), 4))
    assert len(blocks) == 4
    assert min(map(len, blocks[1:])) > 10_000
    found = [item for item in FrameStream(limit_bytes=20_000).feed(blocks[1][:8000]) if isinstance(item, Frame)]
    assert bool(found) or maker.__name__ not in RIGHT


@pytest.mark.parametrize("flood", boards.FLOODS, ids=lambda flood: flood.__name__)
def test_a_flood_of_a_board_has_messages_without_end_that_a_host_reads(flood: boards.Flood) -> None:
    client, session = board.Client(key=b"\1\2\3\4"), MICRO_ROS_UDP.session(CATALOG)
    session.open(now_s=0.0)
    for number, message in enumerate([client.creation(), *itertools.islice(flood(client, random.Random(1)), 300)]):
        session.receive(message, now_s=0.001 * number)
    assert session.counts.frames_from_device > 100 or flood.__name__ in DAMAGED


def test_a_flood_of_new_names_never_requests_one_twice() -> None:
    blocks = list(itertools.islice(frames.new_names(random.Random(1)), 3))
    names = [item.payload for block in blocks for item in FrameStream().feed(block) if isinstance(item, Frame)]
    assert len(set(names)) == len(names) == 3000


def test_no_hostile_velocity_equals_an_honest_one() -> None:
    dice = random.Random(1)
    assert all(payload_of("geometry_msgs/Twist", dice)[40:] == _packed(HOSTILE_RAD_S) for _ in range(50))
    sent = b"".join(requests.draw_operation(dice) + requests.rival_frame(dice) for _ in range(500))
    assert not re.search(rb"(\"z\"|angular\"): 0.125[,}]", sent)
    assert re.search(rb"(\"z\"|angular\"): -0.75[,}]", sent)


def _packed(value: float) -> bytes:
    return struct.pack("<d", value)


def test_requests_of_every_sort_can_be_drawn() -> None:
    dice = random.Random(1)
    for draw in (requests.draw_operation, requests.draw_broken, requests.draw_http, requests.draw_half):
        assert len({draw(dice) for _ in range(300)}) > 4


def test_hostile_devices_leave_room_for_the_honest_robot() -> None:
    """The daemon takes 256 connections of devices; a device that returns must find a place."""
    assert ROOM[DEVICE] < 250
