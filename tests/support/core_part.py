"""A part of a core for processes: a quota of a control group; without one, they are stopped and continued in turn."""

import contextlib
import itertools
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

CPU = Path("/sys/fs/cgroup/cpu")  # of cgroup version 1
UNIFIED = Path("/sys/fs/cgroup")  # of version 2
PERIOD_S = 0.1
_PERIOD_US = int(PERIOD_S * 1_000_000)
_numbers = itertools.count()


class CorePart:
    """A quota of a control group that this process made."""

    stopped_s = 0.0  # for how long signals have stopped its processes: nothing else counts that

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def add(self, pid: int) -> None:
        """The process, its threads, and the children that it starts from now on."""
        (self._folder / "cgroup.procs").write_text(str(pid))

    def remove(self, pid: int) -> None:
        """The process has all cores again; one that has ended is left out."""
        with contextlib.suppress(ProcessLookupError):
            (self._folder.parent / "cgroup.procs").write_text(str(pid))

    def close(self) -> None:
        """Remove the group; its processes have all cores again."""
        with contextlib.suppress(OSError):
            for pid in (self._folder / "cgroup.procs").read_text().split():
                self.remove(int(pid))
        for _ in range(100):  # one that was killed is listed until it is collected
            try:
                self._folder.rmdir()
                break
            except OSError:
                time.sleep(0.02)


class StoppedPart(CorePart):
    """A thread that stops each process for the rest of every period: for those who may make no control group."""

    def __init__(self, part: float) -> None:
        self._part = part
        self._pids: set[int] = set()
        self._lock = threading.Lock()  # no process is stopped after `remove` has returned
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._turn, daemon=True)
        self._thread.start()

    def add(self, pid: int) -> None:
        with self._lock:
            self._pids.add(pid)

    def remove(self, pid: int) -> None:
        with self._lock:
            self._pids.discard(pid)
            _signal([pid], signal.SIGCONT)

    def close(self) -> None:
        self._is_over.set()
        self._thread.join()
        with self._lock:
            _signal(self._pids, signal.SIGCONT)

    def _turn(self) -> None:
        while not self._is_over.wait(self._part * PERIOD_S):
            with self._lock:
                _signal(self._pids, signal.SIGSTOP)
            began_s = time.monotonic()
            self._is_over.wait((1 - self._part) * PERIOD_S)
            with self._lock:
                _signal(self._pids, signal.SIGCONT)
            self.stopped_s += time.monotonic() - began_s


def _signal(pids: "set[int] | list[int]", number: signal.Signals) -> None:
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, number)


def can_limit() -> bool:
    """Whether a quota can be set: as root, where the control groups can be written."""
    return any(os.access(folder, os.W_OK) for folder in (CPU / "cpu.shares", UNIFIED / "cpu.max"))


@contextlib.contextmanager
def part_of_a_core(part: float, *pids: int) -> Iterator[CorePart]:
    """Limit these processes, and those that are added, to a part of one core together, within the block."""
    made = _quota(part) if can_limit() else StoppedPart(part)
    try:
        for pid in pids:
            made.add(pid)
        yield made
    finally:
        made.close()


def _quota(part: float) -> CorePart:
    is_first = (CPU / "cpu.shares").exists()
    folder = (CPU if is_first else UNIFIED) / f"hostlink-test-{os.getpid()}-{next(_numbers)}"
    folder.mkdir()
    quota_us = int(part * _PERIOD_US)
    if is_first:
        (folder / "cpu.cfs_quota_us").write_text(str(quota_us))
    else:
        (folder / "cpu.max").write_text(f"{quota_us} {_PERIOD_US}")
    return CorePart(folder)


def children_of(pid: int) -> list[int]:
    """The processes that it has started."""
    found = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            if int(file.read_text().rpartition(")")[2].split()[1]) == pid:
                found.append(int(file.parent.name))
    return found
