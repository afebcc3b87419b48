"""Programs in which the firmware and the library for boards test themselves; `make firmware` runs more of them."""

import subprocess

import pytest

from tests.firmware.boards import build_native


@pytest.mark.parametrize("program", ["due_test", "rosserial_test", "links_test"])
def test_native_program_finds_no_failure(program: str) -> None:
    done = subprocess.run([build_native() / program], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr
