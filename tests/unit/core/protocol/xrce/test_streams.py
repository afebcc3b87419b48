"""Streams: order, loss, acknowledgements, fragments, numbers that do not fit."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.xrce.streams import (
    ASKED_MAX,
    GIVEN_UP_S,
    HELD_BYTES_MAX,
    HISTORY,
    LATE_S,
    MESSAGE_BYTES_MAX,
    REPEATS,
    WINDOW,
    BestEffortInput,
    FragmentBuffer,
    ReliableInput,
    ReliableOutput,
)
from hostlink.core.protocol.xrce.wire import LAST_FRAGMENT, LITTLE, NUMBERS, RELIABLE, Kind, Range, number_after


def body(number: int) -> bytes:
    return b"%d" % number


def fed(stream: ReliableInput, *numbers: int) -> list[int]:
    return [int(each) for number in numbers for each in stream.receive(number % NUMBERS, body(number % NUMBERS))]


# -- from the client --------------------------------------------------------------------------------------------------


def test_best_effort_counts_gaps_and_drops_what_is_late() -> None:
    stream = BestEffortInput()
    assert [stream.lost_before(number) for number in (0, 1, 4, 3, 4, 5)] == [0, 0, 2, -1, -1, 0]


def test_best_effort_of_a_resumed_client_begins_anywhere() -> None:
    stream = BestEffortInput(is_resumed=True)
    assert [stream.lost_before(number) for number in (700, 702)] == [0, 1]


def test_reliable_messages_are_delivered_once_and_in_order() -> None:
    stream = ReliableInput(RELIABLE)
    assert fed(stream, 0, 2, 3, 2) == [0]
    assert (stream.next, stream.missing(), stream.duplicates) == (1, 0b001, 1)
    assert fed(stream, 1) == [1, 2, 3]
    assert fed(stream, 1) == []
    assert (stream.next, stream.missing(), stream.duplicates) == (4, 0, 2)


@given(st.permutations(range(WINDOW)), st.integers(0, NUMBERS - 1))
def test_any_order_within_the_window_gives_the_messages_in_order(order: list[int], start: int) -> None:
    stream = ReliableInput(RELIABLE)
    stream.next = start
    stream._announced = (start - 1) % NUMBERS
    expected = [number_after(start, ahead) for ahead in range(WINDOW)]
    assert fed(stream, *(start + ahead for ahead in order)) == expected


def test_heartbeat_tells_what_is_missing_at_the_end() -> None:
    stream = ReliableInput(RELIABLE)
    assert stream.heartbeat(0, 1) == []
    assert (stream.next, stream.missing()) == (0, 0b11)
    fed(stream, 0, 1)
    assert stream.heartbeat(0, 1) == []
    assert stream.missing() == 0


def test_far_number_moves_a_stream_only_when_others_confirm_it() -> None:
    stream = ReliableInput(RELIABLE)
    fed(stream, 0)
    assert fed(stream, 500) == []
    assert not stream.fits
    assert fed(stream, 1) == [1]
    assert stream.fits
    assert fed(stream, *[600] * (REPEATS - 1)) == []
    assert fed(stream, 601) == [601]
    assert (stream.next, stream.fits, stream.skipped) == (602, True, 599)


def test_far_numbers_that_do_not_fit_each_other_confirm_nothing() -> None:
    stream = ReliableInput(RELIABLE)
    assert fed(stream, 500, 1500, 2500, 3500, 4500) == []
    assert stream.next == 0


def test_far_heartbeats_move_a_stream_and_release_what_is_held() -> None:
    stream = ReliableInput(RELIABLE)
    fed(stream, 0, 5, 6)
    found = [stream.heartbeat(5, 6) for _ in range(REPEATS)]
    assert found == [[]] * (REPEATS - 1) + [[body(5), body(6)]]
    assert (stream.next, stream.fits) == (7, True)


def test_message_that_the_client_announces_and_never_sends_is_given_up() -> None:
    stream = ReliableInput(RELIABLE)
    fed(stream, 0, 2)
    assert [stream.note_asked(number * 0.01) for number in range(ASKED_MAX + 1)] == [True] * ASKED_MAX + [False]
    assert stream.give_up(GIVEN_UP_S - 0.01) == []
    assert stream.give_up(GIVEN_UP_S) == [body(2)]
    assert stream.give_up(GIVEN_UP_S) == []
    assert (stream.next, stream.skipped) == (3, 1)


def test_message_that_is_not_missing_is_not_given_up() -> None:
    stream = ReliableInput(RELIABLE)
    for _ in range(ASKED_MAX + 1):
        stream.note_asked(0.0)
    assert stream.give_up(GIVEN_UP_S) == []


def test_resumed_stream_begins_with_the_first_number_that_arrives() -> None:
    by_message, by_heartbeat = ReliableInput(RELIABLE, is_resumed=True), ReliableInput(RELIABLE, is_resumed=True)
    assert not by_message.fits
    assert fed(by_message, 700, 701) == [700, 701]
    by_heartbeat.heartbeat(800, 801)
    assert (by_heartbeat.next, by_heartbeat.missing(), by_heartbeat.fits) == (800, 0b11, True)
    assert by_message.fragments.add(b"rest of a message", is_last=True) is None


def test_messages_that_wait_are_bounded_in_bytes() -> None:
    stream = ReliableInput(RELIABLE)
    stream.receive(1, bytes(HELD_BYTES_MAX))
    assert stream.receive(2, b"x") == []
    assert stream.missing() == 0b101
    assert [len(each) for each in stream.receive(0, b"")] == [0, HELD_BYTES_MAX]
    assert stream.receive(3, b"x") == []


def test_fragments_are_joined() -> None:
    fragments = FragmentBuffer()
    assert [fragments.add(each, is_last=each == b"c") for each in (b"a", b"b", b"c")] == [None, None, b"abc"]
    assert fragments.add(b"d", is_last=True) == b"d"


def test_fragments_of_a_message_that_is_too_long_are_dropped() -> None:
    fragments = FragmentBuffer()
    assert fragments.add(bytes(MESSAGE_BYTES_MAX), is_last=False) is None
    assert fragments.add(b"x", is_last=False) is None
    assert fragments.add(b"x", is_last=True) is None
    assert fragments.dropped == 1
    assert fragments.add(b"next", is_last=True) == b"next"


def test_skipped_message_ends_where_another_one_begins() -> None:
    fragments = FragmentBuffer()
    fragments.skip_message()
    fragments.end_skipping()
    assert fragments.add(b"whole", is_last=True) == b"whole"


# -- to the client ----------------------------------------------------------------------------------------------------


def ack(first: int, missing: int = 0) -> Range:
    return Range(first % NUMBERS, missing, RELIABLE)


def test_messages_wait_for_room_in_the_history_of_the_client() -> None:
    stream = ReliableOutput()
    numbers = []
    while stream.has_room:
        numbers.append(stream.put(b"x", 1.0))
    assert numbers == list(range(HISTORY))
    assert stream.acknowledge(ack(1), 1.5, older_than_s=0.1) == []
    assert stream.has_room
    assert stream.is_waiting


def test_missing_message_is_sent_again_when_its_last_sending_is_older_than_a_round_trip() -> None:
    stream = ReliableOutput()
    for each in (b"a", b"b", b"c"):
        stream.put(each, 1.0)
    assert stream.acknowledge(ack(0, 0b101), 1.05, older_than_s=0.1) == []
    assert stream.acknowledge(ack(0, 0b101), 1.2, older_than_s=0.1) == [(0, b"a"), (2, b"c")]
    assert stream.acknowledge(ack(0, 0b101), 1.25, older_than_s=0.1) == []
    assert stream.resent == 2
    assert stream.acknowledge(ack(3), 1.3, older_than_s=0.1) == []
    assert not stream.is_waiting


def tried(count: int) -> ReliableOutput:
    stream = ReliableOutput()
    stream.begin_trial([b"%d" % number for number in range(count)])
    return stream


def test_last_fragment_of_a_long_message_tries_the_history_of_the_client() -> None:
    stream = tried(6)
    assert (stream.trial(), stream.has_room, stream.is_waiting) == ((5, b"5"), False, True)
    assert stream.acknowledge(ack(0), 1.0, older_than_s=0.1) == []  # it has not arrived yet
    assert stream.trial() is not None
    stream.acknowledge(ack(0, 0b011111), 1.0, older_than_s=0.1)
    assert (len(stream.passed), stream.window, stream.trial(), stream.has_room) == (6, 6, None, True)


def test_message_that_the_history_of_the_client_does_not_hold_is_refused_and_its_numbers_are_free() -> None:
    stream = tried(6)
    stream.acknowledge(ack(0, 0b111111), 1.0, older_than_s=0.1)
    assert (stream.passed, stream.window, stream.limit, stream.refused) == ([], HISTORY, 5, 1)
    assert (stream.trial(), stream.put(b"next", 1.0)) == (None, 0)


def test_heartbeat_begins_at_a_message_of_which_the_client_keeps_only_some_fragments() -> None:
    part, last = bytes((Kind.FRAGMENT, LITTLE, 1, 0, 1)), bytes((Kind.FRAGMENT, LITTLE | LAST_FRAGMENT, 1, 0, 1))
    output = ReliableOutput()
    announced = []
    for each in (b"whole", part, part, last):
        output.put(each, 0.0)
    for first in (1, 2, 3, 4):
        output.acknowledge(Range(first, 0, RELIABLE), 0.0, older_than_s=0.0)
        announced.append((output.first, output.announced))
    assert announced == [(1, 1), (2, 1), (3, 1), (4, 4)]


def test_late_answer_to_a_longer_trial_decides_no_shorter_one() -> None:
    stream = tried(6)
    stream.acknowledge(ack(0, 0b111111), 1.0, older_than_s=0.1)
    stream.begin_trial([b"1", b"2"], 1.0)
    stream.acknowledge(ack(0, 0b111111), 1.1, older_than_s=0.1)  # of before the trial
    assert stream.trial() == (1, b"2")
    stream.acknowledge(ack(0, 0b111101), 1.0 + LATE_S, older_than_s=0.1)
    assert (stream.passed, stream.proven, stream.limit) == ([b"1", b"2"], 2, 5)


def test_trial_that_is_not_answered_shows_no_limit() -> None:
    output = ReliableOutput()
    output.begin_trial([b"1", b"2"])
    output.end_trial(is_kept=False, is_told=False)
    assert (output.refused, output.limit, output.trial()) == (1, WINDOW, None)


def test_trial_ends_when_the_stream_moves() -> None:
    stream = tried(6)
    for number in range(REPEATS):
        stream.acknowledge(ack(900), 1.0 + number, older_than_s=0.1)
    assert (stream.trial(), stream.first) == (None, 900)


@pytest.mark.parametrize("first", [900, -5])
def test_number_that_does_not_fit_moves_the_stream_when_it_is_repeated(first: int) -> None:
    stream = ReliableOutput()
    stream.put(b"a", 0.0)
    for number in range(REPEATS - 1):
        assert stream.acknowledge(ack(first), 1.0 + number, older_than_s=0.1) == []
    assert stream.acknowledge(ack(first), float(REPEATS), older_than_s=0.1) == [(first % NUMBERS, b"a")]
    assert (stream.first, stream.next) == (first % NUMBERS, (first + 1) % NUMBERS)


def test_late_acknowledgements_that_a_newer_one_has_overtaken_move_nothing() -> None:
    stream = ReliableOutput()
    for _ in range(3):
        stream.put(b"a", 0.0)
    stream.acknowledge(ack(3), 1.0, older_than_s=0.1)
    stream.put(b"b", 1.0)
    for _ in range(3 * REPEATS):
        assert stream.acknowledge(ack(1), 1.0 + LATE_S / 2, older_than_s=0.1) == []
    assert (stream.first, stream.next) == (3, 4)


def test_numbers_that_differ_move_nothing() -> None:
    stream = ReliableOutput()
    for first in (900, 901, 902, 900, 901, 902):
        stream.acknowledge(ack(first), 1.0, older_than_s=0.1)
    assert stream.first == 0


def test_unknown_number_is_the_first_that_the_client_tells() -> None:
    stream = ReliableOutput(first=40, is_known=False)
    assert (stream.has_room, stream.is_waiting) == (False, True)
    stream.acknowledge(ack(44), 1.0, older_than_s=0.1)
    assert (stream.has_room, stream.is_waiting, stream.put(b"a", 1.0)) == (True, False, 44)


@given(st.lists(st.tuples(st.integers(0, NUMBERS - 1), st.integers(0, 0xFFFF)), max_size=20), st.booleans())
def test_any_acknowledgements_raise_nothing_and_keep_the_window(told: list[tuple[int, int]], is_known: bool) -> None:
    stream = ReliableOutput(is_known=is_known)
    for now_s, (first, missing) in enumerate(told):
        while stream.has_room:
            stream.put(b"x", float(now_s))
        stream.acknowledge(ack(first, missing), float(now_s), older_than_s=0.1)
        assert (stream.next - stream.first) % NUMBERS <= HISTORY


@pytest.mark.parametrize("first", [0, 5, NUMBERS - 3])
def test_numbers_right_after_a_restart_of_the_host_tell_nothing_about_the_way(first: int) -> None:
    begun = ReliableInput(RELIABLE)
    assert begun.is_judged(0)
    by_message, by_heartbeat = ReliableInput(RELIABLE, is_resumed=True), ReliableInput(RELIABLE, is_resumed=True)
    by_message.receive(first, b"")
    by_heartbeat.heartbeat(first, number_after(first, 3))
    for stream in (by_message, by_heartbeat):
        judged = [ahead for ahead in range(-20, 30) if stream.is_judged((first + ahead) % NUMBERS)]
        assert judged == [*range(-20, -WINDOW), *range(WINDOW, 30)]
