"""The guardian's frames as devices of every kind read them, with the daemon's last frame cut anywhere."""

import itertools
import math
from collections import deque

import pytest

from hostlink.guardian.frames import stop_sequence
from hostlink.protocol.frame import encode
from tests.support.ros_lib_reader import RosLibReader

LIMIT_S = 0.2
BUFFER_BYTES = 512
VELOCITY = encode(100, bytes(range(1, 49)))
LONG = encode(101, bytes(value % 251 for value in range(BUFFER_BYTES - 8)))


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
        device.run([(-0.001, VELOCITY + whole[:cut]), *stop_sequence((100,), BUFFER_BYTES)], first_s=0.0, turn_s=turn_s)
        assert device.zero_at_s() <= LIMIT_S, cut


@pytest.mark.slow
@pytest.mark.parametrize("gives_up", [True, False])
@pytest.mark.parametrize("busy_until_s", [0.0, 0.03, 0.049, 0.07, 0.085, 0.099, 0.12, 0.149, 0.16])
def test_busy_device_that_reads_everything_at_once_stops(busy_until_s: float, *, gives_up: bool) -> None:
    for cut in range(1, len(LONG)):
        device = Device(gives_up=gives_up)
        arrivals = [(-0.001, VELOCITY + LONG[:cut]), *stop_sequence((100,), BUFFER_BYTES)]
        device.run(arrivals, first_s=busy_until_s, turn_s=0.005)
        assert device.zero_at_s() <= LIMIT_S, cut


@pytest.mark.parametrize("gives_up", [True, False])
def test_zero_over_a_38400_baud_line_arrives_in_time(*, gives_up: bool) -> None:
    """Behind a radio bridge the daemon's bytes have passed, and the rest arrives byte by byte."""
    byte_s = 1 / 3840
    for cut in range(1, len(LONG), 7):
        arrivals, free_at_s = [(-0.001, VELOCITY + LONG[:cut])], 0.0
        for due_s, part in stop_sequence((100,), BUFFER_BYTES):
            for value in part:
                free_at_s = max(free_at_s, due_s) + byte_s
                arrivals.append((free_at_s, bytes([value])))
        device = Device(gives_up=gives_up)
        device.run(arrivals, first_s=0.0, turn_s=0.002)
        assert device.zero_at_s() <= LIMIT_S, cut


@pytest.mark.parametrize("topic_id", [100, 255, 256, 511])
def test_zero_after_a_frame_that_is_never_given_up_is_obeyed(topic_id: int) -> None:
    """The cases include ids and checksums of FF, which a device between frames takes for a sync."""
    for cut in range(1, len(LONG)):
        observed: dict[int, bytes] = {}
        reader = RosLibReader(observed.__setitem__, gives_up=False)
        reader.turn(LONG[:cut], 0.0)
        reader.turn(stop_sequence((topic_id,), BUFFER_BYTES)[0][1], 0.0)
        assert observed.get(topic_id) == bytes(48), cut


@pytest.mark.parametrize("topic_ids", [(100, 107), (255, 511, 256), tuple(range(100, 116))])
def test_every_topic_is_zeroed_after_a_frame_that_is_never_given_up(topic_ids: tuple[int, ...]) -> None:
    for cut in range(1, len(LONG)):
        observed: dict[int, bytes] = {}
        reader = RosLibReader(observed.__setitem__, gives_up=False)
        reader.turn(LONG[:cut], 0.0)
        reader.turn(stop_sequence(topic_ids, BUFFER_BYTES)[0][1], 0.0)
        assert {each: observed.get(each) for each in topic_ids} == dict.fromkeys(topic_ids, bytes(48)), cut


def test_zeros_without_repetition_are_lost_in_a_long_claim() -> None:
    device = Device(gives_up=False)
    device.run([(-0.001, VELOCITY + LONG[:10]), *stop_sequence((100,), 0)], first_s=0.0, turn_s=0.001)
    assert device.zero_at_s() == math.inf
