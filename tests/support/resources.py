"""Resources of the test's process."""

import asyncio
import threading
from pathlib import Path


def open_descriptors() -> int:
    """Files, sockets, ports."""
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def in_use() -> tuple[int, int, int]:
    """Threads, tasks, descriptors."""
    return threading.active_count(), len(asyncio.all_tasks()), open_descriptors()
