"""Driving by the client: what it repeats, what breaks that off, and what the program is told. In virtual time."""

import asyncio
import contextlib
import itertools
import math
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass

import pytest

from hostlink.client import Driven, Refusal, Robot, driver
from hostlink.core.hub.robot import LocalRobot
from hostlink.core.robot.admission import EARLIER_EPOCH, LEASE_S
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.core.robot.events import LET_GO, WAS_STOPPED, EventKind, RobotEvent
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.robot.velocity_gate import VelocityGate
from hostlink.errors import CommandRefused, HostlinkError, RefusalKind
from tests.support.fake_device import robot_topics
from tests.support.gates import drive_gate
from tests.support.memory_client import MemoryHost, memory_host
from tests.support.participants import NEIGHBOUR, ROBOT, Scene, scene
from tests.support.remote_robots import RecordingHosts, reach
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import virtual

HELD_BY_PERSON = "robot_0: a person drives it with a higher priority; wait until it lets go, or use stop"
INTERRUPTED = "it was stopped, locked or reconnected while this source was driving"
SENT_S = 0.05  # in which a velocity reaches the device
REPEATED_S = 0.25  # in which a repetition is refused, and the client reads it


@dataclass
class World:
    """Two programs, and the robot that they drive."""

    made: Scene
    me: MemoryHost
    other: MemoryHost

    @property
    def robot(self) -> Robot:
        return self.me.robot(ROBOT)

    @property
    def known(self) -> LocalRobot:
        """The robot in the daemon."""
        return self.made.hub.robots.find_here(ROBOT)

    @property
    def gate(self) -> VelocityGate[PlanarVelocity]:
        return self.known.gate

    async def refused(self, *, name: str = ROBOT, linear_m_s: float = 0.2) -> str:
        """Return the reason why a drive is refused."""
        with pytest.raises(HostlinkError) as caught:
            await self.me.robot(name).drive(linear_m_s, 0.0)
        return str(caught.value)

    async def command(self, linear_m_s: float, *, epoch: int | None = None, is_planar: bool = True) -> str | None:
        """Command once, and return the kind of the refusal."""
        await self.robot.command(linear_m_s, 0.0, epoch=epoch, is_planar=is_planar)
        refusal = self.robot.refusal
        return None if refusal is None else refusal.kind

    async def connect_again(self) -> None:
        """The device connects again, and its old connection ends."""
        await self.made.robot.aclose()
        self.made.robot = ScriptedDevice(self.made.hub, robot_topics(ROBOT), address="10.0.0.1")
        await asyncio.sleep(REPEATED_S)

    def drive_as_a_person(self) -> None:
        """Drive with the priority of a person at the keys."""
        drive_gate(self.known, PlanarVelocity(0.1), owner="a person", priority=60)


@contextlib.asynccontextmanager
async def world() -> AsyncIterator[World]:
    async with (
        scene() as made,
        memory_host(made.hub, made.tasks) as me,
        memory_host(made.hub, made.tasks) as other,
    ):
        yield World(made, me, other)


# -- velocities that are repeated -------------------------------------------------------------------------------------


@virtual
async def test_drive_is_repeated_and_returns_what_the_limits_made_of_it() -> None:
    async with world() as here:
        assert await here.robot.drive(0.2, 0.5) == Driven(0.2, 0.5, is_limited=False, limited_by=None)
        await asyncio.sleep(3 * LEASE_S)
        assert here.gate.current == PlanarVelocity(0.2, 0.0, 0.5)
        assert here.gate.owner_name == here.robot.client_name
        assert here.robot.is_driven
        limited = await here.robot.drive(2.0, 1.0)
        assert limited == Driven(1.0, 0.5, is_limited=True, limited_by="max_linear_m_s")
        assert (await here.robot.drive(0.0, -40.0)).limited_by == "max_angular_rad_s"


@virtual
async def test_stop_stops_and_nothing_is_repeated() -> None:
    async with world() as here:
        await here.robot.drive(0.2, 0.0)
        await here.robot.stop()
        assert not here.robot.is_driven
        before = len(here.made.speeds())
        await asyncio.sleep(LEASE_S)
        assert set(here.made.speeds()[before - 1 :]) == {0.0}
        assert here.gate.owner_name is None


