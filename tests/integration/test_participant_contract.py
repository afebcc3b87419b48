"""Contract of every kind of participant: its functions, its departure, and the isolation of all others."""

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import pytest

from hostlink.cli.demo import DRIVE, DemoDriver
from hostlink.core.hub.any_robot import AnyRobot
from hostlink.core.hub.message import Message
from hostlink.core.hub.node import Role
from hostlink.core.robot.velocity import PlanarVelocity, Twist
from hostlink.errors import BadRequest, HostlinkError
from tests.support.foreign_drivers import FOREIGN
from tests.support.participants import (
    ALL,
    ODOMETRY_ID,
    POSE,
    PROGRAMS,
    ROBOT,
    SERVICE,
    TEXT,
    TEXT_TYPE,
    Make,
    Scene,
    daemon,
    plain,
    play,
    rest,
    text,
)

# -- what each does ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", ALL)
def test_participant_publishes_and_receives(make: Make) -> None:
    async def test(made: Scene) -> None:
        one, other = make(made, Role.DRIVE), plain(made, Role.DRIVE)
        one.subscribe(TEXT)
        other.subscribe(TEXT)
        one.publish(TEXT, TEXT_TYPE, text("from it"))
        other.publish(TEXT, TEXT_TYPE, text("to it"))
        assert one.received() == other.received() == [text("from it"), text("to it")]

    play(test)


async def receives_a_pose(one: Any, made: Scene) -> None:
    pose = POSE.pack(0.1, 0.2, 0.3)
    one.subscribe(f"/{ROBOT}/odometry")
    await made.robot.send(ODOMETRY_ID, pose)
    await asyncio.sleep(0.1)
    assert one.received() == [pose]


@pytest.mark.parametrize("make", ALL)
def test_participant_receives_a_devices_message_byte_for_byte(make: Make) -> None:
    async def test(made: Scene) -> None:
        one = make(made, Role.DRIVE)
        await receives_a_pose(one, made)

    play(test)


@pytest.mark.parametrize("make", ALL)
def test_participant_serves_and_calls(make: Make) -> None:
    async def test(made: Scene) -> None:
        one, other = make(made, Role.DRIVE), plain(made, Role.DRIVE)

        async def answer(request: Mapping[str, object]) -> Mapping[str, object]:
            return {"success": request["data"], "message": "done"}

        one.serve(answer)
        calling = made.tasks.create_task(other.call(SERVICE, {"data": True}))
        for _ in range(20):
            await asyncio.sleep(0.01)
            one.settle()
        assert calling.result() == {"success": True, "message": "done"}
        assert (await one.call("/neighbour", {}))["message"] == "here"

    play(test)


@pytest.mark.parametrize("make", PROGRAMS)
def test_participant_that_may_only_read_subscribes_and_changes_nothing(make: Make) -> None:
    async def test(made: Scene) -> None:
        one = make(made, Role.READ)
        await receives_a_pose(one, made)

        async def answer(_: Mapping[str, object]) -> Mapping[str, object]:
            return {}

        forbidden: list[Callable[[], None]] = [
            lambda: one.publish(TEXT, TEXT_TYPE, text("no")),
            lambda: one.drive(ROBOT, 0.2, made.hub),
            lambda: one.serve(answer),
        ]
        for act in forbidden:
            with pytest.raises(BadRequest, match="may only read"):
                act()
        with pytest.raises(HostlinkError, match="may only read"):
            await one.call(f"/{ROBOT}/unlock", {})
        assert [use for use in made.uses_of(one.participant) if use != f"/{ROBOT}/odometry"] == []
        assert not any(made.speeds())

    play(test)


# -- how it ends ------------------------------------------------------------------------------------------------------


def uses_all(one: Any, made: Scene) -> None:
    """All that a participant can have."""

    async def answer(_: Mapping[str, object]) -> Mapping[str, object]:
        return {"success": True, "message": ""}

    one.publish(TEXT, TEXT_TYPE, text("x"))
    one.subscribe(TEXT, interval_s=10.0, queue_length=5)
    one.subscribe(f"/{ROBOT}/odometry")
    one.serve(answer)
    one.drive(ROBOT, 0.2, made.hub)


