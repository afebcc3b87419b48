"""Every `hostlink ...` of the documents is one that the command line accepts."""

import pytest

from hostlink.cli.main import COMMANDS
from tests.support.documented import Documented, documented


@pytest.mark.slow
def test_every_documented_command_is_accepted_by_the_parser() -> None:
    found = set(documented())
    assert len(found) > 180
    wrong = {each: each.complaint() for each in found}
    assert {each: complaint for each, complaint in wrong.items() if complaint} == {}


def test_every_command_is_documented() -> None:
    assert set(COMMANDS) <= {each.words[0] for each in documented()}


@pytest.mark.parametrize(
    ("words", "is_complete", "complaint"),
    [
        ("robots --jsn", True, "--jsn"),
        ("robts", False, "robts"),
        ("echo", True, "topic"),
        ("echo", False, ""),
        ("hz /t --seconds soon", True, "valid"),
        ("params lst", False, "lst"),
        ("params get --nothing", False, "--nothing"),
        ("capture LINK", False, ""),
        ("capture LINK", True, "valid"),
        ("serve --ros1", False, ""),
        ("serve --ros1", True, "argument"),
    ],
)
def test_a_wrong_command_is_found(words: str, is_complete: bool, complaint: str) -> None:
    found = Documented("a document", tuple(words.split()), is_complete).complaint()
    assert complaint in found if complaint else found == ""