class Unanswered(RecordingHosts):
    """Another daemon, which answers nothing."""

    async def settled(self) -> list[CommandEndpoint]:
        await asyncio.Event().wait()
        return []


@virtual
async def test_stop_that_is_not_answered_delays_no_stop_of_another_robot() -> None:
    """The daemon answers after other daemons have answered, and one of them may be gone."""
    async with world() as here:
        names = (ROBOT, NEIGHBOUR)
        await asyncio.sleep(LEASE_S)  # the neighbour has let go
        for name in names:
            await here.me.robot(name).drive(0.2, 0.0)
        provision = reach(here.made.hub, Unanswered())
        now_s = asyncio.get_running_loop().time
        began_s = now_s()
        await here.me.stop_driven()
        await asyncio.sleep(0.01)  # the daemon handles the request in a later turn
        assert now_s() - began_s == pytest.approx(0.01)
        assert all(here.made.hub.robots.find_here(name).gate.current.is_zero for name in names)
        assert not any(here.me.robot(name).is_driven for name in names)
        here.made.hub.gates.providers.remove(provision)


@virtual
async def test_drive_that_cannot_be_is_refused_at_once_and_not_repeated() -> None:
    async with world() as here:
        assert await here.refused(name="robot_9") == "no robot named robot_9; known: robot_0, robot_1"
        assert await here.refused(linear_m_s=math.nan) == "robot_0: a velocity must be made of finite numbers"
        here.drive_as_a_person()
        assert await here.refused() == HELD_BY_PERSON
        assert not here.robot.is_driven
        await here.me.robot(ROBOT, priority=70).drive(0.2, 0.0)
        assert here.gate.current == PlanarVelocity(0.2)


@virtual
async def test_drive_of_a_device_that_left_is_broken_off_and_refused() -> None:
    async with world() as here:
        await here.robot.drive(0.2, 0.0)
        await here.made.robot.aclose()
        await asyncio.sleep(REPEATED_S)
        assert not here.robot.is_driven
        for _ in range(2):
            assert "its device is not connected" in await here.refused()  # what broke the velocity off
        await asyncio.sleep(LEASE_S)
        assert await here.refused() == "robot_0: its device is not connected"
        await here.connect_again()


@pytest.mark.parametrize("wrong", [math.nan, "fast"])
@virtual
async def test_velocity_that_is_not_finite_ends_the_earlier_drive(wrong: float) -> None:
    async with world() as here:
        await here.robot.drive(0.2, 0.0)
        with pytest.raises((HostlinkError, TypeError, ValueError)):
            await here.robot.drive(wrong, 0.0)
        assert not here.robot.is_driven
        await asyncio.sleep(LEASE_S + SENT_S)
        assert here.gate.owner_name is None
        await here.robot.drive(0.1, 0.0)


@virtual
async def test_repeated_velocity_that_is_overruled_is_dropped_and_each_drive_raises_until_the_program_lets_go() -> None:
    async with world() as here:
        await here.robot.drive(0.2, 0.0)
        here.drive_as_a_person()
        await asyncio.sleep(REPEATED_S)
        assert not here.robot.is_driven
        here.made.hub.gates.release("a person")
        for _ in range(9):
            await asyncio.sleep(LEASE_S - 0.1)
            assert await here.refused() == f"robot_0 was stopped: {HELD_BY_PERSON}; {driver.LET_GO}"
        await here.robot.drive(0.0, 0.0)
        await here.robot.drive(0.3, 0.0)
        assert here.gate.current == PlanarVelocity(0.3)


@virtual
async def test_program_that_drives_again_and_again_is_refused_each_time_when_the_device_connected_again() -> None:
    async with world() as here:
        await here.robot.drive(0.2, 0.0)
        await here.connect_again()
        assert set(here.made.speeds()) == {0.0}  # an earlier command does not drive the new connection
        refusals = []
        for _ in range(20):
            try:
                await here.robot.drive(0.2, 0.0)
            except HostlinkError as error:
                refusals.append(str(error))
            await asyncio.sleep(0.01)
        assert len(refusals) == 20
        assert "not connected" in refusals[0] or INTERRUPTED in refusals[0]
        assert set(here.made.speeds()) == {0.0}
        await asyncio.sleep(LEASE_S)
        await here.robot.drive(0.2, 0.0)
        await asyncio.sleep(SENT_S)
        assert here.made.speeds()[-1] == 0.2


