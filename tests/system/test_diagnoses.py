"""Every fault that a simulated device can have is named over a real connection, by the daemon's API and by doctor."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio

from hostlink.workbench.sim.robot import FAULTS, HEALTHY, Fault, SimulatedRobot
from hostlink.workbench.sim.run import run_over_tcp
from tests.support.daemon import Daemon, daemon
from tests.support.process import run

POLL_S = 0.2
CODES = {
    "silence": "no_bytes",
    "wrong_baud": "wrong_baud",
    "protocol_1": "protocol_1",
    "text": "text_on_line",
    "no_topics": "no_topics",
    "wrong_md5": "wrong_md5",
    "time_stops": "time_stopped",
    "small_buffer": "buffer_too_small",
    "reboots": "reboots",
    "boot_noise": "boot_noise",
    "clock": "clock_trouble",
    "stalled_wheel": "wheel_stalled",
    "runaway_wheel": "wheel_runaway",
}
DRIVEN = ("stalled_wheel", "runaway_wheel")  # a wheel shows what is wrong with it only while it is driven
FLEETING = "boot_noise"  # is named from three seconds after the boot on, until half a minute after it
Observed = dict[str, dict[str, dict[str, Any]]]  # robot -> code -> finding, over the whole time


@contextlib.asynccontextmanager
async def robots(host: Daemon, faults: dict[str, Fault]) -> AsyncIterator[None]:
    """A robot for each fault, each at an address of its own."""
    async with asyncio.TaskGroup() as tasks:
        running = []
        for number, (name, fault) in enumerate(faults.items()):
            robot = SimulatedRobot(name, clock_rate=fault.clock_rate)
            where = f"127.0.1.{number + 1}"
            running.append(tasks.create_task(run_over_tcp(robot, *host.tcp, fault=fault, local_host=where)))
        yield
        for each in running:
            each.cancel()


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def observed() -> tuple[Observed, Observed]:
    """All the faults at once on one daemon, until the API and doctor have named each of them."""
    faults = {"healthy": HEALTHY} | FAULTS
    names = {f"127.0.1.{number + 1}": name for number, name in enumerate(faults)}
    of_api: Observed = {name: {} for name in faults}
    of_doctor: Observed = {name: {} for name in faults}
    async with daemon() as host, robots(host, faults):
        while not named(of_doctor) >= set(FAULTS):
            view = await host.get("/api/links")
            note(of_api, [*view["links"], *view["ended"]], names)
            known = {robot["name"] for robot in (await host.get("/api/robots"))["robots"]}
            for name in known.intersection(DRIVEN):  # what commands it before is disarmed
                await host.rest("PUT", f"/api/robots/{name}/velocity", b'{"linear": 0.3, "angular": 0.0}')
            if FLEETING in named(of_api) - named(of_doctor) or named(of_api) >= set(FAULTS):
                status, out, err = await run("doctor", "--json", "--url", host.url)
                assert (status, err) == (1, "")
                note(of_doctor, json.loads(out)["links"], names)
            await asyncio.sleep(POLL_S)
    return of_api, of_doctor


def named(found: Observed) -> set[str]:
    """Return the faults that have been named."""
    return {name for name in FAULTS if CODES[name] in found[name]}


def note(found: Observed, links: list[dict[str, Any]], names: dict[str, str]) -> None:
    for link in links:
        name = names[link["peer"].rpartition(":")[0]]
        found[name] |= {each["code"]: each for each in link["diagnosis"]}


@pytest.mark.parametrize("fault", FAULTS)
async def test_fault_of_a_device_is_named_by_the_api_and_by_doctor(
    fault: str, observed: tuple[Observed, Observed]
) -> None:
    for found in observed:
        assert CODES[fault] in found[fault]
        assert set(found[fault]) <= {CODES[fault], "went_silent"}


async def test_healthy_robot_has_no_findings(observed: tuple[Observed, Observed]) -> None:
    assert [found["healthy"] for found in observed] == [{}, {}]
