"""Every Python snippet of docs/client.md, client-topics.md and client-stops.md, run by itself on a simulated robot."""

import asyncio
import re
from asyncio.subprocess import PIPE
from pathlib import Path

import pytest

from hostlink.workbench.sim.firmware_world import RobotKind
from tests.support.daemon import daemon
from tests.support.fork_server import Program, shared, start
from tests.support.proxy import proxy
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect

DOCUMENTS = [Path(__file__).parents[2] / "docs" / name for name in ("client.md", "client-topics.md", "client-stops.md")]
FENCED = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
CONNECT = re.compile(r"\b(connect(?:_blocking)?)\(\)")
TIMEOUT_S = 30.0
PYTHON = shared(Program("python", "forked_python.py"))
STANDING = {"print(error.kind, error)": "locked robot_0: locked: a visitor is near", "/switch": "'message': 'on'"}


def snippets() -> list[str]:
    return [found for document in DOCUMENTS for found in FENCED.findall(document.read_text())]


def first_cell() -> str:
    """Return the snippet that the others continue."""
    (found,) = (each for each in snippets() if each.splitlines()[-1] == 'robot = host.robot("robot_0")')
    return found


def program(snippet: str, url: str) -> str:
    """Return a snippet as a whole program that connects to `url`."""
    whole = snippet if CONNECT.search(snippet) else f"{first_cell()}\n{snippet}"
    return CONNECT.sub(rf"\1({url!r})", whole)


async def run(snippet: str, url: str) -> str:
    """Run a snippet to its end; return what it prints."""
    child = await start(program(snippet, url), program=PYTHON, stdout=PIPE, stderr=PIPE)
    async with asyncio.timeout(TIMEOUT_S):
        out, err = await child.communicate()
    assert (child.returncode, err) == (0, b""), f"{snippet}\n{err.decode()}"
    return out.decode()


def is_about_a_cut(snippet: str) -> bool:
    return "host.connection()" in snippet


def test_documents_have_snippets_and_one_is_about_a_cut() -> None:
    assert len(snippets()) >= 10
    assert len([each for each in snippets() if is_about_a_cut(each)]) == 1


@pytest.mark.parametrize("snippet", [each for each in snippets() if not is_about_a_cut(each)])
async def test_snippet_ends_without_an_error_and_leaves_the_robot_undriven(snippet: str) -> None:
    async with daemon() as host, simulated_robot(host.tcp, kind=RobotKind.NIMBLE):
        await expect(host.hub.robots.all)
        printed = await run(snippet, host.url)
        assert (await host.get("/api/robots/robot_0"))["holder"] is None
    for named, text in STANDING.items():
        if named in snippet:
            assert text in printed


async def test_snippet_about_a_cut_reports_the_loss_and_the_return() -> None:
    (snippet,) = (each for each in snippets() if is_about_a_cut(each))
    async with daemon() as host, simulated_robot(host.tcp, kind=RobotKind.NIMBLE):
        await expect(host.hub.robots.all)
        now_s = asyncio.get_running_loop().time
        async with proxy(host.url) as line, asyncio.TaskGroup() as tasks:
            running = tasks.create_task(run(snippet, line.url))
            robot = host.hub.robots.find("robot_0")
            await expect(lambda: robot.gate.counts.commands > 1)  # the client repeats after the answer of the first one
            assert robot.state(now_s()).holder is not None
            line.break_off()
            lost, back = (await running).splitlines()
    assert (lost.split()[0], lost.endswith("('robot_0',)")) == ("False", True)
    assert back.split()[0] == "True"
