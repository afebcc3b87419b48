"""Time of the running event loop: monotonic, in seconds. Pure code gets it as an argument."""

import asyncio


def loop_time_s() -> float:
    """Return the time of the running event loop."""
    return asyncio.get_running_loop().time()
