"""Files that commands write: fetched from the daemon, or new ones here."""

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from hostlink.cli.output import megabytes, show_progress
from hostlink.client import Host
from hostlink.errors import ConfigError, HostlinkError

# -- fetching ---------------------------------------------------------------------------------------------------------


def check_output(output: Path) -> None:
    """Now, and not after an hour of work.

    Raises:
        ConfigError: nothing can be written there, or there is something already.
    """
    try:
        if output.exists():
            raise ConfigError("--output", f"{output} is there already; choose another name, or remove it")
        output.touch()
        output.unlink()
    except OSError as error:
        raise ConfigError("--output", f"{output}: {error.strerror}") from error


async def fetch(host: Host, path: str, target: Path) -> None:
    """Fetch a file, with progress.

    Raises:
        HostlinkError: the daemon refuses, the connection is lost, or the file cannot be written.
    """
    size = 0
    try:
        with target.open("xb") as out:
            async for piece in host.download(path):
                out.write(piece)
                size += len(piece)
                show_progress(f"fetching: {megabytes(size)}")
    except OSError as error:
        raise HostlinkError(f"{target}: {error.strerror}; the daemon still has it") from error
    show_progress("")


# -- new file ---------------------------------------------------------------------------------------------------------


def check_new_file(option: str, file: Path, *, is_forced: bool, example: str) -> None:
    """Accept the name of a file that will be written; `example`: of such a name.

    Raises:
        ConfigError: it is no file, or is there and may not be replaced.
    """
    if os.fspath(file) == "-":
        raise ConfigError(option, f"- is no file: name one, as {example}")
    try:
        mode = file.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):  # writing says which
        return
    except OSError as error:
        raise ConfigError(option, f"{file}: {error.strerror}; name another") from error
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "no plain file"
        raise ConfigError(option, f"{file} is {kind}: name a file, as {example}")
    if not is_forced:
        raise ConfigError(option, f"{file} is there already: name another, or add --force")


@contextlib.contextmanager
def replacing(option: str, file: Path) -> Iterator[Path]:
    """Where to write instead: what was written there takes the file's place when the block ends, or nothing does.

    Of a link, it takes the place of what the link leads to.

    Raises:
        ConfigError: it cannot be written.
    """
    place = Path(os.path.realpath(file))
    beside = place.with_name(f".{place.name}.{os.getpid()}.new")  # another run may write the same file
    try:
        yield beside
        beside.replace(place)
    except OSError as error:
        raise ConfigError(option, f"{file} cannot be written: {error.strerror}; name another") from error
    finally:
        with contextlib.suppress(OSError):  # the folder may not be there
            beside.unlink(missing_ok=True)
