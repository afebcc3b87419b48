"""Run the tests in groups. Each group runs, also after another one failed; a table at the end shows all results.

`python` (make test) has one group: the tests that need Python and the extra `test` alone, and less than half a second
of CPU each. `all` (make test-all) has every test: the pure packages with their branches counted, all other tests of
Python alone, those that start programs, those that a busy machine disturbs (marked `quiet`), those that need the
machine for themselves (marked `alone`), and the ones that take long (marked `long`). Tests that start programs have one
worker for each core.

Tests whose requirements are missing (`tests/support/requirements.py`) are listed as not run. They fail the run only
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
PYTHON_TESTS = ("tests/unit", "tests/property", "tests/integration")
STARTS_PROGRAMS = re.compile(r"\b(subprocess|tests\.support\.(process|forked_\w+|until_listening|killing)|compilers)\b")
PURE = ("core/protocol", "core/messages", "core/robot", "core/diagnosis")
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


def python_groups(workers: int) -> list[tuple[str, list[str], list[str]]]:
    """Return the name, the command and the arguments of the group of `make test`."""
    unmarked = "not slow and not quiet and not alone and not long"
    selected = ["--workers", str(workers), "--python-only", "-m", unmarked, *PYTHON_TESTS]
    return [("python", ["-m", "pytest"], selected)]


def all_groups(workers: int, cores: int) -> list[tuple[str, list[str], list[str]]]:
    """Return the name, the command and the arguments of each group of `make test-all`."""
    pytest, each_core = ["-m", "pytest"], ["--workers", str(cores)]
    pure_tests = [f"tests/unit/{package}" for package in PURE]
    programs = starting_programs()
    unmarked = "not quiet and not alone and not long"
    others = [f"--ignore={each}" for each in (*pure_tests, *programs)]
    long = marked("long")
    return [
        ("pure", ["-m", "coverage", "run", *pytest], ["--workers", str(workers), *pure_tests]),
        ("others", pytest, ["--workers", str(workers), "-m", unmarked, *PYTHON_TESTS, *others]),
        ("programs", pytest, [*each_core, "-m", unmarked, *programs]),
        ("quiet", pytest, [*each_core, "-m", "quiet and not alone and not long", *marked("quiet")]),
        ("alone", pytest, ["-m", "alone and not long", *marked("alone")]),
        ("long", pytest, [*each_core, "-m", "long and not alone", *long]),
        ("long alone", pytest, ["-m", "long and alone", *long]),
    ]


def starting_programs() -> list[str]:
    """Return the files whose tests start programs: daemons, browsers, boards, compilers, emulators."""
    return sorted(
        str(file)
        for file in Path("tests").rglob("test_*.py")
        if file.parts[1] in ("system", "firmware") or STARTS_PROGRAMS.search(file.read_text())
    )


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
    """Run each group of `make test` or `make test-all`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "selection", choices=("python", "all", "branches"), help="branches: check those of the last run"
    )
    parser.add_argument("--workers", type=int, default=2, help="for tests that start no program")
    arguments = parser.parse_args()
    if arguments.selection == "branches":
        return covered().code
    REPORTS.mkdir(parents=True, exist_ok=True)
    if arguments.selection == "python":
        os.environ.setdefault("HYPOTHESIS_PROFILE", "same")
        selected = python_groups(arguments.workers)
    else:
        run(["-m", "tests.firmware.build_all"])
        selected = all_groups(arguments.workers, os.cpu_count() or 1)
    results: list[Result] = []
    for name, command, arguments_of_group in selected:
        results.append(run_group(name, command, arguments_of_group))
        if name == "pure":
            results.append(covered())
    print(table(results), flush=True)
    if arguments.selection == "python":
        print(
            "make test-all also runs what needs browsers, compilers, emulators and ROS, and what takes long", flush=True
        )
    return exit_code(results, is_ci=os.environ.get("CI") == "true")


if __name__ == "__main__":
    sys.exit(main())
