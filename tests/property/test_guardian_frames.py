"""The guardian's frames as devices of every kind read them, with the daemon's last frame cut anywhere."""

import itertools
import math
from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.guardian.frames import stop_sequence
from hostlink.core.protocol.rosserial.frame import LEAD, SYNC, encode
from tests.support.ros_lib_reader import RosLibReader
from tests.support.rosserial_stop import rosserial_stop

LIMIT_S = 0.2
BUFFER_BYTES = 512
LENGTH_BYTES = 5  # sync, length and its checksum
VELOCITY = encode(100, bytes(range(1, 49)))
LONG = encode(101, bytes(value % 251 for value in range(BUFFER_BYTES - 8)))
ZERO = encode(100, bytes(48))
SEQUENCE = stop_sequence(rosserial_stop((ZERO,), BUFFER_BYTES))


class Device:
    """Device that reads at an interval and obeys the last velocity."""

    def __init__(self, *, gives_up: bool) -> None:
        self.velocities: list[tuple[float, bytes]] = []
        self.ended = False
        self.now_s = 0.0
        self._reader = RosLibReader(self._take, gives_up=gives_up)

    def _take(self, topic_id: int, payload: bytes) -> None:
        if topic_id == 100:
            self.velocities.append((self.now_s, payload))
        self.ended = self.ended or topic_id == 11

    def run(self, arrivals: list[tuple[float, bytes]], *, first_s: float, turn_s: float) -> None:
        waiting = deque(sorted(arrivals))
        for turn in itertools.count():
            self.now_s = first_s + turn * turn_s
            data = b""
            while waiting and waiting[0][0] <= self.now_s:
                data += waiting.popleft()[1]
            self._reader.turn(data, self.now_s)
            if not waiting:
                return

    def zero_at_s(self) -> float:
        """Time of the final stop."""
        moving = [at_s for at_s, payload in self.velocities if payload != bytes(48)]
        zeros = [at_s for at_s, payload in self.velocities if payload == bytes(48)]
        return next((at_s for at_s in zeros if not moving or at_s >= moving[-1]), math.inf)


READERS = [(True, 0.001), (True, 0.033), (False, 0.001), (False, 0.033)]


@pytest.mark.slow
@pytest.mark.parametrize(("gives_up", "turn_s"), READERS)
@pytest.mark.parametrize("whole", [VELOCITY, LONG, encode(101, bytes(VELOCITY * 8)), encode(6, b"\xff" * 300)])
def test_robot_stops_after_a_frame_cut_anywhere(whole: bytes, *, gives_up: bool, turn_s: float) -> None:
    for cut in range(1, len(whole)):
        device = Device(gives_up=gives_up)
        device.run([(-0.001, VELOCITY + whole[:cut]), *SEQUENCE], first_s=0.0, turn_s=turn_s)
        assert device.zero_at_s() <= LIMIT_S, cut


@pytest.mark.slow
@pytest.mark.parametrize("gives_up", [True, False])
@pytest.mark.parametrize("busy_until_s", [0.0, 0.03, 0.049, 0.07, 0.085, 0.099, 0.12, 0.149, 0.16])
def test_busy_device_that_reads_everything_at_once_stops(busy_until_s: float, *, gives_up: bool) -> None:
    for cut in range(1, len(LONG)):
        device = Device(gives_up=gives_up)
        arrivals = [(-0.001, VELOCITY + LONG[:cut]), *SEQUENCE]
        device.run(arrivals, first_s=busy_until_s, turn_s=0.005)
        assert device.zero_at_s() <= LIMIT_S, cut


@pytest.mark.parametrize("gives_up", [True, False])
def test_zero_over_a_38400_baud_line_arrives_in_time(*, gives_up: bool) -> None:
    """Behind a radio bridge the daemon's bytes have passed, and the rest arrives byte by byte."""
    byte_s = 1 / 3840
    for cut in range(1, len(LONG), 7):
        arrivals, free_at_s = [(-0.001, VELOCITY + LONG[:cut])], 0.0
        for due_s, part in SEQUENCE:
            for value in part:
                free_at_s = max(free_at_s, due_s) + byte_s
                arrivals.append((free_at_s, bytes([value])))
        device = Device(gives_up=gives_up)
        device.run(arrivals, first_s=0.0, turn_s=0.002)
        assert device.zero_at_s() <= LIMIT_S, cut


def obeyed(cut: bytes, zeros: dict[int, bytes], claim_bytes: int) -> list[int]:
    """Return the ids in the order in which a device obeys the first zeros, if it never gives up a cut frame."""
    found: list[int] = []

    def note(topic_id: int, payload: bytes) -> None:
        if payload == zeros.get(topic_id):  # the checksum of a cut frame is right by chance in one of 256 cases
            found.append(topic_id)

    reader = RosLibReader(note, gives_up=False)
    reader.turn(cut, 0.0)
    assert found == []
    reader.turn(first_zeros(zeros, claim_bytes), 0.0)
    return found


def first_zeros(zeros: dict[int, bytes], claim_bytes: int) -> bytes:
    return stop_sequence(rosserial_stop(itertools.starmap(encode, zeros.items()), claim_bytes))[0][1]


