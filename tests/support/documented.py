"""The commands that the documents name, and whether the command line's own parser accepts them."""

import functools
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, cast

import typer

from hostlink.cli.main import COMMANDS, build_app, translated

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted([*(ROOT / "docs").glob("*.md"), ROOT / "README.md", ROOT / "firmware" / "README.md"])
FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"^    (?!\s).*$", re.MULTILINE)
INLINE = re.compile(r"(?<!`)`(?:[^`\n]*bin/)?hostlink ([^`\n]+)`(?!`)")
ENDS = {"|", "||", "&&", ";", ">", ">>", "&", "2>&1", "<", "tee"}
SHELL = {"", "sh", "bash", "console", "shell"}

UsageError = cast(type[Exception], typer.BadParameter.__base__)


class Documented(NamedTuple):
    """A command as a document has it; in a block of code it is complete, in a sentence it need not be."""

    document: str
    words: tuple[str, ...]
    is_complete: bool

    def complaint(self) -> str:
        """Complaint of the parser; empty if it accepts the command."""
        name, *arguments = translated(self.words)
        if name.startswith("-"):
            return ""
        if name not in COMMANDS:
            return f"no command {name}"
        return _complaint(parser(name), name, arguments, is_complete=self.is_complete)


@functools.cache
def parser(name: str) -> Any:
    """Return the parser of one command."""
    return cast(Any, typer.main.get_command(build_app(name))).commands[name]


def _complaint(found: Any, name: str, arguments: list[str], *, is_complete: bool) -> str:
    if hasattr(found, "commands") and arguments and not arguments[0].startswith("-"):
        first, *rest = arguments
        inner = found.commands.get(first)
        return (
            f"no command {name} {first}" if inner is None else _complaint(inner, first, rest, is_complete=is_complete)
        )
    try:
        found.make_context(name, list(arguments))
    except UsageError as error:
        has_gaps = "MissingParameter" in type(error).__name__ or "requires an argument" in str(error)
        has_names = any(word.isupper() for word in arguments)  # that stand for a value, as LINK for a number
        return "" if not is_complete and (has_gaps or has_names) else str(error)
    except typer.Exit:
        return ""
    return ""


def documented() -> Iterator[Documented]:
    """Every command of every document."""
    for path in DOCUMENTS:
        text = path.read_text()
        name = str(path.relative_to(ROOT))
        for language, block in FENCED.findall(text):
            if language in SHELL:
                lines = block.splitlines()
                typed = [line for line in lines if line.startswith("$ ")] if language == "console" else lines
                yield from _in_code(name, "\n".join(typed))
        prose = FENCED.sub("", text)
        for line in INDENTED.findall(prose):
            yield from _in_code(name, line)
        for words in INLINE.findall(prose):
            yield from _command(name, words, is_complete=False)


def _in_code(document: str, block: str) -> Iterator[Documented]:
    for line in block.splitlines():
        for part in re.split(r"&&|\|\|?|;", line.partition("  #")[0]):
            found = re.search(r"(?:^|bin/|\s)hostlink (?=[a-z-])(.*)", part)
            if found and part[: found.start()].split() in ([], ["$"], ["sudo"], [".venv/"], ["robots/"]):
                yield from _command(document, found.group(1), is_complete=True)


def _command(document: str, text: str, *, is_complete: bool) -> Iterator[Documented]:
    """Yield the command up to its end, without placeholders: [OPTIONAL], `...`."""
    try:
        words = shlex.split(text, comments=True)
    except ValueError:
        return
    kept: list[str] = []
    for word in words:
        if word in ENDS or word.startswith((">", "|")):
            break
        if not word.startswith(("[", "...", "…")):
            kept.append(word.rstrip(";,:"))
    if kept:
        yield Documented(document, tuple(kept), is_complete)
