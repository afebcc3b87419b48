"""Commands that follow a topic until Ctrl-C, which is their end and no failure."""

import asyncio
import sys
from collections.abc import Coroutine
from typing import Any

from hostlink.cli.names import near
from hostlink.cli.output import write_error
from hostlink.client import Host


def run_until_interrupted(work: Coroutine[Any, Any, None]) -> None:
    """Run until it is done, or until Ctrl-C."""
    try:
        asyncio.run(work)
    except KeyboardInterrupt:
        if sys.stderr.isatty():  # which has written ^C
            write_error("")


async def write_hint(host: Host, topic: str) -> None:
    """If nobody has announced to publish the topic: one line about it, and the names that come near."""
    topics = {each["name"]: each for each in await host.topics()}
    full = "/" + topic.lstrip("/~")
    known = topics.pop(full, None)
    if known is not None and known["publishers"]:
        return
    found = near(full, topics) if known is None or not known["messages"] else []
    names = f"near it: {', '.join(found)}; " if found else ""
    write_error(f"nobody publishes {full}; {names}`hostlink topics` lists what there is; waiting, Ctrl-C ends")
