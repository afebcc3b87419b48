"""The container: its file and its first process, as far as they can be tried without an image."""

import asyncio
import contextlib
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from hostlink.client import connect
from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import Config
from hostlink.core.robot.admission import LEASE_S
from tests.support.driving import hold
from tests.support.fake_device import fake_device, robot_topics
from tests.support.process import HOSTLINK, Process, run, serve
from tests.support.waiting import TIMEOUT_S, expect

FOLDER = Path("tools/container")
UNSHARED = ("unshare", "--user", "--map-root-user", "--mount", "--pid", "--fork", "--kill-child")
WRITTEN_S = 300.0
#: A container has a /dev/shm of its own. That of the host may hold files of another process with the same number.
OWN_MEMORY = 'mount -t tmpfs none /dev/shm && exec sh "$0" "$@"'
USUAL_WAIT, LONG_WAIT = "$(seq 40)", "$(seq 480)"  # half seconds; what writes an incident lets all others go first


def instructions() -> list[tuple[str, str]]:
    """(instruction, arguments) of the Containerfile."""
    text = re.sub(r"\\\n\s*", " ", (FOLDER / "Containerfile").read_text(encoding="utf-8"))
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    return [(line.partition(" ")[0], line.partition(" ")[2]) for line in lines]


def last(instruction: str) -> str:
    return [arguments for name, arguments in instructions() if name == instruction][-1]


def test_container_runs_without_root_on_the_usual_ports() -> None:
    assert last("USER") not in ("root", "0")
    assert last("EXPOSE").split() == [str(Config().tcp.port), str(Config().table("api", ApiConfig).port)]


def test_files_that_the_container_copies_and_starts_exist() -> None:
    copied = [arguments.split() for name, arguments in instructions() if name == "COPY" and "--from" not in arguments]
    assert all(Path(source).exists() for source, _ in copied)
    source, target = copied[-1]
    assert Path(source) == FOLDER / "entry.sh"
    assert json.loads(last("ENTRYPOINT")) == ["/bin/sh", target]


def test_container_build_leaves_out_files_that_are_not_sources() -> None:
    """A virtual environment, secrets of a firmware; and nothing that is a source."""
    ignored = {line.strip("/") for line in Path(".gitignore").read_text().splitlines()}
    left_out = {line.removeprefix("**/") for line in Path(".dockerignore").read_text().splitlines() if line[0] != "#"}
    assert left_out == ignored | {".git"}


def test_container_has_the_extras_for_discovery_and_fleets() -> None:
    """`[tcp] mdns` and `[zenoh]` are settings like others: a container gets nothing installed later."""
    assert re.search(r'pip install [^&]*"\$\(ls /wheels/\*\.whl\)\[mdns,zenoh\]"', last("RUN"))


async def test_container_command_is_a_command_of_hostlink(tmp_path: Path) -> None:
    words = json.loads(last("CMD"))
    file = tmp_path / "hostlink.toml"
    file.write_text("tcp.port = 0\napi.port = 0\n")  # of the usual ones it would warn while another program has them
    assert words[-1] == "/etc/hostlink/hostlink.toml"
    status, _, complaint = await run(*words[:-2], "--check-config", str(file))
    assert (status, complaint) == (0, "")


def health(url: str) -> int:
    """The exit status of its health check, with the port of a daemon."""
    words = json.loads(last("HEALTHCHECK").partition("CMD ")[2])
    assert words[0] == "python"
    command = words[2].replace("http://127.0.0.1:9090", url)
    return subprocess.run([sys.executable, "-c", command], check=False, capture_output=True, timeout=10).returncode


async def test_container_health_check_tells_whether_the_daemon_lives() -> None:
    async with serve() as daemon:
        assert await asyncio.to_thread(health, daemon.url) == 0
        await daemon.end(signal.SIGTERM)
    assert await asyncio.to_thread(health, daemon.url) != 0


# -- its first process ------------------------------------------------------------------------------------------------


def child_of(pid: int) -> int:
    """The first process that it started."""
    return int(Path(f"/proc/{pid}/task/{pid}/children").read_text().split()[0])


@contextlib.asynccontextmanager
async def contained(log: Path, *arguments: str) -> AsyncIterator[tuple[Process, int]]:
    """A daemon below the container's first process, in a PID namespace; and the daemon's pid outside of it."""
    text = (FOLDER / "entry.sh").read_text()
    assert text.count(USUAL_WAIT) == 1
    entry = log.with_name("entry.sh")
    entry.write_text(text.replace(USUAL_WAIT, LONG_WAIT))
    path = f"PATH={Path(HOSTLINK).parent}:/usr/bin:/bin"
    program = ("env", path, *UNSHARED, "sh", "-c", OWN_MEMORY, str(entry))
    async with serve(*arguments, log=log, program=program) as process:
        first = child_of(process.child.pid)
        yield process, child_of(first)


@pytest.mark.timeout(600)
async def test_a_daemon_that_is_killed_in_a_container_leaves_a_standing_robot(tmp_path: Path) -> None:
    """Process 1 lives on until the guardian has stopped it, and the incident is written."""
    file = tmp_path / "hostlink.toml"
    file.write_text("[recording]\nfolder = 'kept'\nmin_free_disk_mb = 0\n")
    async with (
        contained(tmp_path / "log", "--config", str(file)) as (process, daemon),
        fake_device(process.tcp, robot_topics()) as device,
        connect(process.url) as program,
    ):
        await expect(lambda: b"guardian.started" in (tmp_path / "log").read_bytes())
        await hold(program.robot("robot_0"), 0.2, 0.0)
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
        await asyncio.sleep(LEASE_S)  # the guardian knows by then that the robot is driven
        os.kill(daemon, signal.SIGKILL)
        assert await device.velocity_other_than((0.2, 0.0)) == (0.0, 0.0)
        assert await asyncio.wait_for(process.child.wait(), WRITTEN_S) == 128 + signal.SIGKILL
    (incident,) = (tmp_path / "kept" / "incidents").glob("*.mcap")
    assert "daemon_died" in incident.name


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
async def test_a_signal_to_the_first_process_ends_the_daemon_in_order(tmp_path: Path, number: signal.Signals) -> None:
    async with contained(tmp_path / "log") as (process, daemon):
        os.kill(parent_of(daemon), number)
        assert await asyncio.wait_for(process.child.wait(), TIMEOUT_S) == 0
    assert b"daemon.stopped" in (tmp_path / "log").read_bytes()


async def test_container_settings_are_read_again_after_a_signal(tmp_path: Path) -> None:
    file = tmp_path / "hostlink.toml"
    file.write_text("")
    async with contained(tmp_path / "log", "--config", str(file)) as (_, daemon):
        file.write_text("[robots.rover]\nmax_linear_m_s = 0.2\n")
        os.kill(parent_of(daemon), signal.SIGUSR1)
        await expect(lambda: (tmp_path / "log").read_bytes().count(b"config.reloaded") == 1)
        file.write_text("[robots.rover]\nmax_linear_m_s = 0.3\n")
        os.kill(parent_of(daemon), signal.SIGUSR1)  # the daemon is still there
        await expect(lambda: (tmp_path / "log").read_bytes().count(b"config.reloaded") == 2)


def parent_of(pid: int) -> int:
    return int(re.findall(r"^PPid:\s+(\d+)$", Path(f"/proc/{pid}/status").read_text(), re.MULTILINE)[0])
