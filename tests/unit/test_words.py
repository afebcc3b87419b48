"""Plain English in docstrings, comments, errors and test names of the whole tree."""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
PLACES = ("hostlink", "tools")
TEST_PLACES = ("tests",)

NO_SUBJECT = re.compile(
    r"(It|Its|They|Their|Those|These|This|He|His|Who|Whose|Whoever|What|Whatever|Which|When|Where|Why|How|Nobody|Nothing"
    r"|Somebody|Of|As|By|To|Also|None:)\b|The same\b"
)
AVOIDED = re.compile(
    r"\b(whoever|nobody|somebody|whatever|elsewhere|beside|any more|stands|comes|goes"
    r"|(?<![Tt]here )(?:is|are) (?:no(?! longer)|none))\b"
)
AVOIDED_IN_NAME = re.compile(
    r"^test_(it|they|what|who|whoever|whose|where|which|how|nobody|nothing|nor)_"
    r"|_(whoever|nobodys?|somebodys?|whatever|elsewhere|any_more|comes|goes|(that|which|who)_(is|are)_none"
    r"|(is|are)_no(?!_longer))(_|$)"
)
QUOTED = re.compile(r"`[^`]*`|\"[^\"]*\"")
COMMENT = re.compile(r"(?:^|  )# (.*)")


class Passage(NamedTuple):
    """Text with its place, "path:line"."""

    place: str
    text: str


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield all statements in a node: several times as fast as ast.walk, which yields expressions too."""
    for block in ("body", "handlers", "orelse", "finalbody", "cases"):
        for child in getattr(node, block, ()):
            yield child
            yield from statements(child)


@dataclass(frozen=True)
class Passages:
    """Texts of some files, by kind."""

    docstrings: list[Passage] = field(default_factory=list)
    comments: list[Passage] = field(default_factory=list)
    errors: list[Passage] = field(default_factory=list)
    tests: list[Passage] = field(default_factory=list)

    def add(self, path: str, source: str) -> None:
        """Add the texts of a Python file."""
        for number, line in enumerate(source.splitlines(), 1):
            if found := COMMENT.search(line):
                self.comments.append(Passage(f"{path}:{number}", found[1]))
        module = ast.parse(source)
        for node in (module, *statements(module)):
            if isinstance(node, ast.Raise):
                texts = (part.value for part in ast.walk(node) if isinstance(part, ast.Constant))
                self.errors.extend(Passage(f"{path}:{node.lineno}", text) for text in texts if isinstance(text, str))
            elif isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                if (text := ast.get_docstring(node)) is not None:
                    self.docstrings.append(Passage(f"{path}:{node.body[0].lineno}", text))
                if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_"):
                    self.tests.append(Passage(f"{path}:{node.lineno}", node.name))


@cache
def passages(places: tuple[str, ...]) -> Passages:
    """Return the texts of the Python files in these folders or of these patterns."""
    found = Passages()
    for place in places:
        for file in sorted((ROOT / place).rglob("*.py") if (ROOT / place).is_dir() else ROOT.glob(place)):
            found.add(str(file.relative_to(ROOT)), file.read_text())
    return found


def subjectless(text: str) -> bool:
    """Whether a docstring begins without a named subject or an imperative."""
    return NO_SUBJECT.match(text) is not None


def avoided(text: str) -> str:
    """Return the first avoided word outside quotes and backticks; empty without one."""
    found = AVOIDED.search(QUOTED.sub("", text))
    return found[0] if found else ""


@pytest.mark.slow
@pytest.mark.parametrize("places", [PLACES, TEST_PLACES], ids=["code", "tests"])
def test_docstring_names_its_subject(places: tuple[str, ...]) -> None:
    assert [each for each in passages(places).docstrings if subjectless(each.text)] == []


@pytest.mark.parametrize("places", [PLACES, TEST_PLACES], ids=["code", "tests"])
def test_docstrings_comments_and_errors_have_no_avoided_word(places: tuple[str, ...]) -> None:
    found = passages(places)
    assert [each for each in (*found.docstrings, *found.comments, *found.errors) if avoided(each.text)] == []


def test_test_name_has_a_subject_and_no_avoided_word() -> None:
    assert [each for each in passages(TEST_PLACES).tests if AVOIDED_IN_NAME.search(each.text)] == []


@pytest.mark.parametrize(
    ("text", "is_found"),
    [
        ("Whose it is.", True),
        ("The same elsewhere.", True),
        ("What is left of it.", True),
        ("run.txt is no MCAP file", True),
        ("Return None if there is no file; the link is no longer open.", False),
        ("Name of the robot that the channel belongs to; empty if none.", False),
        ("Whether any frame is queued.", False),
    ],
)
def test_riddle_in_a_docstring_is_found(text: str, is_found: bool) -> None:
    assert (subjectless(text) or bool(avoided(text))) is is_found


@pytest.mark.parametrize(
    ("name", "is_found"),
    [
        ("test_nobody_comes", True),
        ("test_what_is_one", True),
        ("test_doctor_without_device_reports_no_device", False),
    ],
)
def test_riddle_in_a_test_name_is_found(name: str, is_found: bool) -> None:
    assert bool(AVOIDED_IN_NAME.search(name)) is is_found
