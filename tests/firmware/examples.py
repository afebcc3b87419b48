"""The examples of firmware/rosserial, and the headers that a board's compiler needs for them."""

from functools import cache
from pathlib import Path

from hostlink.board.library import headers, select
from hostlink.core.messages.catalog import Catalog
from tests.firmware.due import ROOT, ROSSERIAL
from tests.support.compilers import SKETCH, run
from tests.support.once import once

EXAMPLES = ROSSERIAL.parent / "examples"
BUILD = ROOT / "build" / "examples"
MESSAGES = BUILD / "messages"
LIBRARY = ("ros", "hostlink")


def sources() -> list[Path]:
    """An example of the library."""
    return [path for folder in LIBRARY for path in sorted((ROSSERIAL / folder).glob("*.cpp"))]


@cache
def messages() -> Path:
    """Folder with the header of each type."""
    once("example_messages", _write_messages, MESSAGES)
    return MESSAGES


def _write_messages() -> None:
    for name, text in headers(select(Catalog(), None)).items():
        path = MESSAGES / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def compile_sketch(sketch: Path, output: Path, compiler: list[str]) -> None:
    """Compile like an IDE: Arduino.h is included first. A warning is an error."""
    options = [*SKETCH, "-DARDUINO=10819", f"-I{ROSSERIAL}", f"-I{messages()}", "-include", "Arduino.h"]
    run([*compiler, *options, "-x", "c++", "-c", sketch, "-o", output])
