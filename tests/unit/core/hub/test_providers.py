"""Providers of robots of other hosts: what they raise, or never return, delays no stop of a robot here."""

import asyncio
import contextlib
from collections.abc import Callable, Hashable
from typing import Any

import pytest

from hostlink.core.hub.providers import SETTLE_TIMEOUT_S, Provision
from hostlink.core.hub.remote_robot import RemoteRobot
from hostlink.core.robot.admission import Command
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import DeviceGone
from tests.support.gates import drive_gate
from tests.support.memory_hub import MemoryHub, in_hub, velocities
from tests.support.remote_robots import RecordingHosts, connected_robot
from tests.support.virtual_loop import inside

SLOW = PlanarVelocity(0.1)
Order = Callable[[MemoryHub], object]


class Broken(RecordingHosts):
    """Provider with a bug in the methods of these names."""

    def __init__(self, *broken: str) -> None:
        super().__init__()
        self.broken = broken

    def _call(self, name: str) -> None:
        if name in self.broken:
            raise ZeroDivisionError(f"a bug in {name}")

    def drive(self, robot: RemoteRobot, command: Command[PlanarVelocity]) -> None:
        super().drive(robot, command)
        self._call("drive")

    def stop(self, name: str | None) -> None:
        super().stop(name)
        self._call("stop")

    def lock(self, name: str | None, reason: str) -> None:
        super().lock(name, reason)
        self._call("lock")

    def unlock(self, robot: RemoteRobot) -> None:
        super().unlock(robot)
        self._call("unlock")

    def unlock_all(self) -> None:
        super().unlock_all()
        self._call("unlock_all")

    def release(self, owner: Hashable) -> None:
        super().release(owner)
        self._call("release")

    async def settled(self) -> list[CommandEndpoint]:
        self._call("settled")
        return await super().settled()


class Hanging(RecordingHosts):
    """Provider that answers nothing."""

    async def settled(self) -> list[CommandEndpoint]:
        await asyncio.Event().wait()
        return []


def reached(made: MemoryHub, hosts: RecordingHosts, failures: list[Exception]) -> Provision:
    provision = Provision(hosts, "cloud", failures.append)
    made.hub.gates.providers.add(provision)
    return provision


@contextlib.asynccontextmanager
async def driven(made: MemoryHub) -> Any:
    device = await made.connect()
    drive_gate(made.robot(), SLOW, owner="ann")
    await asyncio.sleep(0.05)
    assert velocities(device)[-1] == (0.1, 0.0)
    yield device


@pytest.mark.parametrize(
    ("broken", "order"),
    [
        ("stop", lambda made: made.hub.robots.stop_all()),
        ("lock", lambda made: made.hub.robots.lock_all("smoke")),
        ("release", lambda made: made.hub.gates.release("ann")),
    ],
)
@inside(in_hub)
async def test_bug_of_a_provider_keeps_no_robot_here_from_its_stop_and_is_an_error_for_its_caller(
    made: MemoryHub, broken: str, order: Order
) -> None:
    failures, other = list[Exception](), RecordingHosts()
    reached(made, Broken(broken), failures)
    reached(made, other, failures)
    async with driven(made) as device:
        order(made)
        await asyncio.sleep(0.3)
        assert velocities(device)[-1] == (0.0, 0.0)
        assert [sent[0] for sent in other.sent] == [broken]
        with pytest.raises(DeviceGone, match=f"cloud: the component has failed: .*a bug in {broken}"):
            await made.hub.gates.settled()
    assert [type(error) for error in failures] == [ZeroDivisionError]
    assert other.sent[-1] == ("settled",)


@inside(in_hub)
async def test_provider_that_fails_is_sent_no_further_command(made: MemoryHub) -> None:
    hosts, failures = Broken("drive", "unlock"), list[Exception]()
    robot = connected_robot(made.hub, "robot_7", hosts)
    robot.provision = Provision(hosts, "cloud", failures.append)
    for _ in range(2):
        with pytest.raises(DeviceGone, match="cloud: the component has failed"):
            drive_gate(robot, SLOW, owner="ann")
    with pytest.raises(DeviceGone, match="cloud: the component has failed"):
        robot.unlock()
    with pytest.raises(DeviceGone, match="cloud: the component has failed"):
        await robot.answer("ann")
    assert ([sent[0] for sent in hosts.sent], len(failures)) == (["drive"], 1)


class Answering(RecordingHosts):
    """Provider whose answer to a command has a bug."""

    async def answer(self, robot: RemoteRobot, owner: Hashable) -> PlanarVelocity:
        raise ZeroDivisionError(f"a bug in the answer to {owner} of {robot.name}")


@inside(in_hub)
async def test_bug_in_an_answer_is_an_error_for_its_caller_and_ends_the_component(made: MemoryHub) -> None:
    hosts, failures = Answering(), list[Exception]()
    robot = connected_robot(made.hub, "robot_7", hosts)
    robot.provision = Provision(hosts, "cloud", failures.append)
    program = made.hub.join("program")
    program.drive(robot, SLOW)
    with pytest.raises(DeviceGone, match=r"cloud: the component has failed: .*a bug in the answer"):
        await program.driven(robot, SLOW)
    assert len(failures) == 1


@pytest.mark.parametrize("broken", ["unlock", "unlock_all", "settled"])
@inside(in_hub)
async def test_unlock_or_answer_that_fails_is_an_error_for_its_caller(made: MemoryHub, broken: str) -> None:
    hosts, failures = Broken(broken), list[Exception]()
    robot = connected_robot(made.hub, "robot_7", hosts)
    robot.provision = reached(made, hosts, failures)
    unlock = robot.unlock if broken == "unlock" else made.hub.robots.unlock_all
    with contextlib.suppress(DeviceGone):
        unlock()
    with pytest.raises(DeviceGone, match=f"a bug in {broken}"):
        await made.hub.gates.settled()
    assert len(failures) == 1


@inside(in_hub)
async def test_provider_that_never_returns_is_named_after_a_while_and_the_others_are_heard(made: MemoryHub) -> None:
    other = RecordingHosts()
    provision = reached(made, Hanging(), [])
    reached(made, other, [])
    async with driven(made) as device:
        made.hub.robots.stop_all()
        began_s = made.now_s
        with pytest.raises(DeviceGone, match="cloud: it has not answered"):
            await made.hub.gates.settled()
        assert made.now_s - began_s == pytest.approx(SETTLE_TIMEOUT_S)
        assert velocities(device)[-1] == (0.0, 0.0)
    assert other.sent == [("stop", None), ("settled",)]
    made.hub.gates.providers.remove(provision)
    assert await made.hub.gates.settled() == []
