"""State of a session as text: what is not one is None."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.xrce.resume import TEXT_CHARS_MAX, ClientState, SessionState, read_state
from hostlink.core.protocol.xrce.wire import ClientInfo

INFO = ClientInfo(b"\1\0", b"\1\x0f", b"\1\2\3\4", 0x81, (), 508)
STATE = SessionState((ClientState(INFO, 7, 9, {0x80: 30}, (0x15,), (b"\0\1", b"\0\2"), (b"\0\6",)),))


def test_state_is_read_as_it_was_written() -> None:
    assert read_state(STATE.to_json()) == STATE


def changed(**values: object) -> str:
    whole = json.loads(STATE.to_json())
    whole["clients"][0] |= values
    return json.dumps(whole)


@pytest.mark.parametrize(
    "text",
    [
        "", "[", "[]", "3", "null", STATE.to_json()[:-9], " " * (TEXT_CHARS_MAX + 1), '{"format": 1, "clients": []}',
        '{"format": 2, "clients": 5}', '{"format": 2, "clients": [5]}', "[" * 100_000,
        changed(key="00"), changed(key=5), changed(session=256), changed(mtu=-1), changed(number=1.5),
        changed(number=True), changed(sent=-1), changed(inputs=[5]), changed(inputs=[[256, 0]]), changed(unfit={}),
        changed(objects="00"), changed(objects=["zz"]), changed(reads=["00"] * 5000),
    ],
    ids=range(24),
)  # fmt: skip
def test_text_without_a_state_is_refused(text: str) -> None:
    assert read_state(text) is None


VALUES = st.none() | st.integers(-1, 300) | st.text(max_size=4)
LISTS = st.lists(VALUES, max_size=3) | st.dictionaries(st.text(max_size=4), VALUES, max_size=3)


@given(VALUES | LISTS | st.lists(LISTS, max_size=3))
def test_any_json_raises_nothing(value: object) -> None:
    read_state(json.dumps(value))
    read_state(json.dumps({"format": 2, "clients": value}))
    read_state(changed(objects=value))