@virtual
async def test_stop_by_another_program_ends_a_drive_and_the_next_raises_unless_it_resumes() -> None:
    async with world() as here:
        await here.robot.drive(0.2, 0.0)
        await here.other.robot(ROBOT).stop()
        await asyncio.sleep(REPEATED_S)
        assert not here.robot.is_driven
        assert here.gate.owner_name is None
        assert INTERRUPTED in await here.refused()
        await here.robot.drive(0.2, 0.0, resume=True)


@virtual
async def test_lock_by_another_program_drops_the_velocity_and_the_unlock_moves_nothing() -> None:
    async with world() as here:
        await here.robot.drive(0.2, 0.0)
        await here.other.robot(ROBOT).lock("somebody stands there")
        await asyncio.sleep(REPEATED_S)
        assert not here.robot.is_driven
        await here.other.robot(ROBOT).unlock()
        assert "somebody stands there" in await here.refused()
        assert here.gate.owner_name is None
        await here.robot.stop(wait_s=0)
        await here.robot.drive(0.2, 0.0)


@virtual
async def test_program_drives_at_once_after_its_own_unlock() -> None:
    async with world() as here:
        other = here.other.robot(ROBOT)
        for locker in (here.robot, other):
            await here.robot.drive(0.2, 0.0)
            await locker.lock("somebody stands there", wait_s=0)
            await asyncio.sleep(REPEATED_S)
            assert not here.robot.is_driven
            await here.robot.unlock()
            assert here.gate.owner_name is None
            await here.robot.drive(0.2, 0.0)
        await here.robot.lock("somebody stands there", wait_s=0)
        await here.robot.unlock()
        await other.stop(wait_s=0)
        assert INTERRUPTED in await here.refused()


@virtual
async def test_epoch_of_an_own_unlock_is_of_no_use_after_a_lease() -> None:
    """The program has stopped driving by then, and later interruptions do not concern it."""
    async with world() as here:
        await here.robot.lock("somebody stands there", wait_s=0)
        await here.robot.unlock()
        await here.other.robot(ROBOT).stop(wait_s=0)
        await asyncio.sleep(LEASE_S + 0.1)
        await here.robot.drive(0.2, 0.0)


@virtual
async def test_program_drives_at_once_after_its_own_stop_of_all() -> None:
    async with world() as here:
        await asyncio.sleep(LEASE_S)  # the neighbour has let go
        for wait_s in (0.0, 0.1):
            await here.robot.drive(0.2, 0.0)
            assert (await here.me.stop_all(wait_s=wait_s)).keys() == {ROBOT, NEIGHBOUR}
            assert not here.robot.is_driven
            await here.robot.drive(0.2, 0.0)


@virtual
async def test_drive_that_is_cancelled_is_followed_by_a_zero() -> None:
    """A cancelled command may be on its way, and a person who ends a program does not wait for the end of a lease."""
    async with world() as here:
        here.me.connection_.delay_s = 0.1
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.05):
                await here.robot.drive(0.2, 0.0)
        assert not here.robot.is_driven
        await asyncio.sleep(0.1 + SENT_S)
        assert here.gate.counts.commands == 2
        assert here.gate.current.is_zero
        assert here.made.speeds()[-1] == 0.0


# -- two drivers ------------------------------------------------------------------------------------------------------


async def drive_on(robot: Robot, linear_m_s: float, errors: list[HostlinkError], **how: bool) -> None:
    """Drive again and again, as a program that ignores every error."""
    while True:
        try:
            await robot.drive(linear_m_s, 0.0, **how)
        except HostlinkError as error:
            errors.append(error)
        await asyncio.sleep(0.1)


def changes_of_sign(speeds_m_s: list[float]) -> int:
    moving = [speed_m_s for speed_m_s in speeds_m_s if speed_m_s]
    return sum(before * after < 0 for before, after in itertools.pairwise(moving))


