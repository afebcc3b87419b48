"""The signal that lets a daemon read its configuration again: SIGUSR1, because SIGHUP is a terminal that is gone."""

import asyncio
import contextlib
import signal
import threading
from collections.abc import Iterator

from hostlink.hub.reloader import Reloader


@contextlib.contextmanager
def reload_signal(reloader: Reloader) -> Iterator[None]:
    """Answer it within the block; what is wrong is logged, and nothing changes."""
    if threading.current_thread() is not threading.main_thread():  # no signal arrives there
        yield
        return
    loop = asyncio.get_running_loop()
    loop.add_signal_handler(signal.SIGUSR1, reloader.request)
    try:
        yield
    finally:
        loop.remove_signal_handler(signal.SIGUSR1)
