"""Gates: what a device receives of commands, stops, locks and ends of leases, and what is recorded of them."""

import asyncio
from itertools import pairwise
from typing import Any

import pytest

from hostlink.core.config import Config, RobotConfig
from hostlink.core.hub.gates import FEED_INTERVAL_S, MAX_GUARDED, Refusals
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.node import Node
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import STOP_REQUEST, encode
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.robot.events import LEASE_ENDED, LET_GO, NOT_TAKEN, OTHER_TOPICS, EventKind, RobotEvent
from hostlink.core.robot.velocity import ZERO, PlanarVelocity, Twist
from hostlink.errors import CommandRefused, DeviceGone, FrameTooLarge, HostlinkError, RefusalKind
from tests.support.compiled_modules import replaces_a_method
from tests.support.fake_device import CATALOG, robot_topics, topic
from tests.support.gates import drive_gate
from tests.support.memory_hub import MemoryHub, in_hub, twist_zeros, velocities
from tests.support.remote_robots import remote_robot
from tests.support.ros_lib_device import running_hub
from tests.support.virtual_loop import VirtualLoop, run_virtual, virtual

SLOW, FAST = PlanarVelocity(0.1), PlanarVelocity(0.4)


def events_of(made: MemoryHub) -> list[RobotEvent]:
    found: list[RobotEvent] = []
    made.hub.events.observe("test", found.append)
    return found


def refuse_velocities(device: Any) -> None:
    """Let no velocity fit the device from now on."""

    def refuse(*_: Any, **__: Any) -> None:
        raise FrameTooLarge("/robot_0/velocity_commands", 56, 40)

    device.link.session.publish = refuse
    device.link.session.send_zero = lambda *_, **__: False


def test_connected_device_receives_zero_first() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        await asyncio.sleep(0.5)
        assert velocities(device) == [(0.0, 0.0)] * 3

    in_hub(test)


def test_command_is_sent_repeated_at_the_feed_interval_and_ended_by_three_zeros() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        await asyncio.sleep(1.0)
        device.heard.clear()
        began_s = made.now_s
        assert drive_gate(made.robot(), SLOW, owner="ann") == SLOW
        await asyncio.sleep(2.0)
        heard = velocities(device)
        moving = [at_s - began_s for at_s, frame in device.heard if frame.topic_id == 100][: heard.index((0.0, 0.0))]
        assert heard[len(moving) :] == [(0.0, 0.0)] * 3
        assert len(moving) == 4
        assert all(b - a >= FEED_INTERVAL_S - 1e-6 for a, b in pairwise(moving))
        zero_s = device.heard[len(moving)][0] - began_s
        assert LEASE_S - 1e-6 <= zero_s < LEASE_S + 0.02  # 1e-6 is the resolution of the virtual loop's clock

    in_hub(test)


@replaces_a_method
def test_clock_steps_no_gate_that_keeps_its_velocity_and_is_commanded_often(monkeypatch: pytest.MonkeyPatch) -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        await asyncio.sleep(1.0)
        device.heard.clear()
        gate, steps = made.robot().gate, 0
        step = gate.step

        def counted(now_s: float) -> PlanarVelocity | None:
            nonlocal steps
            steps += 1
            return step(now_s)

        monkeypatch.setattr(gate, "step", counted)
        for _ in range(20):
            drive_gate(made.robot(), SLOW, owner="ann")
            await asyncio.sleep(0.1)
        assert (steps, len(velocities(device))) == (20, 20)

    in_hub(test)


def test_stop_sends_zero_at_once_and_records_its_source() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        drive_gate(made.robot(), SLOW, owner="ann")
        await asyncio.sleep(0.1)
        events = events_of(made)
        device.heard.clear()
        made.robot().stop()
        await asyncio.sleep(0.01)
        assert velocities(device) == [(0.0, 0.0)]
        assert [(each.kind, each.facts["owner"], each.facts["reason"]) for each in events] == [
            (EventKind.STOPPED, "ann", "stopped")
        ]
        assert made.robot().gate.counts.stops == 1
        with pytest.raises(CommandRefused) as refused:
            drive_gate(made.robot(), SLOW, owner="ann")
        assert refused.value.kind is RefusalKind.DISARMED
        assert made.logged("robot.stopped")[-1]["owner"] == "ann"

    in_hub(test)


