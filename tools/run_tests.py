"""Run the tests in groups. Each group runs, also after another one failed; a table at the end shows all results.

The groups are the pure packages with their branches counted, all other tests, those that a busy machine disturbs
(marked `quiet`), and those that need the machine for themselves (marked `alone`). Tests marked `long` are in none of
these groups: `--long` runs them in two groups of their own.

Tests whose programs are not installed (`tests/support/requirements.py`) are listed as not run. They fail the run only
where CI=true.
"""

import argparse
import os
import re
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

REPORTS = Path("build/tests")
PURE = ("protocol", "messages", "robot", "diagnosis")
MISSING = "needs "  # begins the reason of a skip for which something is not installed

Run = Callable[[list[str]], int]


@dataclass(slots=True)
class Result:
    """Result of one group."""

    name: str
    code: int  # exit code of pytest; 0: each test passed or was skipped
    passed: int = 0
    failed: list[str] = field(default_factory=list)  # names of tests
    skipped: Counter[str] = field(default_factory=Counter)  # tests by reason
    seconds: float = 0.0

    @property
    def missing(self) -> Counter[str]:
        """Return how many tests did not run because something is not installed, by what they need."""
        return Counter({reason: count for reason, count in self.skipped.items() if reason.startswith(MISSING)})


def run(command: list[str]) -> int:
    """Run a command with this interpreter; return its exit code."""
    return subprocess.run([sys.executable, *command], check=False).returncode


def read(report: Path, result: Result) -> None:
    """Add the tests of a JUnit report to a result. A group that was killed has no report."""
    if not report.exists():
        return
    for case in ET.parse(report).getroot().iter("testcase"):  # noqa: S314 - written by pytest just now
        skipped = case.find("skipped")
        if case.find("failure") is not None or case.find("error") is not None:
            result.failed.append(f"{case.get('classname')}::{case.get('name')}")
        elif skipped is not None:
            result.skipped[skipped.get("message") or "without a reason"] += 1
        else:
            result.passed += 1


def run_group(name: str, command: Sequence[str], arguments: Sequence[str], run: Run = run) -> Result:
    """Run a group with `command`, which is pytest or a program that calls it."""
    began_s, report = time.monotonic(), REPORTS / f"{name.replace(' ', '-')}.xml"
    report.unlink(missing_ok=True)
    result = Result(name, run([*command, *arguments, f"--junit-xml={report}"]))
    read(report, result)
    result.seconds = time.monotonic() - began_s
    return result


def table(results: Sequence[Result]) -> str:
    """Return one line for each group, the names of the failed tests, and why tests did not run."""
    lines = [f"{'group':12}{'passed':>8}{'failed':>8}{'not run':>9}{'seconds':>9}"]
    for each in results:
        failed = str(len(each.failed) or ("yes" if each.code else 0))
        lines.append(f"{each.name:12}{each.passed:>8}{failed:>8}{each.skipped.total():>9}{each.seconds:>9.0f}")
    lines += [f"failed: {test}" for each in results for test in each.failed]
    skipped = sum((each.skipped for each in results), Counter[str]())
    lines += [f"not run: {count} ({reason})" for reason, count in sorted(skipped.items())]
    return "\n".join(lines)


def groups(workers: int, quiet_workers: int) -> list[tuple[str, list[str], list[str]]]:
    """Return the name, the command and the arguments of each group of `make test`."""
    pytest = ["-m", "pytest"]
    pure_tests = [f"tests/unit/{package}" for package in PURE]
    others = [f"--ignore={each}" for each in pure_tests]
    return [
        ("pure", ["-m", "coverage", "run", *pytest], ["--workers", str(quiet_workers), *pure_tests]),
        ("others", pytest, ["--workers", str(workers), "-m", "not quiet and not alone and not long", *others]),
        (
            "quiet",
            pytest,
            ["--workers", str(quiet_workers), "-m", "quiet and not alone and not long", *marked("quiet")],
        ),
        ("alone", pytest, ["-m", "alone and not long", *marked("alone")]),
    ]


def long_groups(workers: int) -> list[tuple[str, list[str], list[str]]]:
    """Return the name, the command and the arguments of each group of `make test-long`."""
    files = marked("long")
    return [
        ("long", ["-m", "pytest"], ["--workers", str(workers), "-m", "long and not alone", *files]),
        ("long alone", ["-m", "pytest"], ["-m", "long and alone", *files]),
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
    return Result("branches", code, passed=int(not code), seconds=time.monotonic() - began_s)


def exit_code(results: Sequence[Result], *, is_ci: bool) -> int:
    """Return 0 if each test passed; in CI each test must also have found what it needs."""
    return int(any(each.code or (is_ci and each.missing) for each in results))


def main() -> int:
    """Run each group of `make test` or `make test-long`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--quiet-workers", type=int, default=2)
    parser.add_argument("--long", action="store_true", help="only the tests marked long")
    parser.add_argument("--branches", action="store_true", help="only check what the last run with coverage took")
    arguments = parser.parse_args()
    if arguments.branches:
        return covered().code
    REPORTS.mkdir(parents=True, exist_ok=True)
    run(["-m", "tests.firmware.build_all"])
    results: list[Result] = []
    selections = (
        long_groups(arguments.quiet_workers) if arguments.long else groups(arguments.workers, arguments.quiet_workers)
    )
    for name, command, selected in selections:
        results.append(run_group(name, command, selected))
        if name == "pure":
            results.append(covered())
    print(table(results), flush=True)
    return exit_code(results, is_ci=os.environ.get("CI") == "true")


if __name__ == "__main__":
    sys.exit(main())
