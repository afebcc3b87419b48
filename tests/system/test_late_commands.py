"""Loads on hostlink while a robot is driven: no velocity is obeyed that is older than its lease."""

import asyncio
import contextlib
import signal
import sys
import time
from pathlib import Path

import pytest

from tests.support.background import meanwhile
from tests.support.core_part import can_limit
from tests.support.fake_device import fake_device, pose, repeating, robot_topics
from tests.support.late_commands import Heard, listen, measure, running
from tests.support.process import serve

pytestmark = pytest.mark.alone

LEASE_S = 0.5
# The device's end, in this process, waits for a core during the load; without bounds velocities are 4 to 17 s old.
SLACK_S = 0.5
STOP_S = 0.5  # 0.02 s on a quiet machine; 0.5 to 1 s without bounds
MOST_MIB = 250  # docs/reliability.md


@pytest.mark.parametrize(
    ("load", "connections"), [pytest.param("uploads", 200, marks=pytest.mark.long), ("bodies", 60)]
)
async def test_bodies_of_a_megabyte_delay_no_velocity_and_no_stop(tmp_path: Path, load: str, connections: int) -> None:
    outcome = await measure([load], folder=tmp_path, connections=connections, has_stops=True)
    assert len(outcome.ages_s) > 20, outcome
    assert max(outcome.ages_s) < LEASE_S + SLACK_S, outcome
    assert outcome.zero_s < LEASE_S + SLACK_S, outcome
    assert sorted(outcome.stops_s)[len(outcome.stops_s) // 2] < STOP_S, outcome
    assert outcome.most_mib < outcome.before_mib + 64, outcome


@pytest.mark.long
async def test_latched_megabytes_of_sixty_clients_stay_within_the_budget(tmp_path: Path) -> None:
    outcome = await measure(["latched"], folder=tmp_path, connections=60)
    assert outcome.most_mib < MOST_MIB, outcome
    assert max(outcome.ages_s) < LEASE_S + SLACK_S, outcome


@pytest.mark.long
@pytest.mark.skipif(not can_limit(), reason="no control group can be written")
async def test_daemon_with_an_eighth_of_a_core_obeys_no_velocity_older_than_its_lease(tmp_path: Path) -> None:
    outcome = await measure(["metrics", "bodies"], folder=tmp_path, connections=6, part=0.12, drive_s=5.0)
    assert max(outcome.ages_s, default=0.0) < LEASE_S + SLACK_S, outcome
    assert outcome.zero_s < LEASE_S + SLACK_S, outcome


@pytest.mark.parametrize("send_buffer_bytes", [0, pytest.param(4096, marks=pytest.mark.long)])
async def test_device_that_logs_more_than_is_read_and_hangs_moves_the_robot_no_longer_than_a_lease(
    send_buffer_bytes: int,
) -> None:
    """Without the rule of arrivals, its robot moves for 8 s by the commands that wait in the two kernels."""
    heard = Heard()
    async with serve() as host, contextlib.AsyncExitStack() as stack:
        device = await stack.enter_async_context(fake_device(host.tcp, robot_topics()))
        await stack.enter_async_context(repeating(device, pose(0.0)))
        await host.read_log("robot.appeared")
        await stack.enter_async_context(meanwhile(listen(device, heard)))
        flags = ("--log-bytes-s", "2000000", "--send-buffer-bytes", str(send_buffer_bytes))
        words = (sys.executable, "-m", "tests.support.logging_driver", host.tcp[0], str(host.tcp[1]), *flags)
        driver = await stack.enter_async_context(running(words))
        assert driver.stdout is not None
        await driver.stdout.readline()  # it begins
        await asyncio.sleep(3.0)
        driver.send_signal(signal.SIGSTOP)
        hung_s = time.monotonic()
        await asyncio.sleep(LEASE_S + SLACK_S + 3.0)
    assert heard.velocities
    assert max(heard.ages_s(), default=0.0) < LEASE_S + SLACK_S, heard.ages_s()
    assert max((at_s for at_s, speed in heard.velocities if speed), default=0.0) < hung_s + LEASE_S + SLACK_S
