"""Order and timing of sent frames."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.outbox import LOOP_S, MAX_REPLIES, RING_BYTES, VELOCITY_BYTES, ControlFrames, Outbox
from hostlink.core.protocol.rosserial.frame import STOP_REQUEST, TOPICS_REQUEST, encode
from hostlink.core.protocol.rosserial.session import CONTROL_FRAMES
from hostlink.errors import DeviceBusy

TIME = encode(10, bytes.fromhex("01000000 02000000"))
CONTROL_BYTES = len(TIME) + len(TOPICS_REQUEST)  # the most that is sent ahead of a velocity
WALL_NS = 1_000_000_002


def drain(outbox: Outbox) -> list[bytes]:
    popped = []
    while (one := outbox.pop_frame(now_s=0.0, wall_ns=WALL_NS)) is not None:
        popped.append(one.frame)
    return popped


def test_queued_frames_leave_in_order_of_priority() -> None:
    outbox = Outbox(CONTROL_FRAMES)
    outbox.put_command(100, b"command")
    outbox.put_reply("p", b"reply 1")
    outbox.put_reply("p", b"reply 2")
    outbox.put_urgent(101, b"velocity")
    outbox.put_topics_request()
    outbox.put_time()
    assert drain(outbox) == [TIME, TOPICS_REQUEST, b"velocity", b"reply 1", b"reply 2", b"command"]
    assert outbox.wait_s(0.0) is None


def test_a_queued_velocity_is_told_from_other_frames() -> None:
    outbox = Outbox(CONTROL_FRAMES)
    outbox.put_command(100, b"command")
    outbox.put_time()
    assert not outbox.has_urgent
    outbox.put_urgent(101, b"velocity")
    assert outbox.has_urgent
    drain(outbox)
    assert not outbox.has_urgent


def test_queued_command_is_replaced_by_a_newer_one_of_its_topic() -> None:
    outbox = Outbox(CONTROL_FRAMES)
    for text in (b"old", b"new"):
        outbox.put_urgent(101, text + b" velocity")
        outbox.put_command(100, text + b" command")
    assert drain(outbox) == [b"new velocity", b"new command"]
    assert outbox.replaced == 2


def test_first_zero_of_a_session_is_not_replaced_by_newer_velocities() -> None:
    outbox = Outbox(CONTROL_FRAMES)
    outbox.put_urgent(101, b"zero", is_kept=True)
    for number in range(3):
        outbox.put_urgent(101, b"velocity %d" % number)
    assert drain(outbox) == [b"zero", b"velocity 2"]
    assert outbox.replaced == 2
    outbox.put_urgent(101, b"first", is_kept=True)
    outbox.put_urgent(101, b"again", is_kept=True)
    assert drain(outbox) == [b"first", b"again"]
    outbox.put_urgent(101, b"a")
    outbox.put_urgent(101, b"b")
    assert drain(outbox) == [b"b"]


def test_topic_with_depth_keeps_its_newest_in_order_and_topics_alternate() -> None:
    outbox = Outbox(CONTROL_FRAMES)
    for number in range(4):
        outbox.put_command(100, b"a%d" % number, depth=2)
    outbox.put_command(101, b"b")
    assert drain(outbox) == [b"a2", b"b", b"a3"]
    assert outbox.replaced == 2


def test_replies_above_the_bound_are_refused_and_queued_ones_kept() -> None:
    outbox = Outbox(CONTROL_FRAMES)
    for number in range(MAX_REPLIES):
        outbox.put_reply("p", b"%d" % number)
    with pytest.raises(DeviceBusy, match="p: 32 requests wait already"):
        outbox.put_reply("p", b"one more")
    assert len(drain(outbox)) == MAX_REPLIES


def test_stop_sends_the_queued_velocity_and_nothing_else() -> None:
    outbox = Outbox(CONTROL_FRAMES)
    outbox.put_time()
    outbox.put_command(100, b"command")
    outbox.put_reply("p", b"reply")
    outbox.put_urgent(101, b"zero")
    outbox.put_stop()
    assert drain(outbox) == [b"zero", STOP_REQUEST]


def test_velocity_after_the_stop_is_ignored() -> None:
    """A velocity after the stop must not replace the queued zero."""
    outbox = Outbox(CONTROL_FRAMES)
    outbox.put_urgent(101, b"zero")
    outbox.put_stop()
    outbox.put_urgent(101, b"full speed")
    assert drain(outbox) == [b"zero", STOP_REQUEST]


def test_stop_is_the_last_frame_when_others_are_queued_after_it() -> None:
    outbox = Outbox(CONTROL_FRAMES)
    outbox.put_stop()
    assert drain(outbox) == [STOP_REQUEST]
    outbox.put_time()
    outbox.put_topics_request()
    outbox.put_urgent(101, b"velocity")
    outbox.put_reply("p", b"reply")
    outbox.put_command(100, b"command")
    assert drain(outbox) == []
    assert outbox.wait_s(0.0) is None


def test_drop_messages_keeps_lasting_replies() -> None:
    outbox = Outbox(CONTROL_FRAMES)
    outbox.put_urgent(101, encode(101, b"velocity"))
    outbox.put_command(100, encode(100, b"command"))
    outbox.put_reply("service", encode(102, b"call"))
    outbox.put_reply("p", encode(6, b"parameter"), is_lasting=True)
    outbox.drop_messages()
    assert drain(outbox) == [encode(6, b"parameter")]


def test_drop_topic_drops_velocity_and_commands_of_this_topic_alone() -> None:
    outbox = Outbox(CONTROL_FRAMES)
    for topic_id in (100, 101):
        outbox.put_urgent(topic_id, encode(topic_id, b"velocity"))
        outbox.put_command(topic_id, encode(topic_id, b"command"))
    outbox.drop_topic(101)
    outbox.drop_topic(102)
    assert drain(outbox) == [encode(100, b"velocity"), encode(100, b"command")]


@given(
    st.lists(st.tuples(st.floats(0.0, 0.2), st.integers(8, 200)), min_size=1, max_size=60),
    st.integers(960, 11520),
)
def test_paced_frames_exceed_the_uart_speed_by_one_ring_at_most(
    puts: list[tuple[float, int]], uart_bytes_s: int
) -> None:
    outbox = Outbox(CONTROL_FRAMES, uart_bytes_s=uart_bytes_s)
    now_s, sent_bytes = 0.0, 0
    for pause_s, size in puts:
        now_s += pause_s
        if (wait_s := outbox.wait_s(now_s)) is not None:
            assert wait_s <= 201 / uart_bytes_s  # a frame may be sent one byte early
        outbox.put_command(100, bytes(size))
        popped = outbox.pop_frame(now_s=now_s, wall_ns=0)
        sent_bytes += 0 if popped is None else len(popped.frame)
        assert sent_bytes <= RING_BYTES + now_s * uart_bytes_s + 200


def test_paced_frame_leaves_when_its_wait_is_over() -> None:
    outbox = Outbox(CONTROL_FRAMES, uart_bytes_s=3840)
    for number in range(4):
        outbox.put_command(100 + number, bytes(40))
    assert [outbox.pop_frame(now_s=0.0, wall_ns=0) is None for _ in range(3)] == [False, False, True]
    wait_s = outbox.wait_s(0.0)
    assert wait_s == pytest.approx((80 - (128 - 24 - 40)) / 3840)
    assert outbox.pop_frame(now_s=wait_s + 1e-9, wall_ns=0) is not None


def test_paced_frame_leaves_less_than_a_byte_too_early() -> None:
    outbox = Outbox(CONTROL_FRAMES, uart_bytes_s=11520)
    for number in range(3):
        outbox.put_command(100 + number, bytes(40))
    assert [outbox.pop_frame(now_s=0.0, wall_ns=0) is None for _ in range(3)] == [False, False, True]
    allowed_bytes = 128 - 24 - 40
    assert outbox.pop_frame(now_s=(80 - allowed_bytes - 1.1) / 11520, wall_ns=0) is None
    assert outbox.pop_frame(now_s=(80 - allowed_bytes - 0.9) / 11520, wall_ns=0) is not None


@given(st.floats(0.0, 1e6), st.integers(100, 1_000_000), st.lists(st.integers(8, 520), min_size=1, max_size=40))
def test_waiting_exactly_wait_s_yields_a_frame(now_s: float, uart_bytes_s: int, sizes: list[int]) -> None:
    """Virtual time is exact: a wait too short to move the clock would repeat for ever."""
    outbox = Outbox(CONTROL_FRAMES, uart_bytes_s=uart_bytes_s)
    for number, size in enumerate(sizes):
        outbox.put_command(100 + number, bytes(size))
    popped, waits = 0, 0
    while (wait_s := outbox.wait_s(now_s)) is not None:
        if wait_s:
            waits += 1
            assert now_s + wait_s > now_s
            now_s += wait_s
        popped += outbox.pop_frame(now_s=now_s, wall_ns=0) is not None
        assert waits <= len(sizes)
    assert popped == len(sizes)


# -- a stop is not delayed -------------------------------------------------------------------------------------------

STOP = b"S" * VELOCITY_BYTES
DRIVE = b"D" * VELOCITY_BYTES


class Line:
    """Outbox and a model of its UART, which records when each byte is sent."""

    def __init__(self, uart_bytes_s: int) -> None:
        self.outbox = Outbox(CONTROL_FRAMES, uart_bytes_s=uart_bytes_s)
        self.byte_s = 1 / uart_bytes_s
        self.now_s = 0.0
        self.free_at_s = 0.0
        self.begun_at_s: dict[bytes, float] = {}  # start time of the newest frame with these bytes

    def drain(self, until_s: float) -> None:
        """Send every frame that is due by then, as the link does."""
        self.outbox.begin_waiting(self.now_s)
        while True:
            wait_s = self.outbox.wait_s(self.now_s)
            if wait_s is None or self.now_s + wait_s > until_s:
                break
            self.now_s += wait_s
            popped = self.outbox.pop_frame(now_s=self.now_s, wall_ns=0)
            if popped is not None:
                self.begun_at_s[popped.frame] = max(self.now_s, self.free_at_s)
                self.free_at_s = self.begun_at_s[popped.frame] + len(popped.frame) * self.byte_s
        self.now_s = until_s

    @property
    def longest_s(self) -> float:
        return max(LOOP_S, (VELOCITY_BYTES + CONTROL_BYTES) * self.byte_s) + 3 * self.byte_s


puts = st.lists(
    st.tuples(
        st.sampled_from(["drive", "stop", "stand", "time", "ask", "command", "call"]),
        st.integers(8, 600),
        st.floats(0, 0.1),
    ),
    max_size=40,
)


@given(st.sampled_from([960, 2400, 3840, 5760, 11520, 92160]), puts)
def test_stop_is_on_the_wire_within_one_turn_behind_any_queue(
    uart_bytes_s: int, history: list[tuple[str, int, float]]
) -> None:
    line = Line(uart_bytes_s)
    stopped_at_s: float | None = None  # when a stop of a moving robot was queued; None once it was checked
    for number, (what, size, pause_s) in enumerate(history):
        is_moving = line.outbox.robot_moves and DRIVE in line.begun_at_s
        if what == "drive":
            line.outbox.put_urgent(100, DRIVE)
            line.outbox.robot_moves = True
            stopped_at_s = None
        elif what == "stop" and is_moving and stopped_at_s is None:
            line.begun_at_s.pop(STOP, None)
            line.outbox.put_urgent(100, STOP)
            stopped_at_s = line.now_s
        elif what == "stand" and STOP in line.begun_at_s and stopped_at_s is None:
            line.outbox.robot_moves = False
            line.begun_at_s.clear()
        elif what == "time":
            line.outbox.put_time()
        elif what == "ask":
            line.outbox.put_topics_request()
        elif what == "command":
            line.outbox.put_command(101 + number % 5, bytes(size), depth=16)
        elif what == "call":
            line.outbox.put_call(f"s{number}", bytes(size))
        line.drain(line.now_s + pause_s)
        if stopped_at_s is not None and line.now_s > stopped_at_s + line.longest_s:
            assert line.begun_at_s[STOP] <= stopped_at_s + line.longest_s
            stopped_at_s = None


def test_thousand_messages_do_not_delay_a_stop() -> None:
    line = Line(3840)
    line.outbox.put_urgent(100, DRIVE)
    line.outbox.robot_moves = True
    for number in range(1000):
        line.outbox.put_command(101 + number % 100, b"%056d" % number, depth=16)
    line.drain(1.0)
    line.outbox.put_urgent(100, STOP)
    line.drain(2.0)
    assert line.begun_at_s[STOP] - 1.0 <= LOOP_S
    assert len(line.begun_at_s) > 100  # the other messages were still sent


def test_large_message_waits_while_the_robot_moves() -> None:
    line = Line(3840)
    large, small = b"L" * 500, b"s" * 20
    line.outbox.put_command(101, large)
    line.outbox.put_call("service", large + b"2")
    line.outbox.put_urgent(100, DRIVE)
    line.outbox.robot_moves = True
    line.outbox.put_command(102, small)
    line.drain(5.0)
    assert set(line.begun_at_s) == {DRIVE, small}
    assert line.outbox.wait_s(5.0) is None
    assert line.outbox.oldest_s(5.0) == pytest.approx(5.0)
    line.outbox.put_urgent(100, STOP)
    line.drain(5.2)
    line.outbox.robot_moves = False
    line.drain(6.0)
    assert {large, large + b"2"} <= set(line.begun_at_s)
    assert line.outbox.oldest_s(6.0) == 0.0
    assert line.outbox.slowest_wait_s > 5.0


def test_answer_to_a_blocked_device_does_not_wait() -> None:
    line = Line(3840)
    line.outbox.robot_moves = True
    line.outbox.put_reply("parameter", b"P" * 300)
    line.drain(0.5)
    assert b"P" * 300 in line.begun_at_s


def test_uart_of_unknown_speed_is_never_busy() -> None:
    outbox = Outbox(CONTROL_FRAMES)
    outbox.robot_moves = True
    outbox.put_command(100, bytes(10_000))
    outbox.put_command(101, bytes(10_000))
    assert len(drain(outbox)) == 2


def test_oldest_age_ignores_replaced_frames() -> None:
    outbox = Outbox(CONTROL_FRAMES, uart_bytes_s=960)
    assert outbox.oldest_s(0.0) == 0.0
    outbox.put_command(100, bytes(100))
    outbox.put_command(101, bytes(100))
    outbox.begin_waiting(1.0)
    assert outbox.pop_frame(now_s=1.0, wall_ns=0) is not None
    outbox.put_command(101, bytes(90))  # replaces the queued one
    outbox.begin_waiting(1.05)
    assert outbox.oldest_s(1.1) == pytest.approx(0.05)
    assert outbox.slowest_wait_s == 0.0


@pytest.mark.parametrize(
    ("uart_bytes_s", "longest"), [(960, 56), (2160, 56), (3000, 76), (3840, 104), (11520, 104), (None, float("inf"))]
)
def test_while_the_robot_moves_a_frame_leaves_only_if_a_stop_behind_it_is_on_the_wire_in_one_turn(
    uart_bytes_s: int | None, longest: float
) -> None:
    """The limit is one turn's bytes minus a stop, at most the receive ring and at least one velocity."""
    assert Outbox(CONTROL_FRAMES, uart_bytes_s=uart_bytes_s).prompt_bytes == pytest.approx(longest)