@pytest.mark.parametrize("take_over", [False, True])
@virtual
async def test_two_programs_with_opposite_velocities_do_not_shake_the_robot(*, take_over: bool) -> None:
    async with world() as here, asyncio.TaskGroup() as tasks:
        await asyncio.sleep(LEASE_S)
        errors: dict[str, list[HostlinkError]] = {"me": [], "other": []}
        programs = {"me": (here.me, 0.2), "other": (here.other, -0.2)}
        began = len(here.made.speeds())
        driving = []
        for name, (host, speed_m_s) in programs.items():
            driving.append(tasks.create_task(drive_on(host.robot(ROBOT), speed_m_s, errors[name], take_over=take_over)))
            await asyncio.sleep(0.05)
        await asyncio.sleep(3.0)
        heard = here.made.speeds()[began:]
        assert changes_of_sign(heard) == take_over  # the one of the first take-over
        assert heard[-1] == (-0.2 if take_over else 0.2)
        refused = errors["me" if take_over else "other"]
        assert len(refused) > 20
        driver = (here.other if take_over else here.me).robot(ROBOT)
        loser = (here.me if take_over else here.other).robot(ROBOT)
        for error in refused:
            assert isinstance(error, CommandRefused)
            assert (error.kind, error.holder, error.by) == (RefusalKind.HELD, driver.client_name, driver.client_name)
            assert str(driver.client_name) in str(error)
        assert (driver.is_driven, loser.is_driven) == (True, False)
        for each in driving:
            each.cancel()


@virtual
async def test_program_takes_the_robot_over_and_the_other_takes_it_back_after_it_let_go() -> None:
    async with world() as here:
        mine, theirs = here.robot, here.other.robot(ROBOT)
        await mine.drive(0.2, 0.0)
        with pytest.raises(CommandRefused, match="same priority"):
            await theirs.drive(-0.2, 0.0)
        await theirs.drive(-0.2, 0.0, take_over=True)
        await asyncio.sleep(REPEATED_S)
        assert (here.gate.current.x_m_s, mine.is_driven) == (-0.2, False)
        with pytest.raises(CommandRefused, match="has taken it over"):
            await mine.drive(0.2, 0.0, take_over=True)
        await mine.drive(0.2, 0.0, take_over=True, resume=True)
        await asyncio.sleep(REPEATED_S)
        assert (here.gate.current.x_m_s, theirs.is_driven) == (0.2, False)


@virtual
async def test_repetition_takes_no_robot_over() -> None:
    """A program that was late, and whose lease has ended, takes nothing from who drives since."""
    async with world() as here:
        await here.robot.drive(0.2, 0.0, take_over=True)
        here.gate.stop(now_s=asyncio.get_running_loop().time())
        drive_gate(here.known, PlanarVelocity(0.1), owner="another", priority=50)
        await asyncio.sleep(REPEATED_S)
        assert here.gate.owner == "another"
        assert not here.robot.is_driven


@virtual
async def test_zero_that_is_repeated_while_another_drives_breaks_nothing_off() -> None:
    async with world() as here:
        await here.robot.drive(0.0, 0.0)
        theirs = here.other.robot(ROBOT)
        await theirs.drive(-0.2, 0.0)
        await asyncio.sleep(2 * LEASE_S)
        assert here.gate.current.x_m_s == -0.2
        await theirs.stop(wait_s=0)
        assert here.robot.is_driven
        await here.robot.drive(0.2, 0.0)


async def stopped(here: World) -> None:
    await here.other.robot(ROBOT).stop(wait_s=0)


async def locked_and_unlocked(here: World) -> None:
    await here.other.robot(ROBOT).lock("smoke", wait_s=0)
    await asyncio.sleep(0.5)
    await here.other.robot(ROBOT).unlock()


async def connected_again(here: World) -> None:
    await here.connect_again()


async def taken_over(here: World) -> None:
    other = here.other.robot(ROBOT)
    await other.drive(0.1, 0.0, take_over=True)
    await asyncio.sleep(1.0)
    await other.stop(wait_s=0)


async def overruled(here: World) -> None:
    here.drive_as_a_person()
    await asyncio.sleep(0.3)
    here.made.hub.gates.release("a person")


