"""Run pytest; the few tests that failed are run once more by themselves, and named.

A test with processes and times in it can fail because others, or other guests of the machine, have the processor. A
defect fails again. What failed first is printed whole, and named at the end: somebody has to find out which it was.
"""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

MOST = 3  # more than that is no accident
TESTS_FAILED = 1  # pytest's exit code; others are errors of the call or of pytest itself
LAST_FAILED = Path(".pytest_cache/v/cache/lastfailed")


def failed_tests() -> list[str]:
    """Node ids of what failed last, as pytest keeps them."""
    return sorted(json.loads(LAST_FAILED.read_text())) if LAST_FAILED.exists() else []


def pytest(arguments: list[str]) -> int:
    """Run it here; its exit code."""
    return subprocess.run([sys.executable, "-m", "pytest", *arguments], check=False).returncode


def run_tests(arguments: list[str], run: Callable[[list[str]], int] = pytest) -> int:
    """Exit code 0 if each test passed, at the latest alone."""
    LAST_FAILED.unlink(missing_ok=True)
    code = run(arguments)
    failed = failed_tests()
    if code != TESTS_FAILED or not 1 <= len(failed) <= MOST:
        return code
    print(f"run again alone: {', '.join(failed)}", flush=True)
    code = run(failed)
    if code == 0:
        print(f"passed only when run again, to be looked at: {', '.join(failed)}", flush=True)
    return code


if __name__ == "__main__":
    sys.exit(run_tests(sys.argv[1:]))
