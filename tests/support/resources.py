"""Resources of a process."""

import asyncio
import re
import threading
from pathlib import Path


def open_descriptors(pid: int | str = "self") -> int:
    """Files, sockets, ports."""
    return sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir())


def resident_mib(pid: int) -> float:
    """The memory of a process."""
    return int(re.findall(r"VmRSS:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())[0]) / 1024


def in_use() -> tuple[int, int, int]:
    """Threads, tasks and descriptors of the test's own process."""
    return threading.active_count(), len(asyncio.all_tasks()), open_descriptors()
