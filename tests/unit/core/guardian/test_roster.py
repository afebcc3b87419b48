"""GuardedLinks: the guardian gets every needed record, and no more."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.guardian import records
from hostlink.core.guardian.roster import GuardedLinks, Watched
from tests.support.rosserial_stop import rosserial_stop

STEPS = st.lists(st.tuples(st.sampled_from(["watch", "release", "close", "tell", "forget"]), st.integers(1, 4)))


class Guardian:
    """Model of a guardian's connections after each record."""

    def __init__(self, roster: GuardedLinks) -> None:
        self.roster = roster
        self.connections: dict[int, bytes] = {}  # number -> zero
        self.confirmed = 0

    def hear_one(self) -> bool:
        found = self.roster.next()
        if found is None:
            return False
        record, descriptor = found
        kind, number, stop = records.decode(record)
        if kind == records.WATCH:
            assert descriptor is not None
            (self.connections[number],) = stop.zeros
        else:
            assert descriptor is None
            del self.connections[number]
        self.roster.confirm(has_descriptor=descriptor is not None)
        self.confirmed += 1
        return True

    def hear_all(self) -> None:
        while self.hear_one():
            pass


def watched(zero: bytes = b"zero", descriptor: int | None = 7) -> Watched:
    return Watched(lambda: descriptor, rosserial_stop((zero,), 512))


def test_link_is_sent_with_its_descriptor_then_released() -> None:
    roster = GuardedLinks()
    roster.watch(3, watched())
    assert roster.next() == (records.encode(records.WATCH, 3, rosserial_stop((b"zero",), 512)), 7)
    roster.confirm(has_descriptor=True)
    assert (roster.next(), roster.connections) == (None, 1)
    roster.release(3)
    assert roster.next() == (records.encode(records.RELEASE, 3), None)
    roster.confirm(has_descriptor=False)
    assert (roster.next(), roster.connections) == (None, 0)


def test_link_released_before_it_was_sent_is_not_sent() -> None:
    roster = GuardedLinks()
    roster.watch(3, watched())
    roster.release(3)
    assert roster.next() is None


def test_connection_closed_before_it_was_sent_is_not_sent() -> None:
    roster = GuardedLinks()
    roster.watch(3, watched(descriptor=None))
    assert roster.next() is None
    roster.release(3)
    assert roster.next() is None


def test_new_frames_replace_the_old_ones() -> None:
    roster = GuardedLinks()
    guardian = Guardian(roster)
    for zero in (b"old", b"newer"):
        roster.watch(3, watched(zero))
        guardian.hear_all()
    assert guardian.connections == {3: b"newer"}


def test_everything_is_sent_to_a_new_guardian() -> None:
    roster = GuardedLinks()
    first = Guardian(roster)
    for number in (1, 2, 3):
        roster.watch(number, watched())
    first.hear_all()
    roster.release(2)
    roster.forget()
    second = Guardian(roster)
    second.hear_all()
    assert set(second.connections) == {1, 3}


def test_records_for_a_stuck_guardian_are_bounded() -> None:
    roster = GuardedLinks()
    for number in range(10_000):
        roster.watch(number, watched())
        roster.release(number)
    assert roster.next() is None
    for _ in range(10_000):
        roster.watch(1, watched())
    assert roster.next() is not None
    roster.confirm(has_descriptor=True)
    assert roster.next() is None


@given(STEPS)
def test_guardian_finally_has_exactly_the_open_watched_links(steps: list[tuple[str, int]]) -> None:
    roster = GuardedLinks()
    guardian = Guardian(roster)
    wanted: dict[int, bytes] = {}
    closed: set[int] = set()
    for number_of_step, (step, number) in enumerate(steps):
        if step == "watch":
            closed.discard(number)
            wanted[number] = bytes(number_of_step)
            zeros = (wanted[number],)
            roster.watch(
                number, Watched(lambda number=number: None if number in closed else 7, rosserial_stop(zeros, 512))
            )
        elif step == "release":
            wanted.pop(number, None)
            roster.release(number)
        elif step == "close":
            closed.add(number)
        elif step == "tell":
            guardian.hear_one()
        else:
            guardian = Guardian(roster)
            roster.forget()
    guardian.hear_all()
    assert guardian.connections.keys() >= wanted.keys() - closed
    assert guardian.connections.keys() <= wanted.keys()
    assert all(guardian.connections[number] == wanted[number] for number in wanted.keys() - closed)
    assert roster.connections == len(guardian.connections)
