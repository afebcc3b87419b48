"""A world's numbers: those of the C++ struct by name, as text, and what is wrong with them."""

import contextlib
import math
import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.workbench.sim.firmware_module import ParameterRange, WorldParameters, bounds, read, wheel
from hostlink.workbench.sim.firmware_world import Firmware

NAMES = list(bounds())


def test_names_defaults_and_ranges_are_those_of_the_struct() -> None:
    assert NAMES[:2] == ["seed", "track_m"]
    assert len(NAMES) == 36
    assert bounds()["track_m"] == ParameterRange(0.21, 1e-6, 1e6)
    assert WorldParameters()["left.radius_m"] == WorldParameters()["right.radius_m"] == 0.045


def test_world_of_text_has_the_numbers_of_the_text() -> None:
    text = "# a comment\n\ntrack_m=0.2142\r\nleft.radius_m=4.48e-2\n"
    assert read(text) == WorldParameters({"track_m": 0.2142, **wheel("left", radius_m=0.0448)})
    assert read(read(text).text()) == read(text)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("track=0.2", "track: no such parameter; meant track_m?"),
        ("track_m", "'track_m' is not of the form name=number"),
        ("track_m=", "'track_m=' is not of the form name=number"),
        ("track_m=wide", "'track_m=wide' is not of the form name=number"),
        ("track_m= 0.2", "'track_m= 0.2' is not of the form name=number"),
        ("track_m=0.2\0", "'track_m=0.2\ufffd' is not of the form name=number"),
        ("track_m=nan", "track_m: nan is not in 1e-06..1e+06"),
        ("left.radius_m=11", "left.radius_m: 11 is not in 1e-06..10"),
    ],
)
def test_wrong_line_is_named_with_its_number(line: str, reason: str) -> None:
    with pytest.raises(ValueError, match="line 3") as refused:
        read("# wide\n\n" + line + "\n")
    assert str(refused.value) == f"line 3: {reason}"


@pytest.mark.parametrize("name", NAMES)
def test_number_out_of_its_range_is_refused(name: str) -> None:
    _, low, high = bounds()[name]
    for value in (low, high):
        assert read(f"{name}={value!r}\n")[name] == value
        WorldParameters({name: value}).checked_values()
    for value in (low - 0.5, high * 1.5, math.nan, math.inf):
        with pytest.raises(ValueError, match=name):
            WorldParameters({name: value}).checked_values()
        with pytest.raises(ValueError, match=name):
            Firmware(WorldParameters({name: value}))


def test_unknown_name_is_refused_when_the_world_is_used() -> None:
    with pytest.raises(ValueError, match="meant track_m"):
        Firmware(WorldParameters({"track": 0.2}))


def test_equal_worlds_are_equal_after_a_pickle() -> None:
    world = WorldParameters({"seed": 3}).changed({"track_m": 0.2})
    again = pickle.loads(pickle.dumps(world))  # noqa: S301 - as the laboratory's processes get it
    assert (again, hash(again)) == (world, hash(world))
    assert world != WorldParameters({"seed": 3})


@pytest.mark.parametrize("seed", [4.0312345678901234e-294, 1.2345678901234567e-307, 2.2250738585072014e-308, 5e-324])
def test_tiny_number_is_read_as_it_was_written(seed: float) -> None:
    (value, *_) = read(f"seed={seed!r}\n").checked_values()
    assert value == pytest.approx(seed, rel=1e-14, abs=0)


near_numbers = st.text("0123456789.+-eE x", max_size=8)
near_lines = st.one_of(
    st.builds("{}={}".format, st.sampled_from([*NAMES, "track", "left", "", "#"]), near_numbers),
    st.builds("{}={!r}".format, st.sampled_from(NAMES), st.floats(0.0, 12.0)),
    st.text(st.characters(codec="utf-8"), max_size=12),
)


@given(lines=st.lists(near_lines, max_size=4), end=st.sampled_from(["\n", "\r\n", "\r"]))
def test_any_text_is_a_world_or_has_a_wrong_line(lines: list[str], end: str) -> None:
    with contextlib.suppress(ValueError):
        world = read(end.join(lines))
        values, again = world.checked_values(), read(world.text()).checked_values()
        assert len(values) == len(NAMES)
        assert list(again) == pytest.approx(list(values), rel=1e-14, abs=0)  # text is read right to its last digits
