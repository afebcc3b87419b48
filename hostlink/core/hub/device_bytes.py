"""DeviceBytes: limit on what the sessions of all devices keep together, in the budget of bytes.

A session has limits of its own. Hundreds of connections that each keep as much as they may would need gigabytes.
"""

import asyncio

import structlog

from hostlink.core.hub.byte_budget import Share
from hostlink.core.hub.memories import Memories
from hostlink.core.link.serving import LinkEnd
from hostlink.core.runtime.logs import printable

log = structlog.get_logger()

LOOK_S = 0.5


class DeviceBytes:
    """Over the limit, the device that keeps most loses its unfinished messages, and its link if that is too little."""

    def __init__(self, share: Share, memories: Memories) -> None:
        """`memories` has the links whose sessions keep something."""
        self._share, self._memories = share, memories

    async def run(self) -> None:
        """Look at all sessions, repeatedly, until cancelled."""
        while True:
            await self._memories.has_links.wait()
            while self._memories.links:
                self.look()
                await asyncio.sleep(LOOK_S)
            self.look()

    def look(self) -> None:
        """Count the bytes of all sessions, and make room while they are too many."""
        kept = {link: count for link in self._memories.links.values() if (count := link.session.kept_bytes)}
        self._share.held_bytes = sum(kept.values())
        while self._share.is_over:
            link = max(kept, key=kept.__getitem__)
            link.session.drop_unfinished()
            left = link.session.kept_bytes
            if left == kept[link]:  # all of it is in use
                log.warning("link.too_large", link=link.number, peer=printable(link.peer), bytes=left)
                link.end(LinkEnd.EVICTED)
                left = 0
            self._share.refused += 1
            self._share.held_bytes += left - kept.pop(link)
            if left:
                kept[link] = left
