"""Run the tests in groups. Every group runs, also after another one failed; a table at the end says what each did.

The groups are the pure packages with their branches counted, all other tests, those that a busy machine disturbs
(marked `quiet`), and those that need the machine for themselves (marked `alone`).

Up to MOST failed tests of a group are run once more by themselves, and the table counts them. A test with processes
and times in it can fail because other programs have the processor. A defect fails again.
"""

import argparse
import json
import re
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

MOST = 6  # more failures than that have a common cause
TESTS_FAILED = 1  # pytest's exit code; others are errors of the call or of pytest itself
LAST_FAILED = Path(".pytest_cache/v/cache/lastfailed")
REPORTS = Path("build/tests")
PURE = ("protocol", "messages", "robot", "diagnosis")

Run = Callable[[list[str]], int]


@dataclass(slots=True)
class Result:
    """Result of one group."""

    name: str
    code: int  # 0: each test passed, at the latest when it was run again
    passed: int
    failed: tuple[str, ...]  # also when they were run again
    passed_again: tuple[str, ...]
    not_run: int
    seconds: float


def run(command: list[str]) -> int:
    """Run a command with this interpreter; return its exit code."""
    return subprocess.run([sys.executable, *command], check=False).returncode


def failed_tests() -> list[str]:
    """Return the node ids of what failed last, as pytest keeps them."""
    return sorted(json.loads(LAST_FAILED.read_text())) if LAST_FAILED.exists() else []


def counts_of(report: Path) -> tuple[int, int]:
    """Return how many tests of a JUnit report passed, and how many were skipped; 0 of both where there is none."""
    if not report.exists():
        return 0, 0
    suites = ET.parse(report).getroot().iter("testsuite")  # noqa: S314 - written by pytest just now
    tests = skipped = broken = 0
    for suite in suites:
        tests += int(suite.get("tests", 0))
        skipped += int(suite.get("skipped", 0))
        broken += int(suite.get("failures", 0)) + int(suite.get("errors", 0))
    return tests - skipped - broken, skipped


def run_group(name: str, command: Sequence[str], arguments: Sequence[str], run: Run = run) -> Result:
    """Run a group with `command`, which is pytest or something around it; failed tests run again with pytest alone."""
    began_s, report = time.monotonic(), REPORTS / f"{name}.xml"
    LAST_FAILED.unlink(missing_ok=True)
    report.unlink(missing_ok=True)
    code = run([*command, *arguments, f"--junit-xml={report}"])
    failed = failed_tests()
    passed, not_run = counts_of(report)
    again: list[str] = []
    if code == TESTS_FAILED and 1 <= len(failed) <= MOST:
        print(f"run again alone: {', '.join(failed)}", flush=True)
        code = run(["-m", "pytest", *failed])
        still = failed_tests() if code else []
        again, failed = [each for each in failed if each not in still], still
    return Result(name, code, passed + len(again), tuple(failed), tuple(again), not_run, time.monotonic() - began_s)


def table(results: Sequence[Result]) -> str:
    """Return one line for each group, and the names of what failed."""
    lines = [f"{'group':12}{'passed':>8}{'failed':>8}{'not run':>9}{'seconds':>9}"]
    for each in results:
        failed = str(len(each.failed) or ("yes" if each.code else 0))
        lines.append(f"{each.name:12}{each.passed:>8}{failed:>8}{each.not_run:>9}{each.seconds:>9.0f}")
    lines += [f"failed: {test}" for each in results for test in each.failed]
    lines += [f"passed only when run again, to be looked at: {test}" for each in results for test in each.passed_again]
    return "\n".join(lines)


def groups(workers: int, quiet_workers: int) -> list[tuple[str, list[str], list[str]]]:
    """Return the name, the command and the arguments of each group."""
    pytest = ["-m", "pytest"]
    pure_tests = [f"tests/unit/{package}" for package in PURE]
    others = [f"--ignore={each}" for each in pure_tests]
    return [
        ("pure", ["-m", "coverage", "run", *pytest], ["-n", str(max(1, workers // 3)), *pure_tests]),
        ("others", pytest, ["-n", str(workers), "-m", "not quiet and not alone", *others]),
        ("quiet", pytest, ["-n", str(quiet_workers), "-m", "quiet and not alone", *marked("quiet")]),
        ("alone", pytest, ["-m", "alone", *marked("alone")]),
    ]


def marked(mark: str) -> list[str]:
    """Return the files with a mark: pytest would read all others for nothing."""
    pattern = re.compile(rf"mark\.{mark}\b")
    return sorted(str(file) for file in Path("tests").rglob("test_*.py") if pattern.search(file.read_text()))


def covered(run: Run = run) -> Result:
    """Check that the tests of the pure packages took each branch of them."""
    began_s = time.monotonic()
    files = ",".join(f"hostlink/{package}/*" for package in PURE)
    run(["-m", "coverage", "combine", "--quiet"])
    code = run(["-m", "coverage", "report", f"--include={files}", "--fail-under=100"])
    return Result("branches", code, int(not code), (), (), 0, time.monotonic() - began_s)


def main() -> int:
    """Run each group; return 0 if each test passed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, required=True)
    parser.add_argument("--quiet-workers", type=int, required=True)
    arguments = parser.parse_args()
    REPORTS.mkdir(parents=True, exist_ok=True)
    results: list[Result] = []
    for name, command, selected in groups(arguments.workers, arguments.quiet_workers):
        results.append(run_group(name, command, selected))
        if name == "pure":
            results.append(covered())
    print(table(results), flush=True)
    return int(any(each.code for each in results))


if __name__ == "__main__":
    sys.exit(main())
