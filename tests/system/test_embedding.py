"""The program of docs/embedding.md: a Python program that holds robots without the daemon."""

import asyncio
import contextlib
import re
import socket
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.support.fake_device import FakeDevice, fake_device, robot_topics
from tests.support.process import free_port
from tests.support.waiting import expect

ROOT = Path(__file__).parents[2]
DOCUMENT = (ROOT / "docs" / "embedding.md").read_text()
(EXAMPLE,) = re.findall(r"^```python\n(.*?)^```$", DOCUMENT, re.MULTILINE | re.DOTALL)
HEAVY = ("aiohttp", "numpy", "typer", "rosbags", "zenoh", "zeroconf", "prometheus_client", "hostlink.components")
TOLD = "import sys\nprint(*sys.modules, flush=True)\n"
DRIVES = (0.1, 0.5)


@contextlib.asynccontextmanager
async def program(tmp_path: Path, port: int) -> AsyncIterator[asyncio.subprocess.Process]:
    """The example on a port of its own. It prints the modules that it has imported."""
    text = EXAMPLE.replace('TcpConfig(host="127.0.0.1")', f'TcpConfig(host="127.0.0.1", port={port})')
    assert text != EXAMPLE
    file = tmp_path / "program.py"
    file.write_text(text.replace("asyncio.run(main())", TOLD + "asyncio.run(main())"))
    child = await asyncio.create_subprocess_exec(sys.executable, str(file), stdout=asyncio.subprocess.PIPE)
    try:
        yield child
    finally:
        with contextlib.suppress(ProcessLookupError):
            child.kill()
        await child.wait()


def listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@contextlib.asynccontextmanager
async def device(port: int) -> AsyncIterator[FakeDevice]:
    await expect(lambda: listens(port))
    async with fake_device(("127.0.0.1", port)) as made:
        await made.announce(robot_topics())
        yield made


async def test_program_of_the_document_holds_and_drives_a_robot_with_the_core_alone(tmp_path: Path) -> None:
    port = free_port()
    async with program(tmp_path, port) as child, device(port) as robot:
        assert child.stdout is not None
        imported = (await child.stdout.readline()).decode().split()
        assert [name for name in imported if name in HEAVY] == []
        await robot.velocity_of(DRIVES)


@pytest.mark.parametrize("how", ["terminate", "kill"])
async def test_robot_of_a_program_stops_when_the_program_ends_or_is_killed(tmp_path: Path, how: str) -> None:
    """A killed program's robot is stopped by its guardian."""
    port = free_port()
    async with program(tmp_path, port) as child, device(port) as robot:
        await robot.velocity_of(DRIVES)
        getattr(child, how)()
        await robot.velocity_of((0.0, 0.0))
