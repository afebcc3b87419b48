"""References between documents and code: documents, sections, functions, tests, constants, log events."""

import ast
import functools
import os
import re
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from hostlink.core.runtime import logs

ROOT = Path(__file__).parents[2]
FOLDERS = ("docs", "firmware", "hostlink", "tests", "tools")
NOT_OURS = {"node_modules", "__pycache__", "build", "built", "reference"}
SUFFIXES = {".c", ".cpp", ".h", ".ino", ".md", ".mjs", ".py", ".sh", ".toml", ".ts"}
NAMED = re.compile(r"(?<![\w./-])((?:[\w.-]+/)*[\w.-]+\.md)\b(?:#([\w-]+))?")
LINKED = re.compile(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]+))?\)")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def sources() -> Iterator[Path]:
    """Return documents and code, without files of builds or npm."""
    yield from ROOT.glob("*.md")
    for folder in FOLDERS:
        for where, folders, names in os.walk(ROOT / folder):
            folders[:] = [name for name in folders if name not in NOT_OURS and not name.startswith(".")]
            yield from (Path(where, name) for name in names if Path(name).suffix in SUFFIXES)


def sections(text: str) -> frozenset[str]:
    """Return the headings of a document, as links spell them."""
    headings = HEADING.findall(FENCED.sub("", text))
    return frozenset(re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings)


@functools.cache
def sections_of(document: Path) -> frozenset[str]:
    return sections(document.read_text())


def unknown_documents(text: str, *, folder: Path) -> Iterator[str]:
    """Return documents that a text in this folder names and that do not exist."""
    for name, section in NAMED.findall(text):
        places = [place / name for place in (folder, ROOT, ROOT / "docs") if (place / name).is_file()]
        if not any(not section or section in sections_of(place) for place in places):
            yield f"{name}#{section}" if section else name


def broken_links(text: str, *, folder: Path) -> Iterator[str]:
    """Return link targets of a document in this folder that do not exist, except documents."""
    for name, section in LINKED.findall(text):
        if name and not name.endswith(".md") and not (folder / name).exists():
            yield name
        if not name and section not in sections(text):
            yield f"#{section}"


def missing(file: Path) -> list[str]:
    text, folder = file.read_text(), file.parent
    links = broken_links(text, folder=folder) if file.suffix == ".md" else ()
    return [*unknown_documents(text, folder=folder), *links]


@pytest.mark.slow
def test_every_document_that_is_named_exists_and_has_the_section() -> None:
    files = [file for file in sources() if file != Path(__file__)]
    assert len(files) > 300
    assert {str(file): missing(file) for file in files if missing(file)} == {}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("# docs/api.md", []),
        ("# docs/api.md#rest: all of it", []),
        ("[the page](page.md#the-stop)", []),
        ("# GONE.md: a number", ["GONE.md"]),
        ("# docs/api.md#gone", ["docs/api.md#gone"]),
        ("[the page](page.md#gone)", ["page.md#gone"]),
        ("https://example.org/gone.md, and info.md5", []),
    ],
)
def test_missing_document_is_found(text: str, found: list[str]) -> None:
    assert list(unknown_documents(text, folder=ROOT / "docs")) == found


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("[a picture](page.png), [below](#below), [elsewhere](https://example.org/gone.png)\n\n## Below\n", []),
        ("[a picture](gone.png)", ["gone.png"]),
        ("```\n# Below\n```\n[below](#below)", ["#below"]),
    ],
)
def test_broken_link_is_found(text: str, found: list[str]) -> None:
    assert list(broken_links(text, folder=ROOT / "docs")) == found


INSTALLED = re.compile(r"""\b(?:pip3?|pipx|uv tool|uv pip|runpip \S+) install\b([^`\n#&|;]*)""")
OF_AN_INDEX = re.compile(r"""(?<![\w./-])hostlink(?=$|[\s'",)\[=<>~!])""")


