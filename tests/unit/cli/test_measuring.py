"""Figures of messages: rate, distribution, and how they are written."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.cli.output import duration, quantity
from hostlink.cli.topics import MessageWindow, distribution
from hostlink.errors import size


def test_a_rate_is_of_the_window() -> None:
    measured = MessageWindow(3)
    for time_s, size_bytes in ((0.0, 9), (10.0, 10), (10.5, 20), (11.0, 30)):
        measured.add(time_s, size_bytes)
    assert measured.messages == 4
    assert measured.rate_hz == 2.0
    assert (measured.figures.count, measured.figures.mean, measured.figures.most) == (3, 20.0, 30)


def test_one_message_or_many_at_once_have_no_rate() -> None:
    measured = MessageWindow(10)
    assert (measured.rate_hz, measured.between_s, measured.figures) == (0.0, None, None)
    measured.add(1.0)
    assert (measured.rate_hz, measured.between_s) == (0.0, None)
    measured.add(1.0)
    assert measured.rate_hz == 0.0


@given(st.lists(st.floats(-1e6, 1e6), min_size=1))
def test_the_mean_lies_within_and_the_deviation_is_at_most_the_width(numbers: list[float]) -> None:
    found = distribution(numbers)
    assert found.least - 1e-6 <= found.mean <= found.most + 1e-6
    assert 0 <= found.deviation <= found.most - found.least + 1e-6


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0, "0 ms"), (0.000_412, "0.412 ms"), (0.0333, "33.3 ms"), (1.234, "1.23 s"), (-0.002, "-2.0 ms")],
)
def test_a_duration_has_the_digits_of_a_person(seconds: float, text: str) -> None:
    assert duration(seconds) == text


@pytest.mark.parametrize(
    ("count", "text"), [(0, "0 B"), (320, "320 B"), (9600, "9.6 kB"), (1_200_000, "1.2 MB"), (4e9, "4.0 GB")]
)
def test_a_size_has_the_digits_of_a_person(count: float, text: str) -> None:
    assert size(count) == text


@pytest.mark.parametrize(
    ("count", "nouns", "text"),
    [
        (0, ("parameter",), "0 parameters"),
        (1, ("parameter",), "1 parameter"),
        (2, ("parameter",), "2 parameters"),
        (1, ("velocity", "velocities"), "1 velocity"),
        (2, ("velocity", "velocities"), "2 velocities"),
    ],
)
def test_number_of_things_has_the_form_of_the_noun(count: int, nouns: tuple[str, ...], text: str) -> None:
    assert quantity(count, *nouns) == text