@pytest.mark.parametrize("make", ALL)
def test_leaving_releases_all_that_it_has_and_stops_what_it_drove(make: Make) -> None:
    async def test(made: Scene) -> None:
        one = make(made, Role.DRIVE)
        uses_all(one, made)
        await asyncio.sleep(0.1)
        assert made.speeds()[-1] == 0.2
        uses = Counter(made.uses_of(one.participant))
        del uses[made.hub.robots.find(ROBOT).shown.velocity]  # who drives by a message advertises it
        assert uses == {TEXT: 2, f"/{ROBOT}/odometry": 1, SERVICE: 1, ROBOT: 1}
        one.participant.leave()
        assert made.uses_of(one.participant) == []
        await asyncio.sleep(0.01)
        assert made.speeds()[-1] == 0.0
        assert not made.hub.robots.find(ROBOT).gate.admission.is_held(asyncio.get_running_loop().time())
        one.participant.leave()  # once is enough, and twice does no harm
        with pytest.raises(BadRequest, match="has left"):
            one.participant.publish(TEXT, text("late"))
        assert one.participant.flush(1e9) is None
        assert made.hub.isolation.crashes.total() == 0

    play(test)


@pytest.mark.parametrize("is_reported", [True, False], ids=["its graph reports it", "the daemon ends it"])
@pytest.mark.parametrize("make", FOREIGN)
def test_a_driver_of_a_foreign_graph_that_vanishes_leaves_a_standing_robot(make: Make, is_reported: bool) -> None:
    async def test(made: Scene) -> None:
        one, robot = make(made, Role.DRIVE), made.hub.robots.find(ROBOT)
        one.drive(ROBOT, 0.2, made.hub)
        await asyncio.sleep(0.1)
        assert made.speeds()[-1] == 0.2
        gone = one.participant
        assert ROBOT in made.uses_of(gone)
        if is_reported:
            one.vanish()
        else:
            gone.leave()
        assert gone.has_left
        assert made.uses_of(gone) == []
        await asyncio.sleep(0.01)
        assert made.speeds()[-1] == 0.0
        assert not robot.gate.admission.is_held(asyncio.get_running_loop().time())
        one.vanish()  # twice does no harm
        again = make(made, Role.DRIVE)
        again.drive(ROBOT, 0.1, made.hub)
        await asyncio.sleep(0.1)
        assert made.speeds()[-1] == 0.1
        assert made.hub.isolation.crashes.total() == 0

    play(test)


@pytest.mark.parametrize("what", ["topic", "service", "flush"])
@pytest.mark.parametrize("make", PROGRAMS)
def test_a_callback_that_fails_ends_it_alone(make: Make, what: str) -> None:
    async def test(made: Scene) -> None:
        one, other = make(made, Role.DRIVE), plain(made, Role.DRIVE)
        uses_all(one, made)
        other.subscribe(f"/{ROBOT}/odometry")
        await asyncio.sleep(0.1)
        for number in range(2):
            other.publish(TEXT, TEXT_TYPE, text(str(number)))
        one.is_failing = True
        if what == "topic":
            await made.robot.send(ODOMETRY_ID, POSE.pack(0.0, 0.0, 0.0))
        elif what == "flush":
            assert one.participant.flush(asyncio.get_running_loop().time() + 100.0) is None
        else:
            with pytest.raises(HostlinkError):
                await other.call(SERVICE, {"data": True})
        await asyncio.sleep(0.1)
        assert made.hub.isolation.crashes == {"participant": 1}
        assert one.participant.has_left
        assert made.uses_of(one.participant) == []
        assert made.speeds()[-1] == 0.0
        assert len(other.received()) == (what == "topic")

    play(test)


def test_a_part_of_the_daemon_stays_when_a_callback_of_it_fails() -> None:
    """An emergency stop that has failed once is better than none."""

    async def test(made: Scene) -> None:
        one, other = daemon(made, Role.DRIVE), plain(made, Role.DRIVE)
        uses_all(one, made)
        one.is_failing = True
        with pytest.raises(HostlinkError, match="Defect"):
            await other.call(SERVICE, {"data": True})
        assert made.hub.isolation.crashes == {"participant": 1}
        one.is_failing = False
        assert (await other.call(SERVICE, {"data": True}))["success"] is True
        assert (await other.call(f"/{ROBOT}/lock", {}))["success"] is True

    play(test)


async def never(_: Mapping[str, object]) -> Mapping[str, object]:
    """Answer no call."""
    await asyncio.sleep(1000)
    return {}


@pytest.mark.parametrize("make", ALL)
def test_participant_that_leaves_during_its_call_fails_the_call_at_once(make: Make) -> None:
    async def test(made: Scene) -> None:
        made.hub.join("slow").provide("/slow", "std_srvs/Trigger", never)
        one = make(made, Role.DRIVE)
        calling = made.tasks.create_task(_refused(one.call("/slow", {})))
        await asyncio.sleep(0.1)
        one.participant.leave()
        await asyncio.sleep(0.1)
        assert calling.done()
        assert "has left" in calling.result()
        assert not one.participant._calls

    play(test)


