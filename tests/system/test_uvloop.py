"""The event loop of the daemon. All other tests of `hostlink serve` run on the default, uvloop."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hostlink.errors import LibraryMissing
from tests.support.process import HOSTLINK, serve
from tests.support.waiting import TIMEOUT_S

pytestmark = pytest.mark.filterwarnings("default::DeprecationWarning")


def is_loaded(library: str, pid: int) -> bool:
    return library in Path(f"/proc/{pid}/maps").read_text()


async def test_uvloop_is_the_default_where_it_is_installed() -> None:
    async with serve() as daemon:
        assert daemon.lines("daemon.started")[0]["loop"] == "uvloop"
        assert is_loaded("uvloop", daemon.pid)
    async with serve("--loop", "asyncio") as daemon:
        assert daemon.lines("daemon.started")[0]["loop"] == "asyncio"


async def test_without_uvloop_the_daemon_runs_on_asyncio(tmp_path: Path) -> None:
    (tmp_path / "uvloop.py").write_text("raise ImportError")
    async with serve(environment={"PYTHONPATH": str(tmp_path)}, program=(HOSTLINK,)) as daemon:
        assert daemon.lines("daemon.started")[0]["loop"] == "asyncio"


def test_a_loop_that_is_not_installed_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "uvloop.py").write_text("raise ImportError")
    command = [sys.executable, "-m", "hostlink", "serve", "--loop", "uvloop"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=TIMEOUT_S, env=environment)
    message = f"hostlink: {LibraryMissing('--loop', 'uvloop', 'uvloop')}\n"
    assert (ended.returncode, ended.stdout, ended.stderr) == (2, "", message)
