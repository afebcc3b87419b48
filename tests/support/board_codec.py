"""The codec of generated headers as a program: compiled with sanitizers, driven in batches."""

import struct
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from hostlink.board.headers import class_name
from hostlink.board.library import TypeSelection, headers
from tests.support.compilers import CORE, SANITIZERS
from tests.support.once import compiled

FIRMWARE = Path(__file__).parents[2] / "firmware"
SOURCES = FIRMWARE / "rosserial" / "src"
WRITTEN, NOT_READ, NOT_WRITTEN = range(3)
NARROW = 0  # instead of a type: what becomes of a double where it has 4 bytes
AMPLE = 1 << 20


class Request(NamedTuple):
    """`storage_bytes`: for variable arrays; `room_bytes`: for the message when it is written again."""

    type: int
    payload: bytes
    storage_bytes: int = AMPLE
    room_bytes: int = AMPLE


class Answer(NamedTuple):
    """`outcome`: WRITTEN, NOT_READ or NOT_WRITTEN."""

    outcome: int
    payload: bytes


def write_headers(selection: TypeSelection, folder: Path) -> list[str]:
    """The headers, and all_types.h; the names of the classes."""
    made = headers(selection)
    for name, text in made.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    names = [each.name for each in selection.messages]
    names += [part.name for service in selection.services for part in (service.request, service.response)]
    (folder / "all_types.h").write_text(
        "".join(f'#include "{name}"\n' for name in made)
        + "#define ALL_TYPES(X) \\\n"
        + " \\\n".join(f"  X({class_name(name)})" for name in names)
        + "\n"
    )
    return names


def compile_codec(folder: Path) -> Path:
    """The program of the headers in the folder.

    Raises:
        AssertionError: the compiler fails or warns.
    """
    program = folder / "codec"
    sources = [FIRMWARE / "tests" / "message_codec.cpp", SOURCES / "ros" / "wire.cpp"]
    compiled(
        ["g++", "-O0", *SANITIZERS, *CORE, f"-I{SOURCES}", f"-I{folder}", *sources, "-o", program], program, folder
    )
    return program


def run(program: Path, requests: Iterable[Request]) -> list[Answer]:
    """Return the codec's answer to each payload.

    Raises:
        AssertionError: a sanitizer found something.
    """
    wire = b"".join(
        struct.pack("<HIII", each.type, each.storage_bytes, each.room_bytes, len(each.payload)) + each.payload
        for each in requests
    )
    done = subprocess.run([program], input=wire, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return list(_answers(done.stdout))


def _answers(wire: bytes) -> Iterable[Answer]:
    at = 0
    while at < len(wire):
        outcome, size = struct.unpack_from("<BI", wire, at)
        yield Answer(outcome, wire[at + 5 : at + 5 + size])
        at += 5 + size


def numbers_of(names: Sequence[str]) -> Mapping[str, int]:
    """Return the number of each type in requests."""
    return {name: number for number, name in enumerate(names, 1)}
