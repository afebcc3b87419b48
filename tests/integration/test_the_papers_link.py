"""Twenty minutes of the paper's link in virtual time: a lost segment every minute, two cuts, 38400 baud."""

import asyncio

import pytest
from structlog.testing import capture_logs

from tests.support.link_report import Account
from tests.support.virtual_device import NumberedRobot
from tests.support.virtual_loop import run_virtual
from tests.support.virtual_world import CATALOG, world
from tools.fault_script import parse

DRIVE_S = 1200
SCRIPT = ("seed 1", "every 60 lose", "at 5min cut", "at 15min cut")
COMMAND_INTERVAL_S = 0.1


async def drive(loop_s: float) -> Account:
    """Send commands and odometry ten times a second each."""
    robot = NumberedRobot(CATALOG)
    robot.publish_every = round(0.1 / loop_s)
    with capture_logs():
        async with world(parse(SCRIPT), robot, loop_s=loop_s) as made:
            for _ in range(round(DRIVE_S / COMMAND_INTERVAL_S)):
                made.command()
                await asyncio.sleep(COMMAND_INTERVAL_S)
            await asyncio.sleep(1.0)
            account = Account(poses_sent=robot.sent, commands_sent=made.commands)
            account.poses_received = [
                (at_s, int(number)) for (at_s, _), number in zip(made.poses, made.numbers, strict=True)
            ]
            account.obeyed(robot.commands)
            account.faults = [(at_s, what) for at_s, what, _ in made.reported]
    return account


@pytest.mark.long
def test_lossy_link_loses_no_message_outside_the_cuts() -> None:
    """The device's loop drains the UART before its ring is full, as the robot's own firmware does."""
    account = run_virtual(drive(1 / 60))
    assert len(account.commands_sent) >= 0.99 * DRIVE_S / COMMAND_INTERVAL_S
    assert len(account.poses_sent) >= 0.99 * DRIVE_S * 10
    lost = account.lost()
    assert (lost["odometry"][0], lost["commands"][0]) == (0, 0)
    assert lost["odometry"][1] + lost["commands"][1] <= 2 * 2 * 10
    assert [window.recovery_s < 1.5 for window in account.windows()] == [True, True]
    assert (
        account.largest_gap_s(account.poses_received, at_cuts=False) < 1.5
    )  # the longest wait for a segment, and a turn of the loop
    assert account.largest_gap_s(account.commands_obeyed, at_cuts=False) < 1.5
