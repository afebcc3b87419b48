"""The order in which frames leave, and when."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.errors import DeviceBusy
from hostlink.protocol.frame import STOP_REQUEST, TOPICS_REQUEST, encode
from hostlink.protocol.outbox import MAX_REPLIES, RING_BYTES, Outbox

TIME = encode(10, bytes.fromhex("01000000 02000000"))
WALL_NS = 1_000_000_002


def drain(outbox: Outbox) -> list[bytes]:
    taken = []
    while (frame := outbox.take(now_s=0.0, wall_ns=WALL_NS)) is not None:
        taken.append(frame)
    return taken


def test_the_order_of_everything() -> None:
    outbox = Outbox()
    outbox.put_command(100, b"command")
    outbox.put_reply("p", b"reply 1")
    outbox.put_reply("p", b"reply 2")
    outbox.put_urgent(101, b"velocity")
    outbox.put_topics_request()
    outbox.put_time()
    assert drain(outbox) == [TIME, TOPICS_REQUEST, b"velocity", b"reply 1", b"reply 2", b"command"]
    assert outbox.wait_s(0.0) is None


def test_the_newest_command_of_a_topic_replaces_the_one_that_waits() -> None:
    outbox = Outbox()
    for text in (b"old", b"new"):
        outbox.put_urgent(101, text + b" velocity")
        outbox.put_command(100, text + b" command")
    assert drain(outbox) == [b"new velocity", b"new command"]
    assert outbox.replaced == 2


def test_a_topic_with_depth_keeps_its_newest_in_order_and_topics_take_turns() -> None:
    outbox = Outbox()
    for number in range(4):
        outbox.put_command(100, b"a%d" % number, depth=2)
    outbox.put_command(101, b"b")
    assert drain(outbox) == [b"a2", b"b", b"a3"]
    assert outbox.replaced == 2


def test_too_many_replies_are_refused_and_those_that_wait_stay() -> None:
    outbox = Outbox()
    for number in range(MAX_REPLIES):
        outbox.put_reply("p", b"%d" % number)
    with pytest.raises(DeviceBusy, match="p: 32 requests wait already"):
        outbox.put_reply("p", b"one more")
    assert len(drain(outbox)) == MAX_REPLIES


def test_a_stop_lets_the_last_velocity_leave_and_nothing_else() -> None:
    outbox = Outbox()
    outbox.put_time()
    outbox.put_command(100, b"command")
    outbox.put_reply("p", b"reply")
    outbox.put_urgent(101, b"zero")
    outbox.put_stop()
    assert drain(outbox) == [b"zero", STOP_REQUEST]


def test_a_velocity_after_the_stop_is_too_late() -> None:
    """It must not take the place of the zero that waits."""
    outbox = Outbox()
    outbox.put_urgent(101, b"zero")
    outbox.put_stop()
    outbox.put_urgent(101, b"full speed")
    assert drain(outbox) == [b"zero", STOP_REQUEST]


def test_the_stop_is_the_last_frame_whatever_is_put_after_it() -> None:
    outbox = Outbox()
    outbox.put_stop()
    assert drain(outbox) == [STOP_REQUEST]
    outbox.put_time()
    outbox.put_topics_request()
    outbox.put_urgent(101, b"velocity")
    outbox.put_reply("p", b"reply")
    outbox.put_command(100, b"command")
    assert drain(outbox) == []
    assert outbox.wait_s(0.0) is None


def test_messages_can_be_forgotten_but_not_the_answers_about_parameters() -> None:
    outbox = Outbox()
    outbox.put_urgent(101, encode(101, b"velocity"))
    outbox.put_command(100, encode(100, b"command"))
    outbox.put_reply("service", encode(102, b"call"))
    outbox.put_reply("p", encode(6, b"parameter"))
    outbox.drop_messages()
    assert drain(outbox) == [encode(6, b"parameter")]


@given(
    st.lists(st.tuples(st.floats(0.0, 0.2), st.integers(8, 200)), min_size=1, max_size=60),
    st.integers(960, 11520),
)
def test_never_faster_than_the_uart_but_for_one_ring(puts: list[tuple[float, int]], uart_bytes_s: int) -> None:
    outbox = Outbox(uart_bytes_s=uart_bytes_s)
    now_s, sent_bytes = 0.0, 0
    for pause_s, size in puts:
        now_s += pause_s
        if (wait_s := outbox.wait_s(now_s)) is not None:
            assert wait_s <= 200 / uart_bytes_s
        outbox.put_command(100, bytes(size))
        frame = outbox.take(now_s=now_s, wall_ns=0)
        sent_bytes += 0 if frame is None else len(frame)
        assert sent_bytes <= RING_BYTES + now_s * uart_bytes_s + 200


def test_a_paced_frame_leaves_when_its_wait_is_over() -> None:
    outbox = Outbox(uart_bytes_s=1000)
    for number in range(4):
        outbox.put_command(100 + number, bytes(100))
    assert [outbox.take(now_s=0.0, wall_ns=0) is None for _ in range(3)] == [False, False, True]
    wait_s = outbox.wait_s(0.0)
    assert wait_s == pytest.approx(0.072)
    assert outbox.take(now_s=wait_s + 1e-9, wall_ns=0) is not None


@given(st.floats(0.0, 1e6), st.integers(100, 1_000_000), st.lists(st.integers(8, 520), min_size=1, max_size=40))
def test_a_clock_that_waits_exactly_as_long_as_it_is_told_gets_a_frame(
    now_s: float, uart_bytes_s: int, sizes: list[int]
) -> None:
    """Virtual time has no spare microsecond: a wait too short to move the clock would be waited for without end."""
    outbox = Outbox(uart_bytes_s=uart_bytes_s)
    for number, size in enumerate(sizes):
        outbox.put_command(100 + number, bytes(size))
    taken, waits = 0, 0
    while (wait_s := outbox.wait_s(now_s)) is not None:
        if wait_s:
            waits += 1
            assert now_s + wait_s > now_s
            now_s += wait_s
        taken += outbox.take(now_s=now_s, wall_ns=0) is not None
        assert waits <= len(sizes)
    assert taken == len(sizes)


@pytest.mark.parametrize("uart_bytes_s", [960, 3840, 11520])
def test_an_hour_at_full_load_is_as_fast_as_the_uart_and_no_faster(uart_bytes_s: int) -> None:
    outbox = Outbox(uart_bytes_s=uart_bytes_s)
    now_s, sent_bytes = 0.0, 0
    while now_s < 3600:
        outbox.put_urgent(101, bytes(512))
        if outbox.take(now_s=now_s, wall_ns=0) is not None:
            sent_bytes += 512
        outbox.put_urgent(101, bytes(512))
        now_s += outbox.wait_s(now_s) or 0.0
    assert uart_bytes_s * 3600 <= sent_bytes <= RING_BYTES + uart_bytes_s * now_s + 512
