"""Messages as they are typed for `pub` and `call`, and as `echo` prints them."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.cli.arguments import read_message
from hostlink.cli.topics import Echo, block, filled, message_count, message_lines, type_and_message, unheard, with_field
from hostlink.errors import ConfigError, HostlinkError

VECTOR = {
    "type": "Vector",
    "fieldnames": ["x", "y", "z"],
    "fieldtypes": ["float64"] * 3,
    "fieldarraylen": [-1] * 3,
}
TWIST = {
    "type": "Twist",
    "fieldnames": ["linear", "angular"],
    "fieldtypes": ["Vector", "Vector"],
    "fieldarraylen": [-1, -1],
}


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ([], ("", {})),
        (["data: hi"], ("", {"data": "hi"})),
        (["std_msgs/Empty"], ("std_msgs/Empty", {})),
        (["std_msgs/Empty", ""], ("std_msgs/Empty", {})),
        (["std_msgs/msg/String", "data: a/b"], ("std_msgs/String", {"data": "a/b"})),
        (["std_srvs/srv/SetBool", "{data: true}"], ("std_srvs/SetBool", {"data": True})),
        (["std_msgs/String", "hello"], ("std_msgs/String", ["hello"])),
        (["true"], ("", [True])),
        (["geometry_msgs/Twist", "[0.1, 0, 0]", "[0, 0, 0.5]"], ("geometry_msgs/Twist", [[0.1, 0, 0], [0, 0, 0.5]])),
        (["1", "-2.5", "x"], ("", [1, -2.5, "x"])),
    ],
)
def test_message_has_a_type_before_it_or_values_of_its_fields(words: list[str], wanted: tuple[str, Any]) -> None:
    assert type_and_message("MESSAGE", words) == wanted


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["data:", "hi"], "put the message in quotes"),
        (["[1, 2"], "write a list as"),
        (["{data"], "MESSAGE: cannot be read: } is missing at the end; write it as"),
    ],
)
def test_message_that_cannot_be_read_names_the_next_step(words: list[str], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        type_and_message("MESSAGE", words)


def test_values_are_given_to_fields_in_order() -> None:
    known = {"Vector": VECTOR, "Twist": TWIST}
    assert filled(known, TWIST, [[1, 2, 3], {"z": 4}]) == {"linear": {"x": 1, "y": 2, "z": 3}, "angular": {"z": 4}}
    lists = {"type": "Lists", "fieldnames": ["v"], "fieldtypes": ["Vector"], "fieldarraylen": [0]}
    assert filled(known, lists, [[1, 2]]) == {"v": [1, 2]}
    with pytest.raises(HostlinkError, match="1 value was given, but Twist needs one for each of: linear, angular; "):
        filled(known, TWIST, [1])
    with pytest.raises(HostlinkError, match="2 values were given, but Empty has no fields; leave the values out"):
        filled({}, {"type": "Empty", "fieldnames": []}, [1, 2])


@pytest.mark.parametrize(
    ("rate_hz", "count", "once", "wanted"),
    [(None, None, False, 1), (10.0, None, False, 0), (10.0, 3, False, 3), (None, 0, False, 0), (10.0, None, True, 1)],
)
def test_rate_without_a_number_means_until_ctrl_c(
    rate_hz: float | None, count: int | None, once: bool, wanted: int
) -> None:
    assert message_count(rate_hz, count, once=once) == wanted


def test_once_and_a_number_of_messages_are_refused() -> None:
    with pytest.raises(ConfigError, match="cannot be combined with --count"):
        message_count(None, 2, once=True)


MESSAGE = {
    "header": {"stamp": {"secs": 1}, "frame_id": "a: b"},
    "ok": True,
    "nothing": None,
    "empty": [],
    "none": {},
    "numbers": [1.5, 2, 3],
    "points": [{"x": 1, "y": {"z": 2}}, {"x": 3, "y": {"z": 4}}],
}


def test_message_is_printed_with_a_field_a_line_indented() -> None:
    assert block(MESSAGE) == [
        "header:",
        "  stamp:",
        "    secs: 1",
        '  frame_id: "a: b"',
        "ok: true",
        "nothing: null",
        "empty: []",
        "none: {}",
        "numbers: [1.5, 2, 3]",
        "points:",
        "  - x: 1",
        "    y:",
        "      z: 2",
        "  - x: 3",
        "    y:",
        "      z: 4",
    ]


def test_single_item_of_a_list_of_messages_stays_an_item() -> None:
    assert block({"points": [{"x": 1}]}) == ["points:", "  - x: 1"]


def test_long_lists_and_texts_are_shortened() -> None:
    assert block({"ranges": list(range(40))}, 32) == ["ranges: [0, 1, 2, 3, 4, 5, 6, 7, ...]  # the first 8 of 40"]
    items = block({"points": [{"x": number} for number in range(40)]}, 32)
    assert (len(items), items[-2:]) == (10, ["  - x: 7", "  # the first 8 of 40"])
    assert block({"data": "a" * 200}, 32) == [f'data: "{"a" * 32}"  # the first 32 of 200 characters']
    assert block({"data": "a" * 200}) == [f'data: "{"a" * 200}"']


def test_lists_without_values_show_their_length() -> None:
    assert block({"ranges": [1] * 360, "empty": [], "points": [{"x": 1}], "name": "long" * 99}, 0) == [
        "ranges: <list of 360>",
        "empty: []",
        "points: <list of 1>",
        f"name: {json.dumps('long' * 99)}",
    ]


@pytest.mark.parametrize(
    ("topic", "wanted"),
    [
        ("/r/odom", ("/r/odom", "")),
        ("r/odom/pose/x", ("/r/odom", "pose.x")),
        ("/r/odometry", ("/r/odometry", "")),
        ("/unknown/x", ("/unknown/x", "")),
    ],
)
def test_end_of_an_unknown_topic_is_a_field(topic: str, wanted: tuple[str, str]) -> None:
    echo = Echo(topic=topic, field="", count=0, throttle_ms=0, timeout_s=0, as_json=False, as_csv=False, longest=0)
    found = with_field(echo, ["/r/odom"])
    assert (found.topic if found.field else "/" + found.topic.lstrip("/"), found.field) == wanted


TWIST_LINES = """linear:
  x: 0.1
  y: 0.0
