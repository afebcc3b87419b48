"""The settings and the state of an earlier version, which tools/state_of.py wrote with commit 979d62f."""

import json
import shutil
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from hostlink.client import connect
from tests.support.process import Process, run, serve, simulated

EARLIER = Path(__file__).parent / "state-979d62f"


@pytest.fixture
def state(tmp_path: Path) -> Path:
    """A copy: the daemon writes into it."""
    return Path(shutil.copytree(EARLIER, tmp_path / "state"))


@pytest.fixture
async def daemon(state: Path) -> AsyncIterator[Process]:
    async with serve("--config", str(state / "hostlink.toml")) as process:
        yield process


async def asked(daemon: Process, *words: str) -> str:
    status, out, err = await run(*words, "--url", daemon.url)
    assert (status, err) == (0, "")
    return out


async def test_settings_of_the_earlier_version_are_valid(state: Path) -> None:
    status, out, err = await run("serve", "--check-config", str(state / "hostlink.toml"))
    warnings = [line for line in err.splitlines() if not line.endswith("is in use at this moment")]
    assert (status, warnings) == (0, [])
    assert "robot_0" in out


async def test_limits_of_the_earlier_settings_hold(daemon: Process) -> None:
    async with simulated(daemon.tcp):
        await daemon.read_log("robot.appeared")
        async with connect(daemon.url) as host:
            driven = await host.robot("robot_0").drive(1.0, 0.0)
    assert (driven.linear_m_s, driven.limited_by) == (0.3, "max_linear_m_s")
    assert await asked(daemon, "params", "get", "/robot_0/wheel_separation") == "0.2143\n"


async def test_drives_of_the_earlier_version_are_listed(daemon: Process, state: Path) -> None:
    (line,) = (state / "recordings" / "drives.jsonl").read_text().splitlines()
    (drive,) = json.loads(await asked(daemon, "drives", "--json"))["drives"]
    assert (drive["robot"], drive["end"]) == ("robot_0", json.loads(line)["end"])


async def test_incident_of_the_earlier_version_can_be_fetched(daemon: Process, state: Path, tmp_path: Path) -> None:
    (file,) = (state / "recordings" / "incidents").iterdir()
    (incident,) = json.loads(await asked(daemon, "incidents", "--json"))["incidents"]
    assert (incident["file"], incident["robot"]) == (file.name, "robot_0")
    await run("incidents", file.name, "--output", str(tmp_path / "fetched.mcap"), "--url", daemon.url)
    assert (tmp_path / "fetched.mcap").read_bytes() == file.read_bytes()


async def test_recording_of_the_earlier_version_is_read(state: Path) -> None:
    (file,) = (state / "recordings").glob("*.mcap")
    status, out, err = await run("info", str(file))
    assert (status, err) == (0, "")
    assert "/robot_0/odom" in out