def installed_from_an_index(text: str) -> list[str]:
    """Return commands that would install hostlink from a package index, where the name may belong to a stranger."""
    return [found[0].strip() for found in INSTALLED.finditer(text) if OF_AN_INDEX.search(found[1])]


def test_no_command_installs_hostlink_by_its_name_from_an_index() -> None:
    files = [file for file in (*sources(), ROOT / "Makefile") if file not in (Path(__file__), ROOT / "CHANGELOG.md")]
    found = {str(file): installed_from_an_index(file.read_text()) for file in files}
    assert {file: commands for file, commands in found.items() if commands} == {}


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("pip install hostlink", 1),
        ("robots/bin/pip install hostlink && robots/bin/hostlink ros2", 1),
        ("pip install 'hostlink[zenoh]'", 1),
        ('python -m pip install "hostlink>=0.1"', 1),
        ("pipx runpip hostlink install 'hostlink[plot]'", 1),
        ("pip install ros-rclpy hostlink", 1),
        ("pip install . && hostlink demo", 0),
        ("pip install '.[zenoh]' # hostlink", 0),
        ("pipx install hostlink-0.1.0-py3-none-any.whl", 0),
        ("pipx runpip hostlink install './hostlink-0.1.0-py3-none-any.whl[plot]'", 0),
        ("pip install /opt/hostlink", 0),
    ],
)
def test_command_that_installs_the_name_is_found(text: str, count: int) -> None:
    assert len(installed_from_an_index(text)) == count


WAY = re.compile(r"^\| `(hostlink/[\w/]+\.py)` \| `([\w.]+)` \|", re.MULTILINE)


def ways(text: str) -> list[list[tuple[str, str]]]:
    """Return the tables of files and functions of "Three ways through the code"."""
    section = text.partition("## Three ways through the code")[2].partition("\n## ")[0]
    return [found for table in section.split("\n\n") if (found := WAY.findall(table))]


def test_ways_through_the_code_name_functions_that_exist_and_no_file_twice() -> None:
    all_ways = ways((ROOT / "CONTRIBUTING.md").read_text())
    assert len(all_ways) == 3
    for way in all_ways:
        assert len({file for file, _ in way}) == len(way) > 4
        for file, function in way:
            owner, _, name = function.partition(".")
            tree = ast.parse((ROOT / file).read_text())
            found = next(each for each in tree.body if isinstance(each, ast.ClassDef) and each.name == owner)
            methods = {each.name for each in found.body if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef)}
            assert name in methods, f"{file}: {function}"


TEST_FILE = re.compile(r"`((?:firmware|integration|property|system|unit)/[\w/]*test_\w+\.py)`")
SECONDS = re.compile(r"`([A-Z][A-Z_]+_S)`")


def test_every_test_that_the_promises_name_exists() -> None:
    named = TEST_FILE.findall((ROOT / "docs/reliability.md").read_text())
    assert len(named) > 100
    assert [name for name in named if not (ROOT / "tests" / name).is_file()] == []


def test_every_constant_that_the_documents_name_exists() -> None:
    named = {name for file in ROOT.glob("docs/*.md") for name in SECONDS.findall(file.read_text())}
    code = "\n".join(file.read_text() for file in [ROOT / "Makefile", *ROOT.glob("hostlink/**/*.py")])
    assert len(named) > 5
    assert [name for name in named if not re.search(rf"^{name}\b.* \??= ", code, re.MULTILINE)] == []


LOGGED = re.compile(r"""\blog\.(?:debug|info|warning|error|exception)\(\s*"([\w.]+)\"""")


def test_every_event_of_the_log_is_in_its_list() -> None:
    listed = set(re.findall(r"\b\w+\.\w+\b", logs.__doc__ or ""))
    for component in entry_points(group="hostlink.components"):  # these list their own
        listed |= component.load().log_events.keys()
    logged = {event for file in ROOT.glob("hostlink/**/*.py") for event in LOGGED.findall(file.read_text())}
    assert len(logged) > 50
    assert logged - listed == set()
