"""Messages as JSON: numpy's numbers and arrays, and what has none."""

from typing import Any

import numpy as np
import pytest

from hostlink.client.http_client import encode
from hostlink.errors import HostlinkError


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.float64(0.5), b"0.5"),
        (np.float32(0.25), b"0.25"),
        (np.int16(-7), b"-7"),
        (np.uint64(2**63), b"9223372036854775808"),
        (np.bool_(True), b"true"),
        (np.str_("text"), b'"text"'),
        (np.array([1.5, 2.0]), b"[1.5,2.0]"),
        (np.arange(4, dtype=np.uint8).reshape(2, 2), b"[[0,1],[2,3]]"),
        (np.array([]), b"[]"),
        ({"data": [np.int8(1), {"x": np.float16(2.0)}]}, b'{"data":[1,{"x":2.0}]}'),
    ],
)
def test_numpy_is_as_good_as_plain_python(value: Any, text: bytes) -> None:
    assert encode(value) == text


@pytest.mark.parametrize("value", [{"data": object()}, {"data": 1j}, [print], {object(): 1}])
def test_value_without_json_raises_an_error_that_names_its_type(value: Any) -> None:
    with pytest.raises(HostlinkError, match="a message cannot contain"):
        encode(value)
