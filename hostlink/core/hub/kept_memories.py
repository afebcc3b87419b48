"""Memories of devices over restarts of the daemon."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable

from hostlink.core.config import Config
from hostlink.core.hub.kept import Keeper, KeptFile, folder_of, keeping
from hostlink.core.hub.links import Links
from hostlink.core.hub.memories import ADVICE, Texts
from hostlink.core.runtime.cancellation import meanwhile

BOARDS = "boards"
NOTE_S = 0.25  # a board that was killed with the daemon sooner after its start is not remembered


@contextlib.asynccontextmanager
async def kept_memories(links: Links, file: KeptFile[Texts] | None) -> AsyncIterator[None]:
    """Keep the memories of devices over restarts, for the length of a block. Without a file, they are not kept."""

    def watch(on_change: Callable[[], None]) -> None:
        links.memories.on_change = on_change

    async def note() -> None:
        while True:
            await links.memories.has_links.wait()
            links.memories.note()
            await asyncio.sleep(NOTE_S)

    async with meanwhile(("memories", note())):
        if file is None:
            yield
            return
        memories = links.memories
        async with keeping(Keeper(file, lambda: dict(memories.texts), memories.restore, ADVICE), watch):
            yield


def memories_file(config: Config) -> KeptFile[Texts] | None:
    """Return the file of the memories of a daemon with these settings; None if it keeps none."""
    folder = folder_of(config, BOARDS)
    return None if folder is None else KeptFile(folder, BOARDS, Texts)
