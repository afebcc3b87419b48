"""Messages as they are typed: JSON, and YAML in one line as rostopic and ros2 topic take it."""

import contextlib
import json
import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.cli.arguments import read_message

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-9, 9) | st.floats(-9, 9) | st.text("ab:{}[],'\"\\ é", max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("ab_:{", max_size=4), inner, max_size=3),
    max_leaves=8,
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{linear: {x: 0.1}, angular: {z: -0.5}}", {"linear": {"x": 0.1}, "angular": {"z": -0.5}}),
        ("linear: {x: 0.1}", {"linear": {"x": 0.1}}),
        ("{'linear': {'x': 0.1}}", {"linear": {"x": 0.1}}),
        ('"data": 1', {"data": 1}),
        ("data: true", {"data": True}),
        ("data: False", {"data": False}),
        ("data: hello world", {"data": "hello world"}),
        ("data: 'it''s {a: b}'", {"data": "it's {a: b}"}),
        ('{data: "say: {x: 1}, yes"}', {"data": "say: {x: 1}, yes"}),
        ("{data: [1, 2, 3], name: /map}", {"data": [1, 2, 3], "name": "/map"}),
        ("{names: [left, right]}", {"names": ["left", "right"]}),
        ("header: {frame_id: base_link}", {"header": {"frame_id": "base_link"}}),
        ("", {}),
    ],
)
def test_yaml_in_one_line_is_understood(text: str, message: dict[str, Any]) -> None:
    assert read_message(text) == message


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("{linear: {x: 1}", "} is missing at the end"),
        ("{", "} is missing at the end"),
        ("x: [{a: 1", "}] is missing at the end"),
        ('{"a": "}"', "} is missing at the end"),
        ("linear: {x: 0.1}}", "the } at '}' closes nothing"),
        ("linear: [0.1}, y: 1", "the } at '}, y: 1' closes nothing"),
        ("{data: 'open}", "the quotation mark ' at \"'open}\" is not closed"),
        ('data: "open', "the quotation mark \" at '\"open' is not closed"),
        ("linear {x: 0.1}", "it is wrong from 'linear {\"x\": 0.1}' on"),
        ("{x: , y: 1}", "it is wrong from ', \"y\": 1}' on"),
        ("x: 1 2", "it is wrong from '2' on"),
        ("x:", "a value is missing at the end"),
        (f"x: 1 {'2' * 31}", f"it is wrong from '{'2' * 30}...' on"),
    ],
)
def test_text_that_is_neither_json_nor_yaml_is_refused_with_the_place_of_the_fault(text: str, fault: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(fault)}$"):
        read_message(text)


@given(VALUES)
def test_json_means_what_it_means(value: Any) -> None:
    assert read_message(json.dumps(value)) == value


@given(VALUES)
def test_a_text_in_quotes_stays_as_it_is_in_yaml_too(value: Any) -> None:
    assert read_message(f"data: {json.dumps(value)}") == {"data": value}


@given(st.text(max_size=60))
def test_any_text_is_a_message_or_refused(text: str) -> None:
    with contextlib.suppress(ValueError):
        json.dumps(read_message(text))
