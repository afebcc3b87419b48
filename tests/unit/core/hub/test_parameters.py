"""Settings in the three shapes that rosserial has for them."""

import pytest

from hostlink.core.config import ParameterValue
from hostlink.core.hub.parameters import find_parameter, to_parameter
from hostlink.core.protocol.events import Parameter
from hostlink.errors import WrongType


@pytest.mark.parametrize(
    ("value", "parameter"),
    [
        (7, Parameter(ints=(7,))),
        (True, Parameter(ints=(1,))),
        (0.5, Parameter(floats=(0.5,))),
        ("robåt", Parameter(strings=("robåt",))),
        ([1, -2], Parameter(ints=(1, -2))),
        ([1, 0.5], Parameter(floats=(1.0, 0.5))),
        (["left", "right"], Parameter(strings=("left", "right"))),
        ([], Parameter()),
    ],
)
def test_shapes(value: ParameterValue, parameter: Parameter) -> None:
    assert to_parameter("p", value) == parameter


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ([1, "a"], "parameter p: wanted a list of one kind, got strings among numbers"),
        (2**31, "parameter p: wanted int32, got (2147483648,)"),
    ],
)
def test_value_that_cannot_be_sent_is_named(value: ParameterValue, text: str) -> None:
    with pytest.raises(WrongType) as caught:
        to_parameter("p", value)
    assert str(caught.value) == text


@pytest.mark.parametrize("requested", ["/gain", "gain", "~gain"])
@pytest.mark.parametrize("set_as", ["/gain", "gain"])
def test_a_leading_slash_or_tilde_does_not_matter(requested: str, set_as: str) -> None:
    assert find_parameter({set_as: 7}, requested) == Parameter(ints=(7,))


def test_there_is_none() -> None:
    assert find_parameter({"/other": 7}, "/gain") is None
