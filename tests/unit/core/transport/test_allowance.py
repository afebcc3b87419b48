"""Allowance: no more is sent to an address than came from it, in any order."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.transport.udp import HEADER_BYTES, Allowance

SIZES = st.integers(1, 1452)


@given(st.lists(st.tuples(st.booleans(), st.lists(SIZES, min_size=1, max_size=4)), max_size=60))
def test_sent_bytes_never_exceed_received_bytes(steps: list[tuple[bool, list[int]]]) -> None:
    allowance = Allowance(is_limited=True)
    came: list[int] = []
    sent: list[int] = []
    for is_received, sizes in steps:
        if is_received:
            for size in sizes:
                allowance.earn(size)
            came += sizes
        elif allowance.allows([bytes(size) for size in sizes]):
            for size in sizes:
                allowance.spend(size)
            sent += sizes
        assert sum(sent) <= sum(came)
        assert sum(sent) + HEADER_BYTES * len(sent) <= sum(came) + HEADER_BYTES * len(came)


def test_as_many_bytes_as_received_may_be_sent() -> None:
    allowance = Allowance(is_limited=True)
    allowance.earn(20)
    assert allowance.allows([bytes(20)])
    assert not allowance.allows([bytes(21)])
    assert not allowance.allows([bytes(10), bytes(10)])  # two headers against one


def test_verified_address_has_no_limit() -> None:
    assert Allowance(is_limited=False).allows([bytes(1452)] * 100)
