"""Parsing of definitions, and errors by line."""

import pytest

from hostlink.core.messages.fields import SCALAR, VARIABLE, Constant, Field, bool_value
from hostlink.core.messages.parsing import parse_message, parse_service
from hostlink.errors import ConfigError

EVERYTHING = """\
# a comment, and an empty line

int8 LOW = -128   # with a comment
string TEXT= a # that is text = so
bool ON=True
bool OFF=0
float32 PI = 3.14
Header header
Point[] points # of this package
geometry_msgs/Pose  pose
time\tstamp
float64[36] covariance
string[] names
"""


def test_every_kind_of_line_is_parsed() -> None:
    definition = parse_message("pkg/Type", EVERYTHING, "Type.msg")
    assert definition.constants == (
        Constant("LOW", "int8", "-128"),
        Constant("TEXT", "string", "a # that is text = so"),
        Constant("ON", "bool", "True"),
        Constant("OFF", "bool", "0"),
        Constant("PI", "float32", "3.14"),
    )
    assert definition.fields == (
        Field("header", "std_msgs/Header", SCALAR),
        Field("points", "pkg/Point", VARIABLE),
        Field("pose", "geometry_msgs/Pose", SCALAR),
        Field("stamp", "time", SCALAR),
        Field("covariance", "float64", 36),
        Field("names", "string", VARIABLE),
    )
    assert definition.text == EVERYTHING


def test_time_of_ros_2_is_a_time() -> None:
    text = "builtin_interfaces/Time a\n  builtin_interfaces/Duration[2]\tb\nstring C=builtin_interfaces/Time\n"
    definition = parse_message("pkg/Type", text, "Type.msg")
    assert definition.fields == (Field("a", "time", SCALAR), Field("b", "duration", 2))
    assert definition.text == "time a\n  duration[2]\tb\nstring C=builtin_interfaces/Time\n"
    assert parse_message("pkg/Type", "builtin_interfaces/Times a", "Type.msg").fields[0].type.endswith("Times")


def test_fields_write_their_type_as_a_definition_does() -> None:
    fields = parse_message("pkg/Type", "int8 a\nint8[] b\nint8[3] c", "Type.msg").fields
    assert [field.type_text for field in fields] == ["int8", "int8[]", "int8[3]"]


@pytest.mark.parametrize("separator", ["\x0b", "\x0c", "\x1c", "\x85", "\u2028"])
def test_only_a_newline_ends_a_line(separator: str) -> None:
    """ROS does the same; otherwise the md5 sum would differ."""
    definition = parse_message("pkg/Type", f"# a{separator}b c d\nstring A=x{separator}#y\nint8 z\n", "Type.msg")
    assert definition.constants == (Constant("A", "string", f"x{separator}#y"),)
    assert definition.fields == (Field("z", "int8", SCALAR),)
    request, response = parse_service("pkg/Type", f"# a{separator}---\nint8 a\n---\nint8 b\n", "Type.srv")
    assert (len(request.fields), len(response.fields)) == (1, 1)


def test_text_ends_with_one_newline_or_is_empty() -> None:
    assert parse_message("pkg/Type", "int8 a\n\n\n", "Type.msg").text == "int8 a\n"
    assert parse_message("pkg/Type", " \n\n", "Type.msg").text == ""


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("float64", "wanted TYPE NAME, got 'float64'"),
        ("wstring[] x", "wstring exists only in ROS 2; use string"),
        ("float64 x 0.0", "wanted TYPE NAME, got 'float64 x 0.0'; default values exist only in ROS 2; remove it"),
        ("string x 'a b'", "wanted TYPE NAME, got \"string x 'a b'\"; default values exist only in ROS 2; remove it"),
        (
            "string<=10 x",
            "wanted TYPE NAME=VALUE, got 'string<=10 x'; bounded types exist only in ROS 2; remove the bound",
        ),
        (
            "uint8[<=5] x",
            "wanted TYPE NAME=VALUE, got 'uint8[<=5] x'; bounded types exist only in ROS 2; remove the bound",
        ),
        ("uint8[007] x", "uint8[007]: an array length must not begin with 0"),
        ("X=1", "wanted TYPE NAME=VALUE, got 'X=1'"),
        ("float64[ x", "'float64[' is not a valid type"),
        ("a/b/c x", "'a/b/c' is not a valid type"),
        ("float64 1x", "'1x' is not a valid name; use letters, digits and _, and begin with a letter"),
        ("float64 x'];import", '"x\'];import" is not a valid name; use letters, digits and _, and begin with a letter'),
        ("float64 first", "first is defined twice"),
        ("int8 first=1", "first is defined twice"),
        ("time X=1", "a constant cannot have the type time"),
        ("uint8 X=256", "constant X: 256 is outside 0..255"),
        ("int16 X=-32769", "constant X: -32769 is outside -32768..32767"),
        ("bool X=2", "constant X: 2 is outside 0..1"),
        ("int8 X=1.5", "constant X: '1.5' is not a whole number"),
        ("float32 X=much", "constant X: 'much' is not a number"),
        ("int8[0] x", "int8[0]: an array length must be 1 to 65535, or empty"),
        ("int8[65536] x", "int8[65536]: an array length must be 1 to 65535, or empty"),
    ],
)
def test_bad_line_is_named(line: str, problem: str) -> None:
    with pytest.raises(ConfigError) as error:
        parse_message("pkg/Type", f"int8 first\n\n{line}\n", "pkg/Type.msg")
    assert str(error.value) == f"pkg/Type.msg:3: {problem}"


def test_service_is_two_messages() -> None:
    request, response = parse_service("pkg/Ask", "int8 a\n---\n\nint8 b", "Ask.srv")
    assert (request.name, request.fields) == ("pkg/AskRequest", (Field("a", "int8"),))
    assert (response.name, response.fields) == ("pkg/AskResponse", (Field("b", "int8"),))
    assert response.field_lines == (4,)


@pytest.mark.parametrize(("text", "cuts"), [("int8 a", 0), ("---\n---", 2)])
def test_service_without_exactly_one_separator_is_refused(text: str, cuts: int) -> None:
    with pytest.raises(
        ConfigError, match=rf"^Ask.srv: a service definition needs exactly one line of ---, found {cuts}$"
    ):
        parse_service("pkg/Ask", text, "Ask.srv")


@pytest.mark.parametrize(("text", "value"), [("True", True), ("false", False), ("+1", True), ("0", False), ("1", True)])
def test_bool_constant_is_a_word_or_a_number(text: str, value: bool) -> None:
    assert bool_value(text) is value
