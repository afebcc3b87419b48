"""Names of robots over restarts of the daemon: which robot was robot_0."""

import contextlib
from collections.abc import AsyncIterator, Callable

from hostlink.core.config import Config
from hostlink.core.hub.kept import Keeper, KeptFile, folder_of, keeping
from hostlink.core.hub.links import Links
from hostlink.core.robot.names import Remembered

NAMES = "names"
Names = dict[str, Remembered]
ADVICE = "give each robot its name in hostlink.toml: [robots.NAME] address = ..."


@contextlib.asynccontextmanager
async def kept_names(links: Links, file: KeptFile[Names] | None) -> AsyncIterator[None]:
    """Keep the names of robots over restarts, for the length of a block. Without a file, they are not kept.

    Robots that nothing names may have other names than before if reading fails.
    """

    def watch(on_change: Callable[[], None]) -> None:
        links.on_named = on_change

    if file is None:
        yield
        return
    async with keeping(Keeper(file, lambda: links.remembered, links.remember, ADVICE), watch):
        yield


def names_file(config: Config) -> KeptFile[Names] | None:
    """Return the file of the names of a daemon with these settings; None if it keeps none."""
    folder = folder_of(config, NAMES)
    return None if folder is None else KeptFile(folder, NAMES, Names)
