"""tests/support/workers.py: forked processes run each test once, and the death of one fails the test that it ran."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
NOTING = """
import os, pathlib, pytest
def note(name):
    with open("ran", "a") as file:
        file.write(f"{name} {os.environ['PYTEST_WORKER']}\\n")
"""


def run(folder: Path, *options: str) -> tuple[str, list[list[str]]]:
    """Return what pytest printed, and the name and the worker of each test that ran."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.support.workers", "-p", "no:cacheprovider", *options]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=100
    )
    ran = folder / "ran"
    return done.stdout + done.stderr, [each.split() for each in ran.read_text().splitlines()] if ran.exists() else []


@pytest.mark.slow
def test_tests_run_once_in_two_processes_and_each_result_is_reported(tmp_path: Path) -> None:
    (tmp_path / "test_some.py").write_text(f"""{NOTING}
@pytest.fixture(scope="module", autouse=True)
def shared():
    yield
    note("end")

@pytest.mark.parametrize("number", range(20))
def test_good(number):
    note(number)

def test_bad():
    print("seen")
    raise ValueError("said")

@pytest.mark.skip(reason="not here")
def test_absent(): pass
""")
    text, ran = run(tmp_path, "--workers", "2", "-rs")
    assert "1 failed, 20 passed, 1 skipped" in text
    assert "ValueError: said" in text
    assert "seen" in text
    assert "not here" in text
    assert sorted(int(name) for name, _ in ran if name != "end") == list(range(20))
    assert sorted(worker for name, worker in ran if name == "end") == ["0", "1"]  # each tears its fixtures down


@pytest.mark.slow
def test_tests_of_a_file_that_shares_run_in_order_in_one_worker(tmp_path: Path) -> None:
    (tmp_path / "test_words.py").write_text(f"""{NOTING}
@pytest.mark.parametrize("number", range(20))
def test_good(number):
    note(number)
""")
    (tmp_path / "test_other.py").write_text("def test_other(): pass")
    _, ran = run(tmp_path, "--workers", "3")
    assert [int(name) for name, _ in ran] == list(range(20))
    assert len({worker for _, worker in ran}) == 1


@pytest.mark.slow
def test_worker_that_dies_fails_its_test_and_another_worker_runs_the_rest(tmp_path: Path) -> None:
    (tmp_path / "test_some.py").write_text(f"""{NOTING}
@pytest.mark.parametrize("number", range(20))
def test_some(number):
    if number in (3, 4):
        os.kill(os.getpid(), 9)
    note(number)
""")
    text, ran = run(tmp_path, "--workers", "2")
    assert "2 failed, 18 passed" in text
    assert "the worker ended with status -9 while it ran this test" in text
    assert sorted(int(name) for name, _ in ran) == [number for number in range(20) if number not in (3, 4)]


@pytest.mark.slow
def test_first_failure_ends_the_run_when_asked_and_a_broken_file_runs_nothing(tmp_path: Path) -> None:
    (tmp_path / "test_some.py").write_text(f"""{NOTING}
import time
def test_bad(): raise ValueError
@pytest.mark.parametrize("number", range(50))
def test_slow(number):
    time.sleep(0.1)
    note(number)
""")
    text, ran = run(tmp_path, "--workers", "2", "-x")
    assert "1 failed" in text
    assert len(ran) < 50
    (tmp_path / "test_broken.py").write_text("raise ValueError('broken')")
    (tmp_path / "ran").unlink(missing_ok=True)
    text, ran = run(tmp_path, "--workers", "2")
    assert "1 error during collection" in text
    assert ran == []
