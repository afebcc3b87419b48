"""Seconds that processes needed, without those in which the machine ran other programs instead of them."""

import asyncio
import os
import time
from pathlib import Path

from hostlink.core.runtime.units import NS_PER_S

SAMPLE_INTERVAL_S = 0.002


class Stopwatch:
    """Measures from its creation on.

    The kernel counts for each thread how long it was ready and did not run. This time of the main threads of the test
    and of the processes `pids` is left out: a limit holds for the program, and not for other programs. Of a process
    that may end meanwhile, samples are taken (`sampling`), and the last one counts.
    """

    def __init__(self, *pids: int) -> None:
        self._began_kept_s = {pid: kept_waiting_s(pid) for pid in (os.getpid(), *pids)}
        self._kept_s = dict(self._began_kept_s)
        self._began_s = time.monotonic()

    @property
    def seconds(self) -> float:
        """Return the seconds so far."""
        return time.monotonic() - self._began_s - self.kept_s

    @property
    def kept_s(self) -> float:
        """Return the seconds that are left out."""
        self._sample()
        return sum(self._kept_s.values()) - sum(self._began_kept_s.values())

    async def sampling(self) -> None:
        """Take samples until cancelled."""
        while True:
            self._sample()
            await asyncio.sleep(SAMPLE_INTERVAL_S)

    def _sample(self) -> None:
        for pid, before_s in self._kept_s.items():
            self._kept_s[pid] = max(before_s, kept_waiting_s(pid))


def kept_waiting_s(pid: int) -> float:
    """Return how long the main thread of a process was ready without running; 0 where that is not known."""
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) / NS_PER_S
    except (OSError, IndexError):  # it has ended, or the kernel does not count
        return 0.0
