"""Which command a line means, typed or to be completed."""

import pytest

from hostlink.cli.main import COMMANDS, completed_words, wanted_command


@pytest.mark.parametrize(
    ("words", "wanted"),
    [(["echo", "/type"], "echo"), (["--debug", "params", "list"], "params"), (["--help"], None), ([], None)],
)
def test_the_first_name_of_a_command_is_meant(words: list[str], wanted: str | None) -> None:
    assert wanted_command(words) == wanted


@pytest.mark.parametrize(
    ("environment", "words"),
    [
        ({}, []),
        ({"COMP_WORDS": "hostlink echo /rob"}, []),
        ({"_HOSTLINK_COMPLETE": "complete_bash", "COMP_WORDS": "hostlink echo /rob"}, ["echo", "/rob"]),
        ({"_HOSTLINK_COMPLETE": "complete_zsh", "_TYPER_COMPLETE_ARGS": "hostlink pub /x '{"}, ["pub", "/x", "'{"]),
        ({"_HOSTLINK_COMPLETE": "complete_fish", "_TYPER_COMPLETE_ARGS": "hostlink ec"}, ["ec"]),
    ],
)
def test_the_words_that_a_shell_completes(environment: dict[str, str], words: list[str]) -> None:
    assert completed_words(environment) == words


def test_every_command_has_a_line_that_fits_a_terminal() -> None:
    assert len(COMMANDS) > 20
    assert all(text.endswith(".") and len(text) <= 86 for text in COMMANDS.values())
