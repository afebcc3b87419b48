"""Files that commands write: downloads from the daemon, new files and replaced ones."""

import contextlib
import importlib.util
import os
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, BinaryIO

import typer

from hostlink.cli.output import show_progress
from hostlink.errors import ConfigError, HostlinkError, LibraryMissing, size

if TYPE_CHECKING:
    from hostlink.client import Host  # slow to import, and no part of a command that only writes files

MessageFolders = Annotated[
    list[Path] | None, typer.Option(help="Folder with .msg and .srv files of your own types. May be repeated.")
]

PICTURES = (".pdf", ".png", ".svg")

# -- fetching ---------------------------------------------------------------------------------------------------------


def check_output(output: Path) -> None:
    """Refuse a file that cannot be written before the work begins.

    Raises:
        ConfigError: the file exists, or its folder cannot be written.
    """
    check_absent(output)
    try:
        output.touch()
        output.unlink()
    except OSError as error:
        raise ConfigError("--output", f"{output} cannot be written: {error.strerror}; name another file") from error


async def fetch(host: "Host", path: str, target: Path) -> None:
    """Download a file, with progress. What was received before an error stays.

    Raises:
        HostlinkError: the daemon refuses, the connection is lost, or the file cannot be written.
    """
    received = 0
    with writing(target, "the daemon still has the recording"), _removed_if_empty(target) as out:
        async for piece in host.download(path):
            out.write(piece)
            received += len(piece)
            show_progress(f"fetching: {size(received)}")


@contextlib.contextmanager
def _removed_if_empty(target: Path) -> Iterator[BinaryIO]:
    """Create a file, and remove it if the block has written nothing."""
    with target.open("xb") as out:
        try:
            yield out
        finally:
            if not out.tell():
                target.unlink()


@contextlib.contextmanager
def writing(file: Path, advice: str) -> Iterator[None]:
    """Raise an error of the system in the block as one that names the file and the next step.

    Raises:
        HostlinkError: the file cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise HostlinkError(f"{file} cannot be written: {error.strerror or error}; {advice}") from error


# -- new file ---------------------------------------------------------------------------------------------------------


def check_picture(option: str, file: Path, *, needs: str, extra: str, suffixes: Sequence[str] = PICTURES) -> None:
    """Refuse a picture of another format, or without the library that draws it: what `needs` it, of an `extra`.

    Raises:
        ConfigError: the suffix is wrong.
        LibraryMissing: matplotlib is not installed.
    """
    if file.suffix not in suffixes:
        raise ConfigError(option, f"{file} must end in {'one of ' if len(suffixes) > 1 else ''}{', '.join(suffixes)}")
    if importlib.util.find_spec("matplotlib") is None:
        raise LibraryMissing(needs, "matplotlib", extra)


def check_folder(option: str, file: Path) -> None:
    """Refuse a file whose folder cannot be written, before a robot moves for it.

    Raises:
        ConfigError: the folder does not exist, or belongs to another user.
    """
    if not os.access(file.parent, os.W_OK):
        raise ConfigError(option, f"the folder {file.parent} cannot be written; create it, or name another")


def check_absent(output: Path) -> None:
    """Refuse a file or folder that exists already, before the work begins: commands without --force replace none.

    Raises:
        ConfigError: it exists.
    """
    if os.path.lexists(output):
        raise ConfigError("--output", f"{output} exists already; choose another name, or remove it")


def check_new_file(option: str, file: Path, *, is_forced: bool, example: str) -> None:
    """Accept the name of a file that will be written; `example` is such a name.

    Raises:
        ConfigError: the name is not one of a plain file, or the file exists and may not be replaced.
    """
    if os.fspath(file) == "-":
        raise ConfigError(option, f"'-' is not a file; name one, for example {example}")
    try:
        mode = file.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):  # the error of writing says which
        return
    except OSError as error:
        raise ConfigError(option, f"{file} cannot be read: {error.strerror}; name another") from error
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "not a plain file"
        raise ConfigError(option, f"{file} is {kind}; name a file, for example {example}")
    if not is_forced:
        raise ConfigError(option, f"{file} exists already; name another file, or replace it with --force")


@contextlib.contextmanager
def replacing(option: str, file: Path) -> Iterator[Path]:
    """Temporary file that replaces `file` when the block ends without an error. A symbolic link keeps its target.

    Raises:
        ConfigError: the file cannot be written.
    """
    place = Path(os.path.realpath(file))
    beside = place.with_name(f".{place.name}.{os.getpid()}.new")  # another run may write the same file
    try:
        yield beside
        beside.replace(place)
    except OSError as error:
        raise ConfigError(option, f"{file} cannot be written: {error.strerror}; name another") from error
    finally:
        with contextlib.suppress(OSError):  # the folder may not exist
            beside.unlink(missing_ok=True)
