"""Parts of the chain run for any time: all that they print is read."""

import sys

import pytest

from tools.chain import running

TALKER = "import sys; [print('x' * 99) for _ in range(10_000)]; sys.exit(7)"  # a megabyte: a pipe holds 64 KiB


@pytest.mark.parametrize("first", ["", "print('{\"port\": 1}', flush=True); "])
def test_a_part_that_prints_much_is_not_blocked_without_a_reader(first: str) -> None:
    with running(sys.executable, "-c", "import sys; " + first + TALKER) as part:
        if first:
            assert part.line(within_s=10.0) == '{"port": 1}\n'
        assert part.process.wait(20.0) == 7


def test_a_part_that_prints_nothing_has_no_line() -> None:
    with running(sys.executable, "-c", "pass") as part:
        assert part.line(within_s=10.0) == ""