async def cut(here: World) -> None:
    here.me.lose()


LETS_GO: dict[str, Callable[[World], Awaitable[object]]] = {
    "a zero": lambda here: here.robot.drive(0.0, 0.0),
    "silence": lambda _: asyncio.sleep(LEASE_S + SENT_S),
    "stop": lambda here: here.robot.stop(wait_s=0),
    "resume": lambda here: here.robot.drive(0.2, 0.0, resume=True),
}


@pytest.mark.parametrize("lets_go", LETS_GO)
@pytest.mark.parametrize("interrupt", [stopped, locked_and_unlocked, connected_again, taken_over, overruled, cut])
@virtual
async def test_program_that_ignores_errors_drives_on_after_it_let_go_alone(
    interrupt: Callable[[World], Awaitable[None]], lets_go: str
) -> None:
    async with world() as here, asyncio.TaskGroup() as tasks:
        errors: list[HostlinkError] = []
        driving = tasks.create_task(drive_on(here.robot, 0.2, errors))
        await asyncio.sleep(0.5)
        assert (here.gate.current.x_m_s, errors) == (0.2, [])
        await interrupt(here)
        await asyncio.sleep(LEASE_S + SENT_S)
        before = len(here.made.speeds())
        await asyncio.sleep(3.0)
        assert len(errors) > 25
        assert set(here.made.speeds()[before - 1 :]) == {0.0}
        driving.cancel()
        await LETS_GO[lets_go](here)
        await here.robot.drive(0.2, 0.0)
        assert here.gate.current.x_m_s == 0.2


# -- programs that hang -----------------------------------------------------------------------------------------------

IDLE = "the program made no call for 10"


def ends_of_drives(here: World) -> list[object]:
    """Reasons of the stops of the robot, from now on."""
    reasons: list[object] = []

    def note(event: RobotEvent) -> None:
        if event.kind is EventKind.STOPPED and event.robot == ROBOT:
            reasons.append(event.facts["reason"])

    here.made.hub.events.observe("test", note)
    return reasons


async def read_for_ever(here: World) -> None:
    """Another task of the program reads all the time."""
    while True:
        await here.robot.state()
        await asyncio.sleep(0.1)


@pytest.mark.slow
@pytest.mark.parametrize("has_reader", [False, True])
@virtual
async def test_robot_of_a_program_that_makes_no_call_for_ten_seconds_stops_and_the_log_says_why(
    has_reader: bool, caplog: pytest.LogCaptureFixture
) -> None:
    async with world() as here, asyncio.TaskGroup() as tasks:
        reading = tasks.create_task(read_for_ever(here)) if has_reader else None
        reasons = ends_of_drives(here)
        await here.robot.drive(0.2, 0.0)
        await asyncio.sleep(9.9)
        assert here.gate.current == PlanarVelocity(0.2)
        await asyncio.sleep(0.4)
        assert here.gate.current.is_zero
        assert here.made.speeds()[-1] == 0.0
        await asyncio.sleep(2 * LEASE_S)
        assert [str(each).startswith(IDLE) for each in reasons] == [True]
        assert caplog.messages[0].startswith(f"robot_0 stopped: {IDLE}")
        assert "keep=True" in await here.refused()
        await here.robot.drive(0.2, 0.0, resume=True)
        if reading is not None:
            reading.cancel()


async def heard(here: World) -> None:
    """The program reads a message of another one."""
    async with here.me.subscribe("/lamp", type_name="std_msgs/Bool") as lamps:
        await here.other.publish("/lamp", {"data": True})
        await anext(lamps)


@pytest.mark.slow
@pytest.mark.parametrize(
    "call",
    [
        lambda here: here.robot.state(),
        lambda here: here.me.topics(),
        lambda here: here.me.publish("/lamp", {"data": True}, type_name="std_msgs/Bool"),
        heard,
    ],
    ids=["state", "topics", "publish", "subscribe"],
)
@virtual
async def test_robot_of_a_program_that_calls_is_driven_on(call: Callable[[World], Awaitable[object]]) -> None:
    async with world() as here:
        await here.robot.drive(0.2, 0.0)
        for _ in range(4):
            await asyncio.sleep(7.0)
            await call(here)
        assert here.gate.current == PlanarVelocity(0.2)


