"""RingMemory: blocks of memory that survive the process: a file on tmpfs, with what a reader must know beside it.

| file          | what it has                                                                                       |
|---------------|---------------------------------------------------------------------------------------------------|
| ring          | the blocks: ring.py. The process that uses them holds a lock on it                                |
| schemas       | definitions of message types, a line of JSON each: numbers in the blocks refer to their order     |
| *.json        | one fact each, written whole: `put_fact`                                                          |
"""

import contextlib
import fcntl
import mmap
import os
import shutil
import tempfile
from pathlib import Path

import msgspec

from hostlink import remains

BLOCK_BYTES = 16 * 1024
GROWTH_BLOCKS = 16  # taken from the system at a time: what is never needed is never taken
FEWEST_BLOCKS = 4
MAX_SCHEMAS = 4096
MAX_SCHEMA_BYTES = 8 * 1024 * 1024
RING, SCHEMAS = "ring", "schemas"


class RingMemory:
    """`folder` is None where it does not survive: there is no tmpfs, or no room on it."""

    def __init__(self, max_bytes: int, *, purpose: str | None = None) -> None:
        """`purpose`: who may find it later, letters and digits; None: nobody, it does not survive."""
        self.max_blocks = max(FEWEST_BLOCKS, max_bytes // BLOCK_BYTES)
        self.blocks = 0  # that may be used
        self.folder: Path | None = None
        self._descriptor = -1
        self._schemas: dict[str, int] = {"": 0}
        self._schema_bytes = 0
        if purpose is not None:
            with contextlib.suppress(OSError):
                self._open(purpose)
        if self.folder is None:
            self.bytes = mmap.mmap(-1, self.max_blocks * BLOCK_BYTES)
            self.blocks = self.max_blocks  # the system gives each page when it is first written to

    def _open(self, purpose: str) -> None:
        folder = Path(tempfile.mkdtemp(prefix=remains.prefix_of(purpose), dir=remains.PLACE))
        try:
            free_bytes = shutil.disk_usage(folder).free
            self.max_blocks = max(FEWEST_BLOCKS, min(self.max_blocks, free_bytes // 2 // BLOCK_BYTES))
            self._descriptor = os.open(folder / RING, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
            fcntl.flock(self._descriptor, fcntl.LOCK_EX)
            os.ftruncate(self._descriptor, self.max_blocks * BLOCK_BYTES)
            self.bytes = mmap.mmap(self._descriptor, self.max_blocks * BLOCK_BYTES)
            os.posix_fallocate(self._descriptor, 0, FEWEST_BLOCKS * BLOCK_BYTES)  # its OSError: there is no room
            self.blocks = FEWEST_BLOCKS
            (folder / SCHEMAS).touch()
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            if self._descriptor >= 0:
                os.close(self._descriptor)
                self._descriptor = -1
            raise
        self.folder = folder

    def grow(self) -> bool:
        """Take more blocks from the system; False: it has none, or there are as many as may be.

        A page of a full tmpfs would end the process with SIGBUS when it is first written to.
        """
        more = min(GROWTH_BLOCKS, self.max_blocks - self.blocks)
        if more <= 0:
            return False
        try:
            os.posix_fallocate(self._descriptor, self.blocks * BLOCK_BYTES, more * BLOCK_BYTES)
        except OSError:
            self.max_blocks = self.blocks
            return False
        self.blocks += more
        return True

    def schema_number(self, schema: str) -> int:
        """The number of a definition; 0, that of the empty one, where there are too many."""
        number = self._schemas.get(schema)
        if number is not None:
            return number
        line = msgspec.json.encode(schema) + b"\n"
        if len(self._schemas) >= MAX_SCHEMAS or self._schema_bytes + len(line) > MAX_SCHEMA_BYTES:
            return 0
        try:
            if self.folder is not None:
                with (self.folder / SCHEMAS).open("ab") as file:
                    file.write(line)
        except OSError:  # no room
            return 0
        self._schema_bytes += len(line)
        number = self._schemas[schema] = len(self._schemas)
        return number

    def schemas(self) -> list[str]:
        """By their numbers."""
        return list(self._schemas)

    def put_fact(self, name: str, fact: object) -> None:
        """Keep it beside the blocks, whole or not at all."""
        if self.folder is not None:
            with contextlib.suppress(OSError):  # no room
                write_fact(self.folder, name, fact)

    def drop_fact(self, name: str) -> None:
        """Nobody needs to know it any more."""
        if self.folder is not None:
            with contextlib.suppress(OSError):
                (self.folder / f"{name}.json").unlink()

    def release(self) -> Path | None:
        """The process needs it no more: whoever finds it may have it. Returns where it is."""
        if self._descriptor >= 0:
            fcntl.flock(self._descriptor, fcntl.LOCK_UN)  # the map has a descriptor of its own, as long as this process
            os.close(self._descriptor)
            self._descriptor = -1
        return self.folder

    def remove(self) -> None:
        """Nobody needs it."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)
        self.release()


def write_fact(folder: Path, name: str, fact: object) -> None:
    """Write it whole, or not at all.

    Raises:
        OSError: there is no room.
    """
    beside = folder / f"{name}.part"
    beside.write_bytes(msgspec.json.encode(fact))
    beside.rename(folder / f"{name}.json")


def read_schemas(folder: Path) -> list[str]:
    """Those of a process that is gone; a line that was not finished is left out."""
    found = [""]
    with contextlib.suppress(OSError):
        for line in (folder / SCHEMAS).read_bytes().splitlines():
            with contextlib.suppress(msgspec.DecodeError, UnicodeDecodeError):
                found.append(msgspec.json.decode(line, type=str))
    return found
