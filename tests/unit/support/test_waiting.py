"""A wait that fails reports the condition, its last value and its last error."""

import asyncio

import pytest

from hostlink.errors import UnknownTopic
from tests.support.virtual_loop import run_virtual
from tests.support.waiting import TIMEOUT_S, described, expect, expect_never, is_soon


class Counter:
    """Counts on each reading."""

    def __init__(self) -> None:
        self.count = 0

    def reaches_five(self) -> bool:
        self.count += 1
        return self.count >= 5

    def is_high(self) -> bool:
        return self.count > 100


def test_expect_returns_with_the_first_true_value() -> None:
    counter = Counter()
    run_virtual(expect(counter.reaches_five))
    assert counter.count == 5


def test_a_failure_has_the_condition_and_the_values_in_it() -> None:
    counter = Counter()
    with pytest.raises(
        AssertionError, match=rf"not within {TIMEOUT_S:g} s: counter.count == 7\n  last value: 0 == 7\n"
    ):
        run_virtual(expect(lambda: counter.count == 7))


def test_a_condition_on_several_lines_is_one_text() -> None:
    counter = Counter()
    text = described(
        lambda: (
            "ü, of two bytes" in ("a list", "that is so long that it needs more than one line", "ü, of two bytes")
            and counter.count > 1
        )
    )
    assert text.splitlines()[0].endswith('"ü, of two bytes") and counter.count > 1')


def test_a_failure_has_the_last_error() -> None:
    facts: dict[str, int] = {}
    with pytest.raises(AssertionError, match=r'facts\["speed"\] > 3\n  last error: KeyError: \'speed\''):
        run_virtual(expect(lambda: facts["speed"] > 3))


def test_a_method_is_named() -> None:
    with pytest.raises(AssertionError, match=r"Counter.is_high\n  last value: False"):
        run_virtual(expect(Counter().is_high))


def test_errors_of_hostlink_count_as_not_yet() -> None:
    counter = Counter()

    def is_so() -> bool:
        if not counter.reaches_five():
            raise UnknownTopic("topic", "/odom")
        return True

    run_virtual(expect(is_so))
    assert counter.count == 5


def test_other_errors_end_the_wait_at_once() -> None:
    counter = Counter()

    def is_so() -> bool:
        counter.count += 1
        return bool(1 / 0)

    with pytest.raises(ZeroDivisionError):
        run_virtual(expect(is_so))
    assert counter.count == 1


def test_expect_never_watches_for_the_whole_time() -> None:
    counter = Counter()

    async def wait() -> float:
        await expect_never(lambda: counter.count, for_s=0.5)
        return asyncio.get_running_loop().time()

    assert run_virtual(wait()) >= 0.5
    counter.count = 1
    with pytest.raises(AssertionError, match=r"within 0.5 s: counter.count"):
        run_virtual(wait())


@pytest.mark.parametrize(
    ("measured", "is_below", "tries"),
    [([0.4], True, 1), ([0.6, 0.4], True, 2), ([0.6, 0.5, 0.4], True, 3), ([0.6, 0.5, 0.7, 0.1], False, 3)],
)
async def test_one_measurement_below_the_limit_is_enough(measured: list[float], is_below: bool, tries: int) -> None:
    left = iter(measured)

    async def measure() -> float:
        return next(left)

    assert await is_soon(measure, 0.5) == is_below
    assert len(measured) - len(list(left)) == tries
