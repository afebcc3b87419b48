"""Every group runs; a test that fails with others is repeated alone; a repeated failure or many failures count."""

import json
from pathlib import Path

import pytest

from tools import run_tests

REPORT = '<testsuites><testsuite tests="10" failures="{failures}" errors="0" skipped="2"/></testsuites>'


class Runs:
    """Stands for pytest: each run ends with the next code, and keeps what failed in it."""

    def __init__(self, *runs: tuple[int, list[str]]) -> None:
        self.runs = list(runs)
        self.arguments: list[list[str]] = []

    def __call__(self, arguments: list[str]) -> int:
        self.arguments.append([each for each in arguments if not each.startswith("--junit-xml=")])
        code, failed = self.runs.pop(0)
        run_tests.LAST_FAILED.parent.mkdir(parents=True, exist_ok=True)
        run_tests.LAST_FAILED.write_text(json.dumps(dict.fromkeys(failed, True)))
        for each in arguments:
            if each.startswith("--junit-xml="):
                Path(each.partition("=")[2]).write_text(REPORT.format(failures=len(failed)))
        return code


@pytest.fixture(autouse=True)
def in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run_tests.REPORTS.mkdir(parents=True)


def run_group(runs: Runs) -> run_tests.Result:
    return run_tests.run_group("some", ["-m", "pytest"], ["-n", "6"], runs)


def test_test_that_failed_with_others_is_run_alone_and_named() -> None:
    runs = Runs((1, ["b", "a"]), (0, []))
    result = run_group(runs)
    assert (result.code, result.failed, result.passed_again) == (0, (), ("a", "b"))
    assert (result.passed, result.not_run) == (8, 2)
    assert runs.arguments == [["-m", "pytest", "-n", "6"], ["-m", "pytest", "a", "b"]]
    assert "passed only when run again, to be looked at: a" in run_tests.table([result])


def test_test_that_fails_again_is_a_failure() -> None:
    result = run_group(Runs((1, ["a", "b"]), (1, ["a"])))
    assert (result.code, result.failed, result.passed_again) == (1, ("a",), ("b",))
    assert "failed: a" in run_tests.table([result])


@pytest.mark.parametrize(
    ("code", "failed"),
    [(0, []), (1, list("abcdefg")), (2, ["a"]), (5, []), (1, [])],
    ids=["passed", "seven at once", "cannot be read", "no tests", "killed before it kept anything"],
)
def test_everything_else_is_reported_at_once(code: int, failed: list[str]) -> None:
    runs = Runs((code, failed))
    assert run_group(runs).code == code
    assert len(runs.arguments) == 1


def test_failure_of_an_earlier_run_is_not_repeated() -> None:
    Runs((1, ["old"]))([])
    runs = Runs((1, ["new"]), (0, []))
    assert run_group(runs).code == 0
    assert runs.arguments[1] == ["-m", "pytest", "new"]


def test_a_group_that_was_killed_without_a_report_counts_as_failed_in_the_table() -> None:
    def killed(_: list[str]) -> int:
        return 137

    result = run_tests.run_group("some", ["-m", "pytest"], [], killed)
    assert run_tests.table([result]).splitlines()[1].split() == ["some", "0", "yes", "0", "0"]


def test_the_groups_take_every_test_once() -> None:
    selections = {name: arguments for name, _, arguments in run_tests.groups(6, 3)}
    assert list(selections) == ["pure", "others", "quiet", "alone"]
    for package in run_tests.PURE:
        assert f"tests/unit/{package}" in selections["pure"]
        assert f"--ignore=tests/unit/{package}" in selections["others"]
    assert [selections[name][selections[name].index("-m") + 1] for name in ("others", "quiet", "alone")] == [
        "not quiet and not alone",
        "quiet and not alone",
        "alone",
    ]