def test_outbox_without_a_pace_never_waits_and_a_stop_waits_for_the_line() -> None:
    outbox = Outbox(CONTROL_FRAMES)
    outbox.put_command(100, b"command")
    assert outbox.wait_s(0.0) == 0.0
    stopping = Outbox(CONTROL_FRAMES, uart_bytes_s=3840)
    stopping.put_stop()
    assert stopping.wait_s(0.0) == 0.0
    assert stopping.pop_frame(now_s=0.0, wall_ns=0) is not None


def test_answers_of_the_protocol_leave_after_velocities_and_before_replies_the_newest_of_a_key() -> None:
    outbox = Outbox(CONTROL_FRAMES)
    outbox.put_command(100, b"command")
    outbox.put_reply("p", b"reply")
    for number in range(3):
        outbox.put_answer("status", b"status %d" % number, depth=2)
        outbox.put_answer("acknowledgement", b"acknowledgement %d" % number, depth=1)
    outbox.put_urgent(101, b"velocity")
    assert outbox.has_waiting
    assert drain(outbox) == [
        b"velocity", b"status 1", b"acknowledgement 2", b"status 2", b"reply", b"command",
    ]  # fmt: skip
    assert not outbox.has_waiting
    assert outbox.replaced == 0


def test_answers_stay_when_messages_are_dropped_and_are_not_sent_after_a_stop() -> None:
    outbox = Outbox(CONTROL_FRAMES)
    outbox.put_answer("status", b"status", depth=1)
    outbox.put_command(100, b"command")
    outbox.drop_messages()
    assert drain(outbox) == [b"status"]
    outbox.put_answer("status", b"status", depth=1)
    outbox.put_stop()
    assert drain(outbox) == [STOP_REQUEST]