@pytest.mark.parametrize("topic_ids", [(100,), (255,), (256,), (511,), (100, 107), (255, 511, 256), range(100, 116)])
@pytest.mark.parametrize("sizes", [(48,), (0,), (2,), (4,), (92, 48), (12, 4, 131, 0, 600)], ids=str)
def test_every_endpoint_is_zeroed_after_a_frame_that_is_never_given_up(
    topic_ids: tuple[int, ...], sizes: tuple[int, ...]
) -> None:
    """The cases include ids and checksums of FF, which a device between frames takes for a sync."""
    zeros = {each: bytes(size) for each, size in zip(topic_ids, itertools.cycle(sizes), strict=False)}
    for whole in (LONG, encode(99, bytes(2)), encode(99, bytes(255)), encode(99, bytes(258))):
        for cut in range(1, len(whole)):
            assert set(obeyed(whole[:cut], zeros, BUFFER_BYTES)) == set(topic_ids), cut


# Floats and integers that a command at rest may have, text, and bytes that look like the beginning of a frame.
_PIECES = st.one_of(
    st.sampled_from([b"\xff", b"\xfe", b"\xff\xff", b"\x00\x00\x80\x3f", b"base_link"]),
    st.binary(max_size=8),
    st.integers(0, 140).map(bytes),
)
PAYLOADS = st.lists(_PIECES, max_size=6).map(b"".join)
IDS = st.integers(100, 1023) | st.sampled_from([255, 256, 511])


def with_checksum_of_ff(topic_id: int, payload: bytes) -> bytes:
    """Extend a payload so that its frame ends with FF."""
    return payload + bytes([-(sum(topic_id.to_bytes(2, "little")) + sum(payload)) % 256])


STOPS = st.dictionaries(IDS, st.tuples(PAYLOADS, st.booleans()), min_size=1, max_size=16).map(
    lambda drawn: {each: with_checksum_of_ff(each, part) if is_ff else part for each, (part, is_ff) in drawn.items()}
)
PLAIN_STOPS = STOPS.map(
    lambda stops: {each: payload for each, payload in stops.items() if SYNC not in encode(each, payload)[1:] + b"\0"}
).filter(bool)


@given(PLAIN_STOPS, st.integers(0, 2000), st.data())
def test_any_zeros_are_obeyed_after_a_cut_frame_that_is_never_given_up(
    stops: dict[int, bytes], payload_bytes: int, data: st.DataObject
) -> None:
    """Lengths and number of the zeros and the length of the cut frame are drawn.

    The missing rest of that frame hides as many bytes, and not one zero after them.
    """
    whole = encode(99, bytes(value % 251 for value in range(payload_bytes)))
    cut = data.draw(st.integers(1, len(whole) - 1))
    found = obeyed(whole[:cut], stops, len(whole))
    assert set(found) == set(stops)
    if cut >= LENGTH_BYTES:  # before, the length is read from the 00 before the zeros
        first = first_zeros(stops, len(whole))
        sizes = itertools.cycle([len(encode(*stop)) + 1 for stop in stops.items()])
        starts = itertools.takewhile(lambda at: at < len(first), itertools.accumulate(sizes, initial=len(LEAD)))
        hidden_bytes = len(whole) - cut
        assert found == [each for each, at in zip(itertools.cycle(stops), starts, strict=False) if at >= hidden_bytes]


@given(STOPS, st.integers(0, 1500), st.booleans(), st.sampled_from([0.001, 0.005, 0.033]), st.data())
def test_any_zeros_stop_a_device_that_gives_up_a_cut_frame(
    stops: dict[int, bytes], payload_bytes: int, is_claimed: bool, turn_s: float, data: st.DataObject
) -> None:
    """Zeros that contain the beginning of another frame are drawn, too."""
    whole = encode(99, data.draw(st.binary(min_size=payload_bytes, max_size=payload_bytes)))
    cut = data.draw(st.integers(1, len(whole) - 1))
    zeros = tuple(itertools.starmap(encode, stops.items()))
    waiting = deque([(-0.001, whole[:cut]), *stop_sequence(rosserial_stop(zeros, len(whole) if is_claimed else 0))])
    found: dict[int, bytes] = {}
    reader = RosLibReader(found.__setitem__)
    for turn in range(round(LIMIT_S / turn_s)):
        arrived = b""
        while waiting and waiting[0][0] <= turn * turn_s:
            arrived += waiting.popleft()[1]
        reader.turn(arrived, turn * turn_s)
    assert {each: found.get(each) for each in stops} == stops
    assert 11 in found


@pytest.mark.parametrize("gives_up", [True, False])
def test_zeros_of_four_wheels_are_obeyed_in_time_over_a_38400_baud_line(*, gives_up: bool) -> None:
    zeros = tuple(encode(each, bytes(4)) for each in range(100, 104))
    for cut in range(1, len(LONG), 7):
        free_at_s, zeroed = 0.0, dict[int, bytes]()
        reader = RosLibReader(zeroed.__setitem__, gives_up=gives_up)
        reader.turn(LONG[:cut], 0.0)
        for due_s, part in stop_sequence(rosserial_stop(zeros, BUFFER_BYTES, b"")):
            for value in part:
                free_at_s = max(free_at_s, due_s) + 1 / 3840
                if free_at_s <= LIMIT_S:
                    reader.turn(bytes([value]), free_at_s)
        assert {each: zeroed.get(each) for each in range(100, 104)} == dict.fromkeys(range(100, 104), bytes(4)), cut


def test_zeros_without_repetition_are_lost_in_a_long_claim() -> None:
    device = Device(gives_up=False)
    device.run([(-0.001, VELOCITY + LONG[:10]), *stop_sequence(rosserial_stop((ZERO,)))], first_s=0.0, turn_s=0.001)
    assert device.zero_at_s() == math.inf
