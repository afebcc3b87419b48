"""Fetching a file from the daemon into one here."""

from pathlib import Path

from hostlink.cli.measuring import megabytes
from hostlink.cli.output import show_progress
from hostlink.client import Host
from hostlink.errors import ConfigError, HostlinkError


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