@pytest.mark.parametrize("make", ALL)
def test_participant_that_leaves_while_it_is_called_fails_its_callers_at_once(make: Make) -> None:
    async def test(made: Scene) -> None:
        one, other = make(made, Role.DRIVE), plain(made, Role.DRIVE)
        one.serve(never)
        calling = made.tasks.create_task(_refused(other.call(SERVICE, {"data": True})))
        await asyncio.sleep(0.1)
        one.settle()
        await asyncio.sleep(0.1)
        one.participant.leave()
        await asyncio.sleep(0.1)
        assert calling.done()
        assert "no service named /switch" in calling.result()

    play(test)


@pytest.mark.parametrize("make", PROGRAMS)
def test_participant_that_leaves_as_a_call_of_its_service_times_out_releases_everything(make: Make) -> None:
    async def test(made: Scene) -> None:
        one, loop = make(made, Role.DRIVE), asyncio.get_running_loop()
        one.serve(never)
        caller = made.hub.join("asker")
        calling = made.tasks.create_task(_refused(caller.call(SERVICE, {"data": True}, timeout_s=0.2)))
        one.drive(ROBOT, 0.2, made.hub)
        left: asyncio.Future[None] = loop.create_future()
        same_turn_s = 5e-7  # within the resolution of the clock
        loop.call_later(0.2 + same_turn_s, lambda: left.set_result(one.participant.leave()))
        async with asyncio.timeout(1.0):
            await left
        await asyncio.sleep(0.1)
        assert SERVICE in calling.result()
        assert made.uses_of(one.participant) == []
        assert made.speeds()[-1] == 0.0

    play(test)


async def _refused(call: Awaitable[object]) -> str:
    try:
        await call
    except HostlinkError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("make", [plain, rest, daemon])
def test_participant_that_leaves_in_its_own_callback_disturbs_no_other(make: Make) -> None:
    async def test(made: Scene) -> None:
        one, other = make(made, Role.DRIVE), plain(made, Role.DRIVE)
        one.participant.subscribe(f"/{ROBOT}/odometry", lambda _: one.participant.leave())
        other.subscribe(f"/{ROBOT}/odometry")
        one.drive(ROBOT, 0.2, made.hub)
        for _ in range(2):
            await made.robot.send(ODOMETRY_ID, POSE.pack(0.0, 0.0, 0.0))
        await asyncio.sleep(0.1)
        assert len(other.received()) == 2
        assert made.speeds()[-1] == 0.0
        assert made.hub.isolation.crashes.total() == 0

    play(test)


def test_participant_whose_callback_drives_and_calls_itself_ends_alone() -> None:
    async def test(made: Scene) -> None:
        looping, watching = plain(made, Role.DRIVE), plain(made, Role.DRIVE)
        robot, sent = made.hub.robots.find(ROBOT), plain(made, Role.DRIVE)

        def send_again(message: Message) -> None:
            looping.participant.drive(robot, Twist.decode(message.payload).planar)

        looping.participant.subscribe(robot.shown.velocity, send_again)
        watching.subscribe(robot.shown.velocity)
        sent.drive(ROBOT, 0.2, made.hub)
        await asyncio.sleep(0.1)
        assert looping.participant.has_left
        assert not watching.participant.has_left
        assert made.hub.isolation.crashes == {"participant": 1}
        sent.drive(ROBOT, 0.2, made.hub)
        await asyncio.sleep(0.1)
        assert made.speeds()[-1] == 0.2

    play(test)


def test_participants_that_answer_each_other_without_end_disturb_no_third() -> None:
    async def test(made: Scene) -> None:
        one, other, third = (made.hub.join(name) for name in ("one", "other", "third"))
        heard: list[bytes] = []
        for who, answers_to, answers_on in ((one, "/ping", "/pong"), (other, "/pong", "/ping")):
            who.advertise(answers_on, TEXT_TYPE)
            who.subscribe(answers_to, lambda message, who=who, topic=answers_on: who.publish(topic, message.payload))
        third.subscribe("/ping", lambda message: heard.append(message.payload))
        third.publish("/ping", text("hello"))
        assert one.has_left != other.has_left
        assert not third.has_left
        assert set(heard) == {text("hello")}
        assert made.hub.isolation.crashes == {"participant": 1}

    play(test)


