"""Snippets of the documents: Python compiles and uses existing names, and settings are accepted."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import hostlink.client
import hostlink.core.host
from hostlink.cli.settings import load

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted([*(ROOT / "docs").glob("*.md"), ROOT / "README.md"])
FENCED = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
CLASSES = {"host": "Host", "robot": "Robot", "messages": "Mailbox", "stream": "Stream"}
CORE = {"host": "Host", "robot": "RobotState"}
BLOCKING = {"host": "BlockingHost", "robot": "BlockingRobot", "messages": "Messages", "stream": "Stream"}


def snippets(language: str) -> Iterator[tuple[str, str]]:
    for path in DOCUMENTS:
        for found, text in FENCED.findall(path.read_text()):
            if found == language:
                yield f"{path.name}: {text.splitlines()[0]}", text


def is_member(kind: type, name: str) -> bool:
    return hasattr(kind, name) or name in getattr(kind, "__annotations__", ())


def unknown_names(code: str) -> list[str]:
    """Return names of hostlink.client, of a host or of a robot that a snippet uses and that do not exist."""
    tree = compile(code, "snippet", "exec", ast.PyCF_ONLY_AST | ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
    is_core = "hostlink.core.host" in code
    classes = CORE if is_core else BLOCKING if "connect_blocking" in code else CLASSES
    module = hostlink.core.host if is_core else hostlink.client
    wrong = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.Attribute):
            continue
        owner = ast.unparse(node.value)
        if owner == "hostlink.client" and not hasattr(hostlink.client, node.attr):
            wrong.append(f"{owner}.{node.attr}")
        if owner in classes and not is_member(getattr(module, classes[owner]), node.attr):
            wrong.append(f"{owner}.{node.attr}")
    return wrong


@pytest.mark.parametrize(("name", "code"), list(snippets("python")))
def test_python_compiles_and_uses_what_exists(name: str, code: str) -> None:
    assert unknown_names(code) == [], name


@pytest.mark.parametrize(("name", "text"), list(snippets("toml")))
def test_settings_are_accepted(name: str, text: str, tmp_path: Path) -> None:
    (tmp_path / "hostlink.toml").write_text(text)
    load(tmp_path / "hostlink.toml")


def test_wrong_snippet_is_found() -> None:
    assert unknown_names("async with hostlink.client.conect() as host: await host.robotz()") == [
        "hostlink.client.conect",
        "host.robotz",
    ]
    with pytest.raises(SyntaxError):
        unknown_names("robot.drive(0.2")