def test_velocities_of_one_batch_are_written_at_its_end_and_only_the_newest() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        await asyncio.sleep(0.5)
        written = device.link.session.counts.frames_to_device
        made.hub.gates.hold()
        drive_gate(made.robot(), SLOW, owner="ann")
        drive_gate(made.robot(), FAST, owner="ann")
        assert device.link.session.counts.frames_to_device == written
        made.hub.gates.write()
        assert device.link.session.counts.frames_to_device == written + 1
        await asyncio.sleep(0.01)
        assert velocities(device)[-1] == (0.4, 0.0)
        drive_gate(made.robot(), SLOW, owner="ann")  # outside of a batch, the next turn of the loop writes it
        assert device.link.session.counts.frames_to_device == written + 1
        await asyncio.sleep(0.01)
        assert velocities(device)[-1] == (0.1, 0.0)

    in_hub(test)


@pytest.mark.parametrize("is_batch", [True, False])
def test_velocity_that_waits_through_a_pause_is_not_written(is_batch: bool) -> None:
    """SIGSTOP between its admission and its write."""

    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        await asyncio.sleep(0.5)
        device.heard.clear()
        if is_batch:
            made.hub.gates.hold()
        drive_gate(made.robot(), SLOW, owner="ann")
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        loop.burn(1.0)
        if is_batch:
            made.hub.gates.write()
        for _ in range(6):
            await asyncio.sleep(0.1)
            with pytest.raises(CommandRefused) as refused:
                drive_gate(made.robot(), SLOW, owner="ann")
        assert refused.value.kind is RefusalKind.DISARMED
        assert set(velocities(device)) == {(0.0, 0.0)}

    in_hub(test)


@replaces_a_method
def test_stop_of_all_reaches_each_robot_although_one_refuses_the_zero() -> None:
    async def test(made: MemoryHub) -> None:
        first = await made.connect(robot_topics("a"))
        other = await made.connect(robot_topics("b"), address="10.0.0.3")
        for name in "ab":
            drive_gate(made.robot(name), SLOW, owner="ann")
        refusal = FrameTooLarge("/a/velocity_commands", 56, 40)

        def refuse(*_: Any, **__: Any) -> None:
            raise refusal

        first.link.session.publish = refuse  # type: ignore[method-assign]
        first.link.session.send_zero = lambda *_, **__: False  # type: ignore[method-assign]
        other.heard.clear()
        with pytest.raises(FrameTooLarge):
            made.hub.robots.stop_all()
        await asyncio.sleep(0.01)
        assert velocities(other)[-1:] == [(0.0, 0.0)]
        assert made.robot("a").refusals.cause == str(refusal)
        assert made.robot("a").why_moving() == f"its device cannot receive the stop: {refusal}"

    in_hub(test)


def test_locked_robot_refuses_commands_and_receives_zero_again_and_again() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        drive_gate(made.robot(), SLOW, owner="ann")
        device.heard.clear()
        made.robot().lock("smoke")
        await asyncio.sleep(2.0)
        assert set(velocities(device)) == {(0.0, 0.0)}
        assert len(velocities(device)) >= 5
        with pytest.raises(CommandRefused) as refused:
            drive_gate(made.robot(), SLOW, owner="bob")
        assert refused.value.kind is RefusalKind.LOCKED
        made.robot().unlock()
        assert drive_gate(made.robot(), SLOW, owner="carol") == SLOW
        with pytest.raises(CommandRefused) as refused:
            drive_gate(made.robot(), SLOW, owner="bob")  # which commanded through the lock
        assert refused.value.kind is RefusalKind.DISARMED

    in_hub(test)


