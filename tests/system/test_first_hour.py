"""docs/first-hour.md, typed into a terminal as a newcomer does."""

import asyncio
import re
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.support.process import free_port
from tests.support.screen import Screen, screen

pytestmark = [pytest.mark.quiet, pytest.mark.long]

DOCUMENT = Path(__file__).parents[2] / "docs" / "first-hour.md"
VENV = Path(sys.executable).parents[1]
PATIENCE_S = 20.0
POLL_S = 0.05
BLOCK = re.compile(r"^```console\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass
class Typed:
    """One command, what must show, and the keys that end it."""

    command: str
    shown: list[str] = field(default_factory=list)
    keys: list[str] = field(default_factory=list)

    def is_shown(self, text: str) -> bool:
        """Whether every line of it is there, in this order."""
        pattern = ".*?".join(re.escape(part) for part in re.split(r"(?:\.\.\.|\s)+", "\n".join(self.shown)) if part)
        return re.search(pattern, text, re.DOTALL) is not None


def transcript(document: str) -> Iterator[Typed]:
    """The commands of a document, in their order."""
    for block in BLOCK.findall(document):
        typed: Typed | None = None
        for line in block.splitlines():
            if line.startswith("$ "):
                if typed is not None:
                    yield typed
                typed = Typed(line.removeprefix("$ "))
            elif typed is not None:
                (typed.keys if line.startswith("^") else typed.shown).append(line)
        if typed is not None:
            yield typed


class Shell:
    """
    A shell in a terminal.

    Its prompt has the number of the next command: none is taken for the one before. It begins a line: after an answer
    without a line end the terminal would break it in two.
    """

    def __init__(self, terminal: Screen) -> None:
        self._terminal, self._number = terminal, 1

    @property
    def prompt(self) -> str:
        """End of the prompt; a venv writes its name before it."""
        return f"newcomer {self._number}>"

    async def begin(self, folder: Path, url: str) -> None:
        """In a folder with the venv, as `make demo` leaves one, and records of its own."""
        names = f"XDG_STATE_HOME={folder} HOSTLINK_URL={url}"
        await self._type(f"PS1='\\nnewcomer \\#> '; cd {folder}; export {names}")
        await self._terminal.shows(self.prompt)

    async def run(self, typed: Typed, command: str, *, ends: bool = True) -> None:
        """Type a command, compare what it shows, and wait for the prompt."""
        await self._type(f"clear; {command}")
        await self._shows(typed, is_prompt=ends and not typed.keys)
        for key in typed.keys:
            await self._terminal.keys(key.replace("^", "C-"))
            await self._shows(Typed(command), is_prompt=True)

    async def interrupt(self) -> None:
        """Ctrl-C, and the prompt."""
        await self._terminal.keys("C-c")
        await self._terminal.shows(self.prompt)

    async def _type(self, line: str) -> None:
        await self._terminal.keys("-l", line)
        await self._terminal.keys("Enter")
        self._number += 1

    async def _shows(self, typed: Typed, *, is_prompt: bool) -> None:
        """Wait for what a command shows, and for its end."""
        deadline_s, observed = time.monotonic() + PATIENCE_S, ""
        while time.monotonic() < deadline_s:
            observed = (await self._terminal.text()).rstrip()
            if typed.is_shown(observed) and (not is_prompt or observed.endswith(self.prompt)):
                return
            await asyncio.sleep(POLL_S)
        raise AssertionError(f"$ {typed.command}\n{observed}\ninstead of\n" + "\n".join(typed.shown))


async def test_a_newcomer_sees_what_the_document_says(tmp_path: Path) -> None:
    first, *others = transcript(DOCUMENT.read_text())
    assert len(others) >= 20
    (tmp_path / ".venv").symlink_to(VENV)
    api = f"127.0.0.1:{free_port()}"
    async with screen(columns=160, rows=50) as one, screen(columns=160, rows=50) as other:
        daemon, shell = Shell(one), Shell(other)
        await daemon.begin(tmp_path, f"http://{api}")
        await shell.begin(tmp_path, f"http://{api}")
        assert first.command == "make demo"
        first.shown[0] = first.shown[0].replace("127.0.0.1:9090", api)
        await daemon.run(first, f".venv/bin/hostlink demo --listen 127.0.0.1:0 --api {api}", ends=False)
        for typed in others:
            command = typed.command.replace("http://127.0.0.1:9090", f"http://{api}")
            await shell.run(typed, command.replace("connect_blocking()", f'connect_blocking("{api}")'))
        await daemon.interrupt()