def test_frame_is_encoded_when_it_is_sent_and_paced_by_its_encoded_length() -> None:
    count = 0

    def encoded(frame: bytes) -> bytes:
        nonlocal count
        count += 1
        return frame + b" as %d" % count

    outbox = Outbox(CONTROL_FRAMES, uart_bytes_s=1000, encode=encoded)
    outbox.put_command(100, b"first")
    outbox.put_command(101, bytes(100))
    outbox.put_urgent(102, b"velocity")
    assert outbox.pop_frame(now_s=0.0, wall_ns=0) == (b"velocity as 1", 0.0)
    assert outbox.pop_frame(now_s=10.0, wall_ns=0) == (b"first as 2", None)
    assert outbox.pop_frame(now_s=20.0, wall_ns=0) == (bytes(100) + b" as 3", None)
    outbox.put_urgent(102, b"velocity")
    assert outbox.wait_s(20.0) == pytest.approx((105 - (1000 * LOOP_S - 8)) / 1000, abs=0.001)


def test_protocol_without_a_stop_request_sends_none() -> None:
    outbox = Outbox(ControlFrames(lambda _: b"", b"", b""))
    outbox.put_urgent(101, b"velocity")
    outbox.put_stop()
    assert drain(outbox) == [b"velocity"]
    assert not outbox.has_waiting
