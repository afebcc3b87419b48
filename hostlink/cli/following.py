"""Commands that follow a topic until Ctrl-C, which is their end and no failure; the figures of a topic, each second."""

import asyncio
import contextlib
import json
import sys
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from hostlink.cli.connecting import connected
from hostlink.cli.measuring import Measured
from hostlink.cli.names import near
from hostlink.cli.output import write, write_error
from hostlink.client import Host, Mailbox, RawMessage

INTERVAL_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Followed:
    """A topic of a daemon, and how it is shown."""

    topic: str
    url: str
    token: str | None
    seconds: float  # 0: until Ctrl-C
    as_json: bool


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


def measure(
    followed: Followed,
    measured: Measured,
    add: Callable[[RawMessage], None],
    show: Callable[[], dict[str, Any]],
    lines: Callable[[], str],
) -> None:
    """Measure the topic, and write a line each second; at the end, what it was of."""
    began_s = time.monotonic()
    run_until_interrupted(_measure(followed, measured, add, show, lines))
    write_error(f"{measured.messages} messages in {time.monotonic() - began_s:.1f} s")


async def _measure(
    followed: Followed,
    measured: Measured,
    add: Callable[[RawMessage], None],
    show: Callable[[], dict[str, Any]],
    lines: Callable[[], str],
) -> None:
    async with connected(followed.url, followed.token) as host:
        if not followed.as_json:
            await write_hint(host, followed.topic)
        async with host.subscribe_raw(followed.topic) as messages:
            next_s = asyncio.get_running_loop().time()
            end_s = next_s + (followed.seconds or float("inf"))
            while next_s < end_s:
                next_s, before = min(next_s + INTERVAL_S, end_s), measured.messages
                await _add_until(next_s, messages, add)
                if followed.as_json:
                    write(json.dumps({"messages": measured.messages} | show()))
                else:
                    write(lines() if measured.messages > before else "no new messages")


async def _add_until(end_s: float, messages: Mailbox[RawMessage], add: Callable[[RawMessage], None]) -> None:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout_at(end_s):
            async for message in messages:
                add(message)
