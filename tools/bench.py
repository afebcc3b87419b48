"""Shared parts of the programs of `make bench`: rows with a yardstick and a bound, and processes that are measured.

A row compares a figure with a yardstick that was measured in the same run, so that a bound means the same on every
machine. A program ends with status 1 when a row misses its bound.
"""

import argparse
import asyncio
import contextlib
import json
import os
import platform
import statistics
import sys
from collections.abc import AsyncIterator, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
READY_S = 60.0  # of a crowd
ADMITTED_A_SECOND = 5  # of micro-ROS boards on a busy machine; the daemon lets twenty in


@dataclass(frozen=True)
class Row:
    """One figure. Its bounds are of `ratio`, or of `value` where there is no yardstick."""

    what: str
    value: float
    unit: str
    yardstick: str = ""
    ratio: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    note: str = ""

    @property
    def is_met(self) -> bool:
        """Whether the figure is within its bounds."""
        found = self.value if self.ratio is None else self.ratio
        return (self.at_least is None or found >= self.at_least) and (self.at_most is None or found <= self.at_most)

    def __str__(self) -> str:
        ratio = "" if self.ratio is None else f"{self.ratio:.3g}"
        bounds = [
            f"{word} {bound:g}" for word, bound in (("at least", self.at_least), ("at most", self.at_most)) if bound
        ]
        rest = "  ".join(
            text for text in (self.yardstick, f"({', '.join(bounds)})" if bounds else "", self.note) if text
        )
        return f"{self.what:<64} {self.value:>10,.4g} {self.unit:<12} {ratio:>8} {rest}"


def parser(doc: str | None, name: str) -> argparse.ArgumentParser:
    """Parser with the options that all have."""
    made = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--out", type=Path, default=ROOT / "build" / f"bench_{name}.json")
    made.add_argument("--share", type=float, default=1.0, help="of the time: 0.1 for a quick run")
    return made


def report(rows: Iterable[Row], out: Path) -> int:
    """Print the rows, write them into a file, and return the exit status: 1 when a bound is missed."""
    rows = list(rows)
    out.parent.mkdir(parents=True, exist_ok=True)
    machine = {"python": platform.python_version(), "machine": platform.machine(), "load": os.getloadavg()[0]}
    found: list[dict[str, Any]] = [{**asdict(row), "is_met": row.is_met} for row in rows]
    out.write_text(json.dumps({**machine, "rows": found}, indent=1) + "\n")
    print(*rows, sep="\n")
    missed = [row.what for row in rows if not row.is_met]
    if missed:
        print("missed its bound: " + "; ".join(missed), file=sys.stderr)
    return 1 if missed else 0


def p99(values: Sequence[float]) -> float:
    return statistics.quantiles(values, n=100)[98]


# -- processes --------------------------------------------------------------------------------------------------------


def cpu_s(pid: int) -> float:
    """Return the CPU time of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_mib(pid: int, field: str = "VmRSS") -> float:
    """Return the memory of a process; `field` VmHWM is the most that it ever held."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.split(f"{field}:")[1].split()[0]) / 1024


@contextlib.asynccontextmanager
async def reading(*command: str) -> AsyncIterator[tuple[asyncio.subprocess.Process, asyncio.StreamReader]]:
    """Run a Python program whose standard output is read; killed at the end of the block if it still runs."""
    child = await asyncio.create_subprocess_exec(sys.executable, *command, stdout=asyncio.subprocess.PIPE)
    if child.stdout is None:
        raise AssertionError("a pipe was requested")
    try:
        yield child, child.stdout
    finally:
        if child.returncode is None:
            child.kill()
        await child.wait()


@contextlib.asynccontextmanager
async def crowd(kind: str, count: int, host: tuple[str, int], seconds: float) -> AsyncIterator[asyncio.StreamReader]:
    """Run a crowd of tools/crowd.py, once it is ready; its output ends with a JSON object of its counts."""
    program = str(ROOT / "tools" / "crowd.py")
    async with reading(program, kind, str(count), "{}:{}".format(*host), str(seconds)) as (_, output):
        async with asyncio.timeout(READY_S + count / ADMITTED_A_SECOND):
            await output.readline()
        yield output


async def bare(kind: str, count: int, seconds: float, rate_hz: float) -> dict[str, float]:
    """Return what the same crowd costs a server of asyncio that does nothing with it: tools/bare_server.py."""
    program = str(ROOT / "tools" / "bare_server.py")
    async with reading(program, str(count), str(seconds), str(rate_hz)) as (_, output):
        port = int(await output.readline())
        async with crowd(kind, count, ("127.0.0.1", port), seconds + 15):
            found: dict[str, float] = json.loads(await output.readline())
            return found