def test_a_subscription_that_is_closed_receives_nothing_more_not_even_the_message_that_is_on_its_way() -> None:
    async def test(made: Scene) -> None:
        closing, closed, leaving, sending = (plain(made, Role.DRIVE) for _ in range(4))
        heard: list[str] = []

        def end_the_others(_: Message) -> None:
            subscription.close()
            leaving.participant.leave()

        closing.participant.subscribe(TEXT, end_the_others)
        subscription = closed.participant.subscribe(TEXT, lambda _: heard.append("closed"))
        leaving.participant.subscribe(TEXT, lambda _: heard.append("left"))
        sending.publish(TEXT, TEXT_TYPE, text("x"))
        assert heard == []

    play(test)


def test_participant_that_leaves_does_not_receive_its_own_zero() -> None:
    async def test(made: Scene) -> None:
        one = plain(made, Role.DRIVE)
        robot, heard = made.hub.robots.find(ROBOT), []
        one.participant.subscribe(
            robot.shown.velocity, lambda message: heard.append(Twist.decode(message.payload).planar)
        )
        one.drive(ROBOT, 0.2, made.hub)
        one.participant.leave()
        assert heard == [PlanarVelocity(0.2)]
        await asyncio.sleep(0.01)
        assert made.speeds()[-1] == 0.0

    play(test)


def test_participant_that_latched_may_leave_while_its_message_is_delivered() -> None:
    async def test(made: Scene) -> None:
        one, other, late = (plain(made, Role.DRIVE) for _ in range(3))
        for each, content in ((one, "one"), (other, "other")):
            each.participant.advertise(TEXT, TEXT_TYPE, is_latched=True)
            each.participant.publish(TEXT, text(content))
        heard: list[bytes] = []

        def receive(message: Message) -> None:
            heard.append(message.payload)
            one.participant.leave()
            late.participant.advertise(TEXT, TEXT_TYPE, is_latched=True)

        late.participant.subscribe(TEXT, receive)
        assert heard == [text("one"), text("other")]
        assert made.hub.isolation.crashes.total() == 0

    play(test)


# -- the demo's driver ------------------------------------------------------------------------------------------------


def test_the_demo_drives_no_robot_again_after_a_stop_until_it_is_told() -> None:
    async def test(made: Scene) -> None:
        robot = made.hub.robots.find(ROBOT)
        assert isinstance(robot, AnyRobot)
        participant, program = made.hub.join("demo", priority=0), made.hub.join("program")
        driving = made.tasks.create_task(DemoDriver(made.hub, participant, lambda _: True).run())
        await asyncio.sleep(0.5)
        assert robot.gate.owner is participant
        robot.stop()
        await asyncio.sleep(10.0)
        assert robot.gate.owner is None
        assert (await program.call(DRIVE, {}))["message"] == f"the demo drives again: {ROBOT}"
        await asyncio.sleep(0.5)
        assert robot.gate.owner is participant
        program.drive(robot, PlanarVelocity(0.1))  # another driver, whose own stop interrupts the demo, too
        await asyncio.sleep(0.3)
        robot.stop()
        await asyncio.sleep(10.0)
        assert robot.gate.owner is None
        robot.lock()
        refused = await program.call(DRIVE, {})
        assert refused == {
            "success": False,
            "message": f"locked: {ROBOT}; run `hostlink unlock`, then call {DRIVE} again",
        }
        robot.unlock()
        await asyncio.sleep(0.5)
        assert robot.gate.owner is None
        assert (await program.call(DRIVE, {}))["success"] is True
        await asyncio.sleep(0.5)
        assert robot.gate.owner is participant
        driving.cancel()
        participant.leave()
        program.leave()

    play(test)


@pytest.mark.parametrize("make", PROGRAMS)
def test_participant_follows_poses_until_it_leaves_and_a_failure_ends_it_alone(make: Make) -> None:
    async def test(made: Scene) -> None:
        one, failing = make(made, Role.READ), make(made, Role.READ)
        robot, heard = made.hub.robots.find(ROBOT), []
        before = len(robot.followers)

        def fail() -> None:
            raise ValueError

        failing.participant.follow(robot, fail)
        one.participant.follow(robot, lambda: heard.append(robot.odometry.count))
        await made.robot.send(ODOMETRY_ID, POSE.pack(1.0, 0.0, 0.0))
        await asyncio.sleep(0.1)
        assert heard == [1]
        assert failing.participant.has_left
        assert not one.participant.has_left
        assert made.hub.isolation.crashes == {"participant": 1}
        one.participant.leave()
        assert len(robot.followers) == before
        with pytest.raises(BadRequest, match="has left"):
            one.participant.follow(robot, lambda: None)

    play(test)