def test_source_that_leaves_stops_its_robot_and_no_other() -> None:
    async def test(made: MemoryHub) -> None:
        devices = [
            await made.connect(robot_topics(name), address=f"10.0.0.{number}") for number, name in enumerate("ab")
        ]
        drive_gate(made.robot("a"), SLOW, owner="ann")
        drive_gate(made.robot("b"), SLOW, owner="bob")
        await asyncio.sleep(0.05)
        made.hub.gates.release("ann")
        await asyncio.sleep(0.05)
        assert [velocities(device)[-1] for device in devices] == [(0.0, 0.0), (0.1, 0.0)]
        assert made.logged("robot.stopped")[-1]["reason"] == "the driver left"

    in_hub(test)


@replaces_a_method
def test_command_that_does_not_fit_the_device_ends_the_drive_of_its_source() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        drive_gate(made.robot(), SLOW, owner="ann")
        events = events_of(made)

        refuse_velocities(device)
        with pytest.raises(FrameTooLarge):
            drive_gate(made.robot(), FAST, owner="ann")
        assert made.robot().gate.owner is None
        assert [each.kind for each in events] == [EventKind.STOPPED, EventKind.REFUSED]
        assert (events[0].facts["owner"], events[0].facts["reason"]) == ("ann", NOT_TAKEN)
        assert made.robot().refusals.count == 1
        with pytest.raises(HostlinkError):
            drive_gate(made.robot(), ZERO, owner="ann")
        assert len(events) == 2  # a refused zero is not recorded

    in_hub(test)


@replaces_a_method
def test_crash_while_sending_ends_the_link_and_refuses_the_command() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()

        def crash(*_: Any, **__: Any) -> None:
            raise ZeroDivisionError

        device.link.session.publish = crash  # type: ignore[method-assign]
        with pytest.raises(DeviceGone):
            drive_gate(made.robot(), SLOW, owner="ann")
        assert made.hub.isolation.crashes["robot"] == 1
        await asyncio.sleep(0.1)
        assert made.logged("link.closed")[-1]["reason"] == "crashed"

    in_hub(test, reraises=False)


def test_closed_gates_refuse_every_command() -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect()
        made.hub.gates.refuse_all()
        with pytest.raises(CommandRefused) as refused:
            drive_gate(made.robot(), SLOW, owner="ann")
        assert refused.value.kind is RefusalKind.ENDING
        assert "hostlink is stopping" in str(refused.value)

    in_hub(test)


def test_guard_watches_velocity_topics_and_knows_which_links_are_driven() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        number = device.link.number
        assert made.guard.watched[number] == (twist_zeros(100), 512)
        assert made.guard.ends[number] == STOP_REQUEST
        await asyncio.sleep(1.0)
        assert made.guard.driven == set()
        drive_gate(made.robot(), SLOW, owner="ann")
        assert made.guard.driven == {number}
        await asyncio.sleep(1.0)
        assert made.guard.driven == set()
        assert made.guard.beats >= 10
        await device.aclose()
        await asyncio.sleep(0.1)
        assert made.guard.released == [number]

    in_hub(test)


def test_guard_is_told_of_every_velocity_topic_of_other_ids_and_larger_frames_until_none_is_left() -> None:
    async def test(made: MemoryHub) -> None:
        arm = topic(EndpointKind.SUBSCRIBER, 107, "/robot_0/arm_vel", "geometry_msgs/Twist")
        device = await made.connect([arm, *robot_topics()])
        number, (odometry, velocity, reset) = device.link.number, robot_topics()
        assert made.guard.watched[number] == (twist_zeros(100, 107), 512)
        device.infos = [odometry, velocity._replace(id=104), reset._replace(buffer_bytes=2048)]
        await device.announce()
        await asyncio.sleep(0.1)
        assert made.guard.watched[number] == (twist_zeros(104, 100, 107), 2048)  # the announcement may be damaged
        await asyncio.sleep(2.0)
        assert made.guard.watched[number] == (twist_zeros(104), 2048)
        device.infos = [odometry._replace(name="/robot_0/map")]
        await device.announce()
        await asyncio.sleep(0.1)
        assert made.guard.watched[number] == (twist_zeros(104), 512)
        await asyncio.sleep(2.0)
        assert number not in made.guard.watched

    in_hub(test)


