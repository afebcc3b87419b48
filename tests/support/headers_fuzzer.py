"""libFuzzer on the generated headers of the board library: the program, and payloads that it begins with."""

import struct
from collections.abc import Iterable
from pathlib import Path
from random import Random

from hostlink.board.library import select
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.message_type import MessageType
from tests.support.board_codec import FIRMWARE, SOURCES, write_headers
from tests.support.compilers import CORE, run
from tests.support.random_messages import random_message

STORAGES_BYTES = (4096, 40)  # room for every seed, and too little for most
SANITIZERS = ("-fsanitize=fuzzer,address,undefined", "-fno-sanitize-recover=all")


def compile_fuzzer(folder: Path, wanted: Iterable[str] | None = None) -> Path:
    """Compile the program for the wanted types and their nested types (None: all), and write payloads to seeds/.

    Raises:
        AssertionError: the compiler fails or warns.
    """
    selection = select(Catalog(), wanted)
    write_headers(selection, folder)
    parts = [part for service in selection.services for part in (service.request, service.response)]
    _write_seeds([*selection.messages, *parts], folder / "seeds")
    program = folder / "headers_fuzz"
    sources = [FIRMWARE / "tests" / "headers_fuzz.cpp", SOURCES / "ros" / "wire.cpp"]
    run(["clang++", *CORE, *SANITIZERS, "-g", "-O1", f"-I{SOURCES}", f"-I{folder}", *sources, "-o", program])
    return program


def _write_seeds(types: list[MessageType], folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    random = Random(1)
    for number, type_ in enumerate(types):
        payload = type_.encode(random_message(random, type_.layout))
        for storage_bytes in STORAGES_BYTES:
            (folder / f"{number:03}_{storage_bytes}").write_bytes(struct.pack("<HH", number, storage_bytes) + payload)
