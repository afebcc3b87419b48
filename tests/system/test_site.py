"""The site that `make docs` builds: strict, complete, and made of the code as it is."""

import asyncio
import dataclasses
import re
import sys
from pathlib import Path

import pytest

import hostlink.client
from hostlink.cli.main import COMMANDS
from hostlink.components.gateway.settings import ApiConfig
from hostlink.components.zenoh.settings import ZenohSettings
from hostlink.core import config
from hostlink.core.runtime import logs

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
TIMEOUT_S = 270.0  # two minutes on a machine that does five other things
EVENT = re.compile(r"\b[a-z][a-z0-9]*\.[a-z_0-9]+\b")


async def build(target: Path) -> str:
    """Build it; returns what Sphinx has against it."""
    words = ("-m", "sphinx", "-q", "--keep-going", "-W", "-b", "html", str(ROOT / "docs"), str(target))
    child = await asyncio.create_subprocess_exec(
        sys.executable, *words, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
    )
    try:
        async with asyncio.timeout(TIMEOUT_S):
            out, _ = await child.communicate()
    finally:
        if child.returncode is None:
            child.kill()
            await child.wait()
    return out.decode() if child.returncode else ""


def text_of(page: Path) -> str:
    return re.sub(r"<[^>]+>", "", page.read_text())


async def test_the_site_is_built_without_a_warning_and_its_reference_is_complete(tmp_path: Path) -> None:
    assert await build(tmp_path) == ""

    pages = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"index"}
    index = (tmp_path / "index.html").read_text()
    assert {page for page in pages if f'href="{page}.html"' not in index} == set()

    assert 'href="try.html"' in index
    assert (
        len((tmp_path / "try.html").read_text()) > len((ROOT / "docs" / "try.html").read_text()) + 50_000
    )  # the firmware

    commands = (tmp_path / "reference" / "cli.html").read_text()
    assert {name for name in COMMANDS if f'id="hostlink-{name}"' not in commands} == set()

    client = (tmp_path / "reference" / "client.html").read_text()
    assert {name for name in hostlink.client.__all__ if f'id="hostlink.client.{name}"' not in client} == set()
    assert 'id="hostlink.client.BlockingHost.subscribe"' in client

    settings = text_of(tmp_path / "reference" / "configuration.html")
    for part in (config.Config, config.TcpConfig, config.RobotConfig, ApiConfig, ZenohSettings):
        assert {each.name for each in dataclasses.fields(part) if each.name not in settings} == set()

    metrics = text_of(tmp_path / "reference" / "metrics.html")
    assert {"hostlink_links", "hostlink_robot_connected", "hostlink_link_silent_seconds"} <= set(metrics.split())
    events = text_of(tmp_path / "reference" / "events.html")
    assert {event for event in EVENT.findall(logs.__doc__ or "") if event not in events} == set()
    assert "/api/robots/{name}/odometry" in text_of(tmp_path / "reference" / "rest.html")