def test_guard_watches_the_new_connection_of_a_robot_and_no_device_without_velocity() -> None:
    async def test(made: MemoryHub) -> None:
        old = await made.connect(peer="10.0.0.2:1")
        old.infos = []  # the device that connects again no longer answers here
        new = await made.connect(peer="10.0.0.2:2")
        await asyncio.sleep(2.0)
        assert made.guard.released[0] == old.link.number
        await made.connect(robot_topics()[:1], address="10.0.0.3")
        assert made.guard.watched.keys() == {new.link.number}

    in_hub(test)


def test_guard_watches_no_more_than_its_bound_of_velocity_topics() -> None:
    async def test(made: MemoryHub) -> None:
        infos = [
            topic(EndpointKind.SUBSCRIBER, 100 + each, f"/n{each}/cmd_vel", "geometry_msgs/Twist") for each in range(20)
        ]
        device = await made.connect(infos)
        number = device.link.number
        assert made.guard.watched[number][0] == twist_zeros(*range(100, 100 + MAX_GUARDED))
        dropped = [line for line in made.logs if line["event"] == "guardian.frames_dropped"]
        assert [(line["link"], line["guarded"]) for line in dropped] == [(number, MAX_GUARDED)]

    in_hub(test)


def test_admission_is_registered_as_long_as_its_robot_is_known() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        admission = made.robot().admission
        assert made.hub.gates._admissions[admission] == 2  # of the robot and of its velocity topic
        await device.aclose()
        await asyncio.sleep(0.1)
        assert made.hub.gates._admissions == {admission: 1}
        made.hub.robots.forget("robot_0")
        assert made.hub.gates._admissions == {}

    in_hub(test)


def test_source_that_leaves_is_withdrawn_from_robots_of_other_daemons() -> None:
    async def test(made: MemoryHub) -> None:
        robot = remote_robot(made.hub, "robot_7")
        made.hub.robots.put_remote(robot)
        robot.admission.connect(made.now_s)
        source = Node("ann")
        robot.admission.join([source], made.now_s)
        made.hub.gates.release(source)
        assert robot.admission._joined == {}
        made.hub.robots.pop_remote("robot_7")
        assert made.hub.gates._admissions == {}

    in_hub(test)


def test_higher_priority_stops_what_another_source_drives_of_the_same_robot() -> None:
    async def test(made: MemoryHub) -> None:
        more = topic(EndpointKind.SUBSCRIBER, 110, "/robot_0/cmd_vel_raw", "geometry_msgs/Twist")
        device = await made.connect([*robot_topics(), more])
        main, other = made.robot().beside
        assert other.name == "robot_0"
        drive_gate(other, SLOW, owner="ann", priority=10)  # type: ignore[arg-type]
        await asyncio.sleep(0.05)
        drive_gate(main, FAST, owner="bob", priority=60)  # type: ignore[arg-type]
        await asyncio.sleep(0.05)
        assert velocities(device)[-1] == (0.4, 0.0)
        assert velocities(device, 110)[-1] == (0.0, 0.0)
        assert made.logged("robot.stopped")[-1]["reason"] == "overruled"
        with pytest.raises(CommandRefused) as refused:
            drive_gate(other, SLOW, owner="ann", priority=10)  # type: ignore[arg-type]
        assert refused.value.kind is RefusalKind.HELD

    in_hub(test)


