"""Epochs of the single commands of a script."""

import pytest

from hostlink.client import connect
from hostlink.robot.admission import EARLIER_EPOCH
from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, robot_topics


@pytest.mark.parametrize("is_current", [False, True])
async def test_command_with_an_epoch_of_its_own_begins_another_stream(*, is_current: bool) -> None:
    """Later commands continue the new stream, not the stream before, whose epoch may be the current one."""
    async with daemon() as host, fake_device(host.tcp, robot_topics()), connect(host.url) as me:
        robot = me.robot("robot_0")
        await robot.command(0.2, 0.0)
        await me.settle()
        assert robot.refusal is None
        current = host.hub.robots.find("robot_0").gate.admission.epoch
        for epoch in (current if is_current else EARLIER_EPOCH, None, None):
            await robot.command(0.2, 0.0, epoch=epoch)
            await me.settle()
            assert (robot.refusal is None) == is_current


async def test_command_that_is_not_planar_is_refused_and_ends_no_stream() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()), connect(host.url) as me:
        robot = me.robot("robot_0")
        await robot.command(0.2, 0.0)
        await me.settle()
        await robot.command(0.0, 0.0, is_planar=False)
        await me.settle()
        assert robot.refusal is not None
        assert robot.refusal.kind == "unsupported"
        host.hub.robots.find("robot_0").stop()
        await robot.command(0.2, 0.0)
        await me.settle()
        assert robot.refusal.kind == "disarmed"
