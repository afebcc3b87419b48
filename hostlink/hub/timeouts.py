"""Time-outs that end before their time, because nobody needs what they wait for any more."""

import asyncio


def expire(timeout: asyncio.Timeout) -> None:
    """Let a block under a time-out end now; it may be ending already, in this turn of the loop."""
    if not timeout.expired():
        timeout.reschedule(asyncio.get_running_loop().time())