def test_velocity_topic_of_a_spatial_drive_keeps_six_numbers() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect([topic(EndpointKind.SUBSCRIBER, 100, "/arm/cmd_vel", "geometry_msgs/Twist")])
        twist = Twist(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
        participant = made.hub.join("ann")
        participant.advertise("/arm/cmd_vel", "geometry_msgs/Twist")
        participant.publish("/arm/cmd_vel", twist.encode())
        await asyncio.sleep(0.05)
        assert device.payloads(100)[-1] == twist.encode()

    in_hub(test, Config(robots={"arm": RobotConfig(kinematics="spatial")}))


def test_published_twist_that_is_not_planar_is_refused_for_a_robot() -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect()
        participant = made.hub.join("ann")
        participant.advertise("/robot_0/velocity_commands", "geometry_msgs/Twist")
        with pytest.raises(CommandRefused) as refused:
            participant.publish("/robot_0/velocity_commands", Twist(0.1, 0.0, 0.5).encode())
        assert refused.value.kind is RefusalKind.UNSUPPORTED

    in_hub(test)


def test_published_zero_while_another_source_drives_is_ignored() -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect()
        drive_gate(made.robot(), SLOW, owner="ann")
        joystick = made.hub.join("joystick")
        joystick.advertise("/robot_0/velocity_commands", "geometry_msgs/Twist")
        joystick.publish("/robot_0/velocity_commands", Twist().encode())
        assert made.robot().gate.owner == "ann"
        with pytest.raises(CommandRefused):
            drive_gate(made.robot(), ZERO, owner="joystick")

    in_hub(test)


def test_stamped_twist_older_than_the_robot_allows_is_refused() -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect()
        participant = made.hub.join("ann")
        found = participant.advertise("/robot_0/cmd_vel_stamped", "geometry_msgs/TwistStamped")
        assert found.type is not None
        vector = {"x": 0.1, "y": 0.0, "z": 0.0}
        twist = {"linear": vector, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}

        def stamped(secs: int) -> bytes:
            assert found.type is not None
            return found.type.encode({"header": {"stamp": {"secs": secs, "nsecs": 0}}, "twist": twist})

        with pytest.raises(CommandRefused) as refused:
            participant.publish("/robot_0/cmd_vel_stamped", stamped(1000))
        assert refused.value.kind is RefusalKind.LATE
        participant.publish("/robot_0/cmd_vel_stamped", stamped(0))  # a stamp of zero is ignored
        assert made.robot().gate.owner == participant

    in_hub(test, Config(robots={"robot_0": RobotConfig(cmd_vel_max_age_s=1.0)}))


def test_refusals_are_logged_first_and_then_once_in_ten_seconds_with_their_number() -> None:
    async def test(made: MemoryHub) -> None:
        refusals = Refusals()
        for _ in range(150):
            refusals.add("robot_0", DeviceGone("robot_0"))
            await asyncio.sleep(0.1)
        assert refusals.count == 150
        assert [each["count"] for each in made.logged("robot.unreachable")] == [1, 101]

    in_hub(test)


def test_end_of_a_link_sends_zero_to_what_may_move() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        drive_gate(made.robot(), SLOW, owner="ann")
        await asyncio.sleep(0.05)
        made.hub.gates.detach(made.hub.robots.devices[device.link.number])
        await asyncio.sleep(0.05)
        assert velocities(device)[-1] == (0.0, 0.0)
        assert made.robot().link is None

    in_hub(test)


@virtual
async def test_sleep_of_the_computer_is_a_pause_of_the_hub_that_was_given_its_clock() -> None:
    slept_s = 0.0
    hub = Hub(Config(), CATALOG, reraises=True, slept_s=lambda: slept_s)
    async with running_hub(hub):
        await asyncio.sleep(1.0)
        slept_s = 30.0
        await asyncio.sleep(1.0)
        assert hub.gates.pauses(2.0).was_paused(0.9)


def test_gates_without_events_keep_their_own() -> None:
    async def test() -> None:
        from hostlink.core.hub.gates import Gates  # noqa: PLC0415 - of this test alone
        from hostlink.core.hub.isolation import Isolation  # noqa: PLC0415

        gates = Gates(Isolation(reraises=True), slept_s=lambda: 0.0)
        gates.stop([])
        await gates.settled()
        assert gates.came_s(5.0) == 5.0

    run_virtual(test())


def test_link_ends_with_one_zero_for_each_velocity_topic_also_after_another_announcement() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        zero = encode(100, ZERO.encode())
        assert device.link.last_frames == (zero,)
        device.infos.append(topic(EndpointKind.PUBLISHER, 200, "/extra", "std_msgs/Bool"))
        await device.announce()
        await asyncio.sleep(1.5)
        assert device.link.last_frames == (zero,)
        device.infos.append(topic(EndpointKind.SUBSCRIBER, 201, "/robot_0/cmd_vel", "geometry_msgs/Twist"))
        await device.announce()
        await asyncio.sleep(1.5)
        other = encode(201, ZERO.encode())
        assert device.link.last_frames in ((zero + other,), (other + zero,))

    in_hub(test)


@pytest.mark.parametrize(
    ("owner", "velocity", "reason"),
    [("ann", ZERO, LET_GO), ("bob", ZERO, LEASE_ENDED), ("bob", SLOW, LEASE_ENDED), ("ann", SLOW, LEASE_ENDED)],
)
def test_drive_whose_lease_ends_as_a_command_arrives_is_reported_once(
    owner: str, velocity: PlanarVelocity, reason: str
) -> None:
    """The command notices the end of the lease before the clock of the gates does."""

    async def test(made: MemoryHub) -> None:
        await made.connect()
        await asyncio.sleep(1.0)
        drive_gate(made.robot(), FAST, owner="ann")
        events = events_of(made)
        await asyncio.sleep(LEASE_S - 0.001)
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        loop.burn(0.002)
        drive_gate(made.robot(), velocity, owner=owner)
        await asyncio.sleep(0.2)
        found = [(each.facts["owner"], each.facts["reason"]) for each in events if each.kind is EventKind.STOPPED]
        assert found == [("ann", reason)]

    in_hub(test)


def test_drive_that_its_source_ends_by_a_zero_is_over_at_once_and_reported_once() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        await asyncio.sleep(1.0)
        device.heard.clear()
        drive_gate(made.robot(), FAST, owner="ann")
        await asyncio.sleep(0.11)  # not at a tick of the gates, whose zero would be one frame with that of the source
        events = events_of(made)
        for _ in range(3):
            drive_gate(made.robot(), ZERO, owner="ann")
        stops = [each.facts for each in events if each.kind is EventKind.STOPPED]
        assert [(each["owner"], each["reason"]) for each in stops] == [("ann", LET_GO)]
        assert made.robot().state(made.now_s).holder is None
        await asyncio.sleep(2.0)
        made.hub.gates.release("ann")
        assert len([each for each in events if each.kind is EventKind.STOPPED]) == 1
        assert velocities(device)[-3:] == [(0.0, 0.0)] * 3

    in_hub(test)


@replaces_a_method
def test_drive_whose_last_zero_does_not_fit_the_device_is_reported_once_as_that() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        drive_gate(made.robot(), SLOW, owner="ann")
        events = events_of(made)
        refuse_velocities(device)
        with pytest.raises(FrameTooLarge):
            drive_gate(made.robot(), ZERO, owner="ann")
        await asyncio.sleep(1.0)
        assert [each.facts["reason"] for each in events if each.kind is EventKind.STOPPED] == [NOT_TAKEN]

    in_hub(test)


def test_drive_ends_when_the_device_announces_other_topics() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        await asyncio.sleep(1.0)
        drive_gate(made.robot(), SLOW, owner="ann")
        events = events_of(made)
        device.infos.append(topic(EndpointKind.PUBLISHER, 126, "/extra", "std_msgs/Bool"))
        await device.announce()
        await asyncio.sleep(0.05)
        stops = [each.facts for each in events if each.kind is EventKind.STOPPED]
        assert [(each["owner"], each["reason"]) for each in stops] == [("ann", OTHER_TOPICS)]

    in_hub(test)
