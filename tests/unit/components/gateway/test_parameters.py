"""rosapi's parameters: JSON in and out, names with and without a slash, trees, bounds."""

import pytest

from hostlink.components.gateway.rosapi import MAX_PARAMETERS, MAX_VALUE_CHARACTERS, Parameters
from hostlink.core.config import ParameterValue
from hostlink.errors import BadRequest, UnknownTopic, WrongType


def test_parameter_names_are_full_and_accepted_in_any_spelling() -> None:
    settings: dict[str, ParameterValue] = {"gain": 7, "~name": "x"}
    parameters = Parameters(settings)
    assert parameters.names() == ["/gain", "/name"]
    assert (parameters.get("/gain", ""), parameters.get("name", "")) == ("7", '"x"')
    parameters.put("/gain", "[1, 2.5]")
    assert settings == {"gain": [1, 2.5], "~name": "x"}
    parameters.delete("gain")
    assert (parameters.has("/gain"), parameters.get("/gain", "")) == (False, "null")


@pytest.mark.parametrize(("default", "value"), [("", "null"), ("3", "3"), ('{"a":1}', '{"a":1}'), ("text", '"text"')])
def test_missing_parameter_is_the_default(default: str, value: str) -> None:
    assert Parameters({}).get("/none", default) == value


def test_parameter_name_may_be_a_tree() -> None:
    settings: dict[str, ParameterValue] = {}
    parameters = Parameters(settings)
    parameters.put("/robot", '{"pid": {"kp": 1.0, "ki": 2.0}, "name": "r"}')
    assert settings == {"/robot/pid/kp": 1.0, "/robot/pid/ki": 2.0, "/robot/name": "r"}
    assert parameters.get("robot/pid", "") == '{"ki":2.0,"kp":1.0}'
    assert parameters.get("/", "") == '{"robot":{"name":"r","pid":{"ki":2.0,"kp":1.0}}}'
    parameters.put("/robot/pid", "5")
    assert parameters.get("/robot", "") == '{"name":"r","pid":5}'
    parameters.delete("/robot")
    assert settings == {}


@pytest.mark.parametrize(
    "text", ["{", "null", '{"a": null}', "[[1]]", "{}", "[" * 4000, "1" * (MAX_VALUE_CHARACTERS + 1)]
)
def test_parameter_value_that_fits_no_device_is_refused(text: str) -> None:
    with pytest.raises(BadRequest, match="set_param: value"):
        Parameters({}).put("/x", text)


@pytest.mark.parametrize("text", ["4294967296", "[1, 2147483648]", '["a", 1]', '{"a": 1, "b": {"c": [true, "x"]}}'])
def test_value_that_rosserial_cannot_carry_changes_nothing(text: str) -> None:
    settings: dict[str, ParameterValue] = {"/x": 1}
    with pytest.raises(WrongType):
        Parameters(settings).put("/x", text)
    assert settings == {"/x": 1}


def test_parameters_are_bounded_and_deleting_an_unknown_one_fails() -> None:
    parameters = Parameters({})
    for number in range(MAX_PARAMETERS):
        parameters.put(f"/p{number}", "1")
    parameters.put("/p0", "2")
    with pytest.raises(BadRequest, match=f"more than {MAX_PARAMETERS} parameters"):
        parameters.put("/one_more", "1")
    with pytest.raises(UnknownTopic, match="no parameter named /none"):
        parameters.delete("/none")