angular:
  z: -0.5"""


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (TWIST_LINES, {"linear": {"x": 0.1, "y": 0.0}, "angular": {"z": -0.5}}),
        ("data: 'it''s: here'\nok: True\nname: hello world", {"data": "it's: here", "ok": True, "name": "hello world"}),
        ("points:\n- x: 1\n  y: 2\n-\n  x: 3\nlast: 4", {"points": [{"x": 1, "y": 2}, {"x": 3}], "last": 4}),
        ("# a comment\nvalues:\n  - -1\n  - 2\nempty:\n---", {"values": [-1, 2], "empty": None}),
        ("header: {frame_id: map}\nranges: [1, 2]", {"header": {"frame_id": "map"}, "ranges": [1, 2]}),
        ("---\n# nothing", {}),
    ],
)
def test_lines_of_yaml_are_a_message(text: str, wanted: Any) -> None:
    assert read_message(text) == wanted


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("x: 1\n  y: 2", "line 2 is not indented"),
        ("x: 1\nhello", "line 2 is not `name: value`: hello"),
        ("x: [1\ny: 2", "line 1: ] is missing at the end"),
        ('x: "a\ny: 2', "line 1: the quotation mark .* is not closed"),
    ],
)
def test_lines_that_are_not_yaml_are_refused(text: str, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        read_message(text)


NAMES = st.text("ab_", min_size=1, max_size=4)
SCALARS = st.none() | st.booleans() | st.integers(-9, 9) | st.floats(-9, 9) | st.text(max_size=8)
MESSAGES = st.recursive(
    SCALARS | st.lists(SCALARS, max_size=3),
    lambda inner: st.dictionaries(NAMES, inner, max_size=3) | st.lists(st.dictionaries(NAMES, inner), max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(NAMES, MESSAGES, max_size=4))
def test_message_that_echo_prints_is_read_again(message: dict[str, Any]) -> None:
    assert read_message("\n".join([*block(message), "---", ""])) == message


def test_csv_of_a_message_with_only_empty_fields_has_its_time_alone() -> None:
    echo = Echo(topic="/t", field="", count=0, throttle_ms=0, timeout_s=0, as_json=False, as_csv=True, longest=0)
    head, line = message_lines({"a": {}}, echo, is_first=True)
    assert (head, line.count(",")) == ("time", 0)


def heard(name: str, type_name: str = "geometry_msgs/Twist", *, velocity: bool = False) -> dict[str, Any]:
    return {"name": name, "type": type_name, "subscribed": True, "velocity": velocity}


TOPICS = [
    heard("/robot_10/cmd_vel", velocity=True),
    heard("/robot_2/cmd_vel", velocity=True),
    heard("/robot_2/stamped", "geometry_msgs/TwistStamped", velocity=True),
    heard("/led", "std_msgs/Bool"),
    {**heard("/odom"), "subscribed": False},
]


@pytest.mark.parametrize(
    ("topic", "type_name", "wanted"),
    [
        ("/cmd_vel", "geometry_msgs/Twist", "robots listen on: /robot_2/cmd_vel, /robot_10/cmd_vel; `hostlink robots`"),
        ("/cmd_vel", "geometry_msgs/TwistStamped", "robots listen on: /robot_2/stamped; "),
        ("/lad", "std_msgs/Bool", "; similar names: /led; `hostlink topics` lists"),
        ("/odom", "nav_msgs/Odometry", "; `hostlink topics` lists"),
    ],
)
def test_a_topic_without_a_subscriber_is_told_with_the_topics_of_robots(
    topic: str, type_name: str, wanted: str
) -> None:
    line = unheard(topic, type_name, TOPICS)
    assert line.startswith(f"{topic} has no subscriber, so that no robot and no program receives this; ")
    assert wanted in line


def test_a_velocity_without_a_robot_is_told() -> None:
    assert "no robot listens to a geometry_msgs/Twist now" in unheard("/cmd_vel", "geometry_msgs/Twist", TOPICS[3:])


@pytest.mark.parametrize("topic", ["/led", "/robot_2/cmd_vel"])
def test_a_topic_with_a_subscriber_needs_no_line(topic: str) -> None:
    assert unheard(topic, "std_msgs/Bool", TOPICS) == ""
