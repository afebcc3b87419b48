"""RobotsHere: requests of other daemons reach the robots of this daemon alone."""

import asyncio

import pytest

from hostlink.core.host import Host, Participant
from hostlink.core.robot.velocity import ZERO, PlanarVelocity
from hostlink.errors import CommandRefused, DeviceGone, RefusalKind, UnknownTopic
from tests.support.gates import drive_gate
from tests.support.hosts import host_in
from tests.support.memory_hub import MemoryHub, in_hub, velocities
from tests.support.remote_robots import RecordingHosts, connected_robot, reach
from tests.support.virtual_loop import inside

SLOW = PlanarVelocity(0.1)


def joined(made: MemoryHub) -> tuple[Host, Participant]:
    host = host_in(made.hub, "fleet")
    return host, host.join("pad at desk", group="fleet")


@inside(in_hub)
async def test_robot_is_described_in_short_and_an_unknown_one_is_an_error(made: MemoryHub) -> None:
    host, _ = joined(made)
    assert (host.here.all(), host.here.get("robot_0")) == ([], None)
    with pytest.raises(UnknownTopic):
        host.here.require("robot_0")
    await made.connect()
    robot = made.robot()
    (found,) = host.here.all()
    assert found == host.here.get("robot_0")
    assert (found.name, found.link, found.epoch) == ("robot_0", robot.link.number, robot.admission.epoch)
    assert (found.lock_reason, found.also_at) == (None, ())
    assert {robot.shown.velocity, robot.shown.odometry} <= set(found.topics)
    assert host.here.state("robot_0").link == found.link
    host.here.require("robot_0")


@inside(in_hub)
async def test_no_request_of_another_daemon_reaches_a_robot_of_a_third_one(made: MemoryHub) -> None:
    """The robot is away here and connected there: what the other daemon is asked must not be asked again by it."""
    host, pad = joined(made)
    hosts = RecordingHosts()
    reach(made.hub, hosts)
    device = await made.connect()
    connected_robot(made.hub, "robot_0", hosts)
    connected_robot(made.hub, "robot_9", hosts)
    await device.aclose()
    await asyncio.sleep(0.05)
    assert made.hub.robots.find("robot_0").host == "other"
    here = host.here
    hosts.sent.clear()
    with pytest.raises(CommandRefused) as caught:
        here.drive(pad, "robot_0", SLOW)
    assert caught.value.kind is RefusalKind.NOT_CONNECTED
    for call in (here.stop, here.unlock):
        call("robot_0", by="desk")
        call(None, by="desk")
        with pytest.raises(UnknownTopic):
            call("robot_9", by="desk")
    here.lock("robot_0", "smoke")
    here.lock(None, "smoke", by="desk")
    assert made.robot().gate.lock_reason == here.boards_lock_reason == "smoke"
    assert [each.name for each in here.all()] == ["robot_0"]
    assert here.endpoints(None) == here.endpoints("robot_0") == []
    assert hosts.sent == []


@inside(in_hub)
async def test_robot_with_other_hosts_is_driven_from_here_alone_until_they_are_forgotten(made: MemoryHub) -> None:
    host, pad = joined(made)
    hosts = RecordingHosts()
    reach(made.hub, hosts)
    device = await made.connect()
    host.here.note_others("robot_0", ("desk",))
    host.here.note_others("robot_9", ("desk",))  # which is not here
    with pytest.raises(DeviceGone, match="several robots have this name, also at desk"):
        host.here.drive(pad, "robot_0", SLOW)
    assert host.here.drive(pad, "robot_0", ZERO) == ZERO
    drive_gate(made.robot(), SLOW, owner="ann")
    await asyncio.sleep(0.05)
    assert velocities(device)[-1] == (0.1, 0.0)
    made.robot().stop()
    assert hosts.sent == [("stop", "robot_0")]
    host.close()
    assert made.robot().also_at == ()


@inside(in_hub)
async def test_source_that_commanded_before_the_robot_was_here_does_not_move_it(made: MemoryHub) -> None:
    host, pad = joined(made)
    with pytest.raises(UnknownTopic):
        host.here.require("robot_0", driver=lambda: pad)
    await made.connect()
    with pytest.raises(CommandRefused):
        host.here.drive(pad, "robot_0", SLOW)
    assert host.here.drive(host.join("other", group="fleet"), "robot_0", SLOW) == SLOW
