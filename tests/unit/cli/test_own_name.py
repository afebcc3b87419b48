"""own_name: how a user starts the program that runs."""

from pathlib import Path

import pytest

from hostlink.cli.own_name import own_name


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A clone with a program in its environment, which no shell finds."""
    program = tmp_path / "my clone" / ".venv" / "bin" / "hostlink"
    program.parent.mkdir(parents=True)
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    return program.parents[2]


def test_program_of_a_clone_is_started_by_its_path(clone: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    assert own_name(".venv/bin/hostlink", clone) == ".venv/bin/hostlink"
    assert own_name(str(clone / ".venv/bin/hostlink"), clone) == ".venv/bin/hostlink"
    elsewhere = own_name(str(clone / ".venv/bin/hostlink"), clone.parent / "other")
    assert elsewhere == f"'{clone}/.venv/bin/hostlink'"


def test_program_that_the_shell_finds_is_started_by_its_name(clone: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(clone / ".venv/bin"))
    assert own_name(str(clone / ".venv/bin/hostlink"), clone) == "hostlink"


def test_program_of_another_name_is_called_hostlink(clone: Path) -> None:
    """`python -m hostlink` has the path of a module."""
    assert own_name(str(clone / "hostlink" / "__main__.py"), clone) == "hostlink"
    assert own_name("hostlink", clone) == "hostlink"
