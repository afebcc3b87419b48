"""Seconds that processes needed, without those in which the machine ran other programs instead of them."""

import os
import time
from pathlib import Path

NS_PER_S = 1e9


class Stopwatch:
    """Measures from its creation on.

    The kernel counts for each thread how long it was ready and did not run. This time of the main threads of the test
    and of the processes `pids` is left out: a limit holds for the program, and not for other programs.
    """

    def __init__(self, *pids: int) -> None:
        self._kept_s = {pid: kept_waiting_s(pid) for pid in (os.getpid(), *pids)}
        self._began_s = time.monotonic()

    @property
    def seconds(self) -> float:
        """Return the seconds so far."""
        kept_s = sum(max(0.0, kept_waiting_s(pid) - before_s) for pid, before_s in self._kept_s.items())
        return time.monotonic() - self._began_s - kept_s


def kept_waiting_s(pid: int) -> float:
    """Return how long the main thread of a process was ready without running; 0 where that is not known."""
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) / NS_PER_S
    except (OSError, IndexError):  # it has ended, or the kernel does not count
        return 0.0
