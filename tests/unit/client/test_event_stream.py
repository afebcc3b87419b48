"""Bytes of server-sent events become events, however they are cut."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from hostlink.client import Event
from hostlink.client.http_client import EventStream

WIRE = (
    b'event: robots\ndata: {"robots": []}\n\n: alive\n\n'
    b'event: log\ndata: {"msg": "a: b \\n data: c"}\n\nevent: links\ndata: {"links": [1, 2]}\n\n'
)
EVENTS = [
    Event("robots", {"robots": []}),
    Event("log", {"msg": "a: b \n data: c"}),
    Event("links", {"links": [1, 2]}),
]


@given(st.lists(st.integers(0, len(WIRE)), max_size=20))
def test_every_split_gives_the_same_events(cuts: list[int]) -> None:
    edges = [0, *sorted(cuts), len(WIRE)]
    stream = EventStream()
    found = [event for left, right in itertools.pairwise(edges) for event in stream.feed(WIRE[left:right])]
    assert found == EVENTS


def test_a_later_stream_continues_after_the_newest_id_and_forgets_half_an_event() -> None:
    stream = EventStream()
    assert stream.last_id == ""
    (event,) = stream.feed(b'id: 7f-3\nevent: log\ndata: {"msg": "warm"}\n\nevent: robots\ndata: {"rob')
    assert (event, stream.last_id) == (Event("log", {"msg": "warm"}), "7f-3")
    stream.begin()
    assert list(stream.feed(WIRE)) == EVENTS
    assert stream.last_id == "7f-3"


def test_an_event_may_be_larger_than_any_buffer() -> None:
    stream = EventStream()
    data = b'{"robots": ["' + b"x" * 3_000_000 + b'"]}'
    parts = [b"event: robots\ndata: ", *(data[at : at + 65536] for at in range(0, len(data), 65536)), b"\n\n"]
    found = [event for part in parts for event in stream.feed(part)]
    assert len(found[0].data["robots"][0]) == 3_000_000
