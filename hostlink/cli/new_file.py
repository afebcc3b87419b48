"""Where a command may write a file: at a name that is free, or with --force over a plain file and nothing else."""

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from hostlink.errors import ConfigError


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
