"""A test that fails beside others has one more try alone; what fails again, or in numbers, is a failure."""

import json
from pathlib import Path

import pytest

from tools import run_tests


class Runs:
    """Stands for pytest: each run ends with the next code, and keeps what failed in it."""

    def __init__(self, *runs: tuple[int, list[str]]) -> None:
        self.runs = list(runs)
        self.arguments: list[list[str]] = []

    def __call__(self, arguments: list[str]) -> int:
        self.arguments.append(arguments)
        code, failed = self.runs.pop(0)
        run_tests.LAST_FAILED.parent.mkdir(parents=True, exist_ok=True)
        run_tests.LAST_FAILED.write_text(json.dumps(dict.fromkeys(failed, True)))
        return code


@pytest.fixture(autouse=True)
def in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_what_failed_beside_others_is_run_alone_and_named(capfd: pytest.CaptureFixture[str]) -> None:
    runs = Runs((1, ["b", "a"]), (0, []))
    assert run_tests.run_tests(["-n", "6", "-m", "quiet"], runs) == 0
    assert runs.arguments == [["-n", "6", "-m", "quiet"], ["a", "b"]]
    assert "passed only when run again, to be looked at: a, b" in capfd.readouterr().out


def test_what_fails_again_is_a_failure(capfd: pytest.CaptureFixture[str]) -> None:
    runs = Runs((1, ["a"]), (1, ["a"]))
    assert run_tests.run_tests([], runs) == 1
    assert "passed only" not in capfd.readouterr().out


@pytest.mark.parametrize(
    ("code", "failed"),
    [(0, []), (1, ["a", "b", "c", "d"]), (2, ["a"]), (5, []), (1, [])],
    ids=["passed", "four at once", "cannot be read", "no tests", "killed before it kept anything"],
)
def test_everything_else_is_said_at_once(code: int, failed: list[str]) -> None:
    runs = Runs((code, failed))
    assert run_tests.run_tests([], runs) == code
    assert len(runs.arguments) == 1


def test_what_failed_the_day_before_is_not_run() -> None:
    Runs((1, ["old"]))([])
    runs = Runs((1, ["new"]), (0, []))
    assert run_tests.run_tests([], runs) == 0
    assert runs.arguments == [[], ["new"]]
