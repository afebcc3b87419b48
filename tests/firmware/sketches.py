"""The examples of firmware/rosserial and sketches of ros_lib as processes, on a board without hardware.

All of them are one program: each in a namespace of its own, which saves compiling the same headers for each.
"""

import asyncio
import contextlib
import re
from collections.abc import AsyncIterator, Iterable
from functools import cache
from pathlib import Path

from tests.firmware.due import ROOT, ROSSERIAL
from tests.firmware.examples import BUILD, EXAMPLES, compile_sketch, sources
from tests.support.compilers import SANITIZERS, SKETCH, run
from tests.support.once import once
from tests.support.precedence import GOES_FIRST
from tests.support.waiting import expect

BOARD = ROOT / "firmware" / "host" / "any_board"
MOVED = ROOT / "firmware" / "tests" / "ros_lib_sketches"
KEY = "0123456789abcdefghijklmnopqrstuv"
WITH_KEY = "wifi with a key"
NO_KEY = 'kKey[] = ""'
_OF_TCP = "#define ROSSERIAL_ARDUINO_TCP"  # decides the content of ros.h: a separate program
_INCLUDE = re.compile(r"^#include .*(?<!WProgram\.h>)$", re.MULTILINE)
_COMPILER = ["g++", *SANITIZERS, f"-I{BOARD}", "-O0"]


def _sketches() -> dict[str, Path]:
    """Sketches by name: "pubsub", "ros_lib/pubsub"."""
    examples = {path.name: path / f"{path.name}.ino" for path in sorted(EXAMPLES.iterdir())}
    return examples | {f"ros_lib/{path.stem}": path for path in sorted(MOVED.glob("*.ino"))}


def _is_of_tcp(path: Path) -> bool:
    return _OF_TCP in path.read_text()


@cache
def build(name: str) -> Path:
    """The program with this sketch, compiled with sanitizers."""
    once("sketches", _compile, BUILD / "sketches")
    path = _sketches().get(name)
    return BUILD / ("sketches_tcp" if path is not None and _is_of_tcp(path) else "sketches")


def _compile() -> None:
    folder = BUILD / "objects"
    folder.mkdir(parents=True, exist_ok=True)
    for source in [*sources(), *sorted(BOARD.glob("*.cpp"))]:
        options = [*_COMPILER, *SKETCH, f"-I{ROSSERIAL}"]
        run([*options, "-c", source, "-o", folder / f"{source.stem}.o"])
    texts = {name: path.read_text() for name, path in _sketches().items()}
    texts[WITH_KEY] = texts["wifi"].replace(NO_KEY, f'kKey[] = "{KEY}"')
    assert texts[WITH_KEY] != texts["wifi"]
    of_tcp = {name for name, text in texts.items() if _OF_TCP in text}
    _link("sketches", {name: text for name, text in texts.items() if name not in of_tcp})
    _link("sketches_tcp", {name: texts[name] for name in of_tcp})


def _link(program: str, texts: dict[str, str]) -> None:
    source, compiled = BUILD / f"{program}.cpp", BUILD / f"{program}.o"
    source.write_text(_source(texts))
    compile_sketch(source, compiled, _COMPILER)
    run(["g++", *SANITIZERS, compiled, *sorted((BUILD / "objects").glob("*.o")), "-o", BUILD / program])


def _source(texts: dict[str, str]) -> str:
    """Include every header first, outside of the namespaces, so that none is read a second time."""
    includes = sorted({line for text in texts.values() for line in _INCLUDE.findall(text)})
    define = [_OF_TCP] if any(_OF_TCP in text for text in texts.values()) else []
    numbered = list(enumerate(texts.items()))
    parts = [f'namespace s{number} {{\n#line 1 "{name}.ino"\n{text}}}\n' for number, (name, text) in numbered]
    rows = [f'{{"{name}", &s{number}::setup, &s{number}::loop}},' for number, (name, _) in numbered]
    table = [
        '#include "sketches.h"',
        "const Sketch kSketches[] = {",
        *rows,
        "};",
        f"const int kSketchCount = {len(rows)};",
    ]
    return "\n".join([*define, *includes, *parts, *table, ""])


class Board:
    """A running sketch: values of its outputs, in order."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.outputs: list[str] = []
        self._process = process

    def set(self, line: str) -> None:
        """Set an input: "digital 7 0", "analog 100 512", "pulse 8 5831", "register 59 64"."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n".encode())

    def last(self, pin: str) -> str:
        """Values of an output such as "analog 5"; empty: it was never set."""
        return next((line for line in reversed(self.outputs) if line.startswith(f"{pin} ")), "")

    async def expect(self, line: str) -> None:
        """Wait until an output has this value."""
        pin = line.rpartition(" ")[0]
        await expect(lambda: self.last(pin) == line, timeout_s=10.0)

    async def listen(self) -> None:
        assert self._process.stdout is not None
        while line := await self._process.stdout.readline():
            self.outputs.append(line.decode().strip())


@contextlib.asynccontextmanager
async def running(name: str, address: tuple[str, int], serial_port: int | None = None) -> AsyncIterator[Board]:
    """A sketch that is connected to a host until the end of the block. A finding of a sanitizer fails the block.

    `serial_port`: port of another board for its Serial; None: its Serial is connected to the host too.
    """
    ports: Iterable[int] = (address[1],) if serial_port is None else (address[1], serial_port)
    async with started(build(name), name, address[0], *ports) as board:
        yield board


@contextlib.asynccontextmanager
async def started(*command: object) -> AsyncIterator[Board]:
    """A board as a process. Its end before that of the block is an error."""
    pipe = asyncio.subprocess.PIPE
    words = [*GOES_FIRST, *(str(word) for word in command)]
    process = await asyncio.create_subprocess_exec(*words, stdin=pipe, stdout=pipe, stderr=pipe)
    board = Board(process)
    try:
        async with asyncio.TaskGroup() as tasks:
            listening = tasks.create_task(board.listen())
            yield board
            assert process.returncode is None, (await process.communicate())[1]
            listening.cancel()
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()