@virtual
async def test_call_that_waits_does_not_count() -> None:
    async with world() as here, here.me.subscribe("/nothing", type_name="std_msgs/Bool") as messages:
        await here.robot.drive(0.2, 0.0)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(12.0):
                await anext(messages)
        assert here.gate.current.is_zero


@virtual
async def test_velocity_that_is_kept_and_a_motion_need_no_call() -> None:
    async with world() as here:
        await here.robot.drive(0.2, 0.0, keep=True)
        await asyncio.sleep(60.0)
        assert here.gate.current == PlanarVelocity(0.2)
        assert (await here.robot.drive(0.1, 0.0, for_s=15.0)).is_reached


@virtual
async def test_calls_of_other_tasks_count_when_the_task_that_drove_has_ended() -> None:
    """asyncio.gather makes a task for each robot."""
    async with world() as here:
        await asyncio.gather(here.robot.drive(0.2, 0.0))  # noqa: TID251 - as users do
        for _ in range(4):
            await asyncio.sleep(7.0)
            await here.robot.state()
        assert here.gate.current == PlanarVelocity(0.2)
        await asyncio.sleep(11.0)
        assert here.gate.current.is_zero


# -- single commands --------------------------------------------------------------------------------------------------


@virtual
async def test_command_is_not_repeated_and_its_refusal_is_known_after_its_answer() -> None:
    async with world() as here:
        assert await here.command(0.2) is None
        assert (here.robot.is_driven, here.gate.counts.commands) == (False, 1)
        assert here.robot.client_name == here.gate.owner_name is not None
        here.drive_as_a_person()
        assert await here.command(0.2) == "held"
        assert here.robot.refusal == Refusal("held", HELD_BY_PERSON)
        with pytest.raises(HostlinkError, match="finite"):
            await here.robot.command(math.inf, 0.0)


@virtual
async def test_commands_that_went_on_through_a_lock_move_nothing_after_the_unlock() -> None:
    async with world() as here:
        await here.robot.lock("somebody stands there")
        assert await here.command(0.2) == "locked"
        await here.robot.unlock()
        assert await here.command(0.2) == "disarmed"
        assert await here.command(0.0) is None
        assert await here.command(0.2) is None


@pytest.mark.parametrize("is_current", [False, True])
@virtual
async def test_command_with_an_epoch_of_its_own_begins_another_stream(*, is_current: bool) -> None:
    """Later commands continue the new stream, not the stream before, whose epoch may be the current one."""
    async with world() as here:
        assert await here.command(0.2) is None
        for epoch in (here.gate.admission.epoch if is_current else EARLIER_EPOCH, None, None):
            assert await here.command(0.2, epoch=epoch) == (None if is_current else "disarmed")


@virtual
async def test_command_that_is_not_planar_is_refused_and_ends_no_stream() -> None:
    async with world() as here:
        assert await here.command(0.2) is None
        assert await here.command(0.0, is_planar=False) == "unsupported"
        here.known.stop()
        assert await here.command(0.2) == "disarmed"


# -- how a drive ends -------------------------------------------------------------------------------------------------


async def ends(here: World) -> None:
    """The program ends: it sends a zero first, which ends its drive."""
    await here.me.stop_driven()
    here.me.close()


async def drives_zero(here: World) -> None:
    await here.robot.drive(0.0, 0.0)


async def stops(here: World) -> None:
    await here.robot.stop()


@pytest.mark.parametrize(("end", "reason"), [(ends, LET_GO), (drives_zero, LET_GO), (stops, WAS_STOPPED)])
@virtual
async def test_drive_that_ends_is_reported_once_with_its_reason(
    end: Callable[[World], Awaitable[None]], reason: str
) -> None:
    async with world() as here:
        reasons: list[object] = []

        def note(event: RobotEvent) -> None:
            if event.kind is EventKind.STOPPED and event.robot == ROBOT:
                reasons.append(event.facts["reason"])

        here.made.hub.events.observe("test", note)
        await here.robot.drive(0.2, 0.0)
        await end(here)
        await asyncio.sleep(2 * LEASE_S)
        assert reasons == [reason]
