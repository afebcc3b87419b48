"""Components: a failure stops what the component drives, is reported, and is followed by another start."""

import asyncio
import contextlib
import importlib.metadata
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, make_dataclass, replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, ClassVar

import pytest

from hostlink.cli.settings import load
from hostlink.core import components
from hostlink.core.components import (
    LONGEST_PAUSE_S,
    READY_S,
    STEADY_S,
    Chosen,
    begun,
    begun_first,
    chosen_components,
    find_component,
    hosted,
    supervise,
)
from hostlink.core.config import Config
from hostlink.core.host import Component, Connections, Host, PlanarVelocity, RobotEvent, Role
from hostlink.core.hub.graph_changes import GraphKind
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.runtime.cancellation import first_error
from hostlink.errors import (
    BadRequest,
    CommandRefused,
    ConfigError,
    DeviceGone,
    FrameTooLarge,
    HostlinkError,
    NoRole,
    UnknownTopic,
)
from tests.support.fake_device import topic
from tests.support.gates import drive_gate
from tests.support.memory_hub import MemoryHub, in_hub, velocities
from tests.support.remote_robots import RecordingHosts, remote_robot
from tests.support.virtual_loop import inside
from tests.support.waiting import expect

FORWARD = PlanarVelocity(0.1)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the component in these tests."""

    speed_m_s: float = 0.1
    folder: Path | None = None
    tags: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Needy:
    """Settings with a key that has no default."""

    port: int


class Driver(Component[Settings]):
    """Component that does what a test says."""

    name = "driver"
    settings_type = Settings
    hosts: list[Host]
    steps: list[Any]  # of one run each: an exception, "return", or a coroutine function

    async def run(self, host: Host) -> None:
        self.hosts.append(host)
        step = self.steps[min(len(self.hosts), len(self.steps)) - 1]
        if isinstance(step, Exception):
            raise step
        if step != "return":
            await step(host)


class NeedyDriver(Driver):
    name = "needy"
    settings_type = Needy


def driver_of(*steps: Any) -> type[Driver]:
    return type("Driver", (Driver,), {"steps": list(steps), "hosts": []})


async def drive_for_ever(host: Host) -> None:
    me = host.join("arm")
    while True:
        with contextlib.suppress(HostlinkError):
            host.drive(me, "robot_0", FORWARD)
        await asyncio.sleep(0.1)


@contextlib.asynccontextmanager
async def supervised(made: MemoryHub, kind: type[Driver]) -> Any:
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(supervise(made.hub, kind.name, lambda: kind(Settings())))
        yield
        task.cancel()


def codes(made: MemoryHub) -> list[str]:
    return [each.code for each in made.hub.diagnoses.own.values()]


@pytest.fixture
def entry_points(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, EntryPoint]]:
    """Installed components; a test may add some."""

    def point(name: str, value: str) -> EntryPoint:
        return EntryPoint(name, value, components.GROUP)

    found = {
        "driver": point("driver", f"{__name__}:Driver"),
        "needy": point("needy", f"{__name__}:NeedyDriver"),
        "other": point("other", f"{__name__}:Driver"),
        "module": point("module", f"{__name__}:Settings"),
        "broken": point("broken", "no_such_module:X"),
    }
    monkeypatch.setattr(components, "_entry_points", lambda: found)
    return iter([found])


# -- supervision ------------------------------------------------------------------------------------------------------


@inside(in_hub, reraises=False)
@pytest.mark.parametrize("problem", [ValueError("a bug"), ConnectionRefusedError("no broker"), DeviceGone("robot_0")])
async def test_failure_stops_its_robot_at_once_and_is_reported_until_the_next_start(
    made: MemoryHub, problem: Exception
) -> None:
    device = await made.connect()

    async def fail_while_driving(host: Host) -> None:
        me = host.join("arm")
        for _ in range(10):
            host.drive(me, "robot_0", FORWARD)
            await asyncio.sleep(0.1)
        raise problem

    kind = driver_of(fail_while_driving, drive_for_ever)
    async with supervised(made, kind):
        await asyncio.sleep(0.95)
        assert velocities(device)[-1] == (0.1, 0.0)
        await asyncio.sleep(0.1)
        assert velocities(device)[-1] == (0.0, 0.0)
        assert codes(made) == ["component_failed"]
        assert str(problem) in made.hub.diagnoses.own["driver"].detail
        assert made.robot().state(made.now_s).holder is None
        await asyncio.sleep(1.0)
        assert codes(made) == []
        assert velocities(device)[-1] == (0.1, 0.0)
    await asyncio.sleep(0.1)
    assert velocities(device)[-1] == (0.0, 0.0)
    has_traceback = isinstance(problem, ValueError)
    assert len(made.logged("component.crashed")) == made.hub.isolation.crashes["component"] == has_traceback
    assert [each["reason"] for each in made.logged("component.ended")] == [str(problem)]


@inside(in_hub)
async def test_pause_between_starts_grows_and_is_short_again_after_a_steady_run(made: MemoryHub) -> None:
    async def steady(_: Host) -> None:
        await asyncio.sleep(STEADY_S + 1.0)
        raise OSError("lost")

    kind = driver_of(*[OSError("refused")] * 8, steady, OSError("refused"))
    async with supervised(made, kind):
        await asyncio.sleep(400.0)
        pauses = [each["again_in_s"] for each in made.logged("component.ended")]
        assert pauses[:8] == [1, 2, 4, 8, 16, 32, LONGEST_PAUSE_S, LONGEST_PAUSE_S]
        assert pauses[8:10] == [1, 2]
    assert made.hub.counts.components["driver"]()["failures"] == len(pauses)


@inside(in_hub)
async def test_component_that_returns_is_started_again_and_what_it_spawned_has_ended(made: MemoryHub) -> None:
    ended: list[str] = []

    async def spawn_and_return(host: Host) -> None:
        host.spawn(last_for_ever(), name="work")
        await asyncio.sleep(0.1)

    async def last_for_ever() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            ended.append("work")

    kind = driver_of(spawn_and_return, drive_for_ever)
    async with supervised(made, kind):
        await asyncio.sleep(0.5)
        assert ended == ["work"]
        assert codes(made) == ["component_failed"]
        await expect(lambda: len(kind.hosts) == 2)


@inside(in_hub, reraises=False)
async def test_failure_of_spawned_work_or_of_a_callback_is_a_failure_of_the_component(made: MemoryHub) -> None:
    async def crash() -> None:
        raise ValueError("spawned")

    async def spawn(host: Host) -> None:
        host.spawn(crash(), name="work")
        await asyncio.Event().wait()

    kind = driver_of(spawn, drive_for_ever)
    async with supervised(made, kind):
        await asyncio.sleep(0.1)
        assert "spawned" in made.hub.diagnoses.own["driver"].detail


@inside(in_hub, reraises=False)
async def test_failed_component_that_swallows_its_cancellation_drives_no_more(made: MemoryHub) -> None:
    device = await made.connect()

    async def crash() -> None:
        await asyncio.sleep(0.45)
        raise ValueError("spawned")

    async def swallow(host: Host) -> None:
        host.spawn(crash(), name="work")
        me, end_s = host.join("arm"), made.now_s + 5.0
        while made.now_s < end_s:
            with contextlib.suppress(HostlinkError):
                host.drive(me, "robot_0", FORWARD)
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(0.1)

    async with supervised(made, driver_of(swallow, drive_for_ever)):
        await asyncio.sleep(0.4)
        assert velocities(device)[-1] == (0.1, 0.0)
        await asyncio.sleep(0.15)
        assert velocities(device)[-1] == (0.0, 0.0)
        assert made.robot().state(made.now_s).holder is None
        assert made.hub.diagnoses.own["driver"].detail == "driver: spawned"
        await asyncio.sleep(1.0)
        assert velocities(device)[-1] == (0.0, 0.0)
        await asyncio.sleep(4.8)
        assert velocities(device)[-1] == (0.1, 0.0)  # in its next run


@inside(in_hub, reraises=False)
@pytest.mark.parametrize("callback", ["follow", "observe", "watch_graph"])
async def test_failure_of_a_callback_is_a_failure_of_the_component(made: MemoryHub, callback: str) -> None:
    device = await made.connect()

    def crash(*_: object) -> None:
        raise ValueError("a bug")

    async def listen(host: Host) -> None:
        if callback == "follow":
            host.follow("robot_0", crash)
        else:
            getattr(host, callback)(crash)
        await drive_for_ever(host)

    async with supervised(made, driver_of(listen, drive_for_ever)):
        await asyncio.sleep(0.2)
        await device.send(125, struct.pack("<3d", 1.0, 0.0, 0.0))
        made.hub.robots.stop_all()
        made.hub.changes.note(GraphKind.ROBOT, "robot_0")
        await asyncio.sleep(0.4)
        assert codes(made) == ["component_failed"]
        reason = made.hub.diagnoses.own["driver"].detail
        assert f"a callback of {callback} has failed: participant.crashed has its error" in reason
        assert made.robot().state(made.now_s).holder is None


async def exit_at_once() -> None:
    raise SystemExit(7)


async def await_what_is_cancelled(_: Host) -> None:
    future = asyncio.get_running_loop().create_future()
    future.cancel()
    await future


async def spawn_what_exits(host: Host) -> None:
    host.spawn(exit_at_once(), name="work")
    await asyncio.Event().wait()


@inside(in_hub, reraises=False)
@pytest.mark.parametrize(
    ("run", "reason"),
    [
        (lambda _: exit_at_once(), "it has raised SystemExit(7)"),
        (spawn_what_exits, "it has raised SystemExit(7)"),
        (await_what_is_cancelled, "something that it awaited was cancelled"),
    ],
)
async def test_exit_or_foreign_cancellation_is_a_failure_of_the_component(
    made: MemoryHub, run: Any, reason: str
) -> None:
    device = await made.connect()
    async with supervised(made, driver_of(run, drive_for_ever)):
        await asyncio.sleep(0.1)
        assert codes(made) == ["component_failed"]
        assert [each["reason"] for each in made.logged("component.ended")] == [reason]
        await asyncio.sleep(1.2)
        assert velocities(device)[-1] == (0.1, 0.0)


@inside(in_hub, reraises=False)
async def test_exit_of_work_that_is_not_vital_is_logged_and_ends_nothing(made: MemoryHub) -> None:
    async def run(host: Host) -> None:
        host.spawn(exit_at_once(), name="work", is_vital=False)
        await drive_for_ever(host)

    device = await made.connect()
    async with supervised(made, driver_of(run)):
        await asyncio.sleep(0.5)
        assert velocities(device)[-1] == (0.1, 0.0)
        assert codes(made) == []
        assert made.hub.isolation.crashes["task"] == 1


@inside(in_hub)
async def test_component_is_not_begun_again_while_the_daemon_ends(made: MemoryHub) -> None:
    kind = driver_of(OSError("lost"), drive_for_ever)
    async with supervised(made, kind):
        await asyncio.sleep(0.5)
        made.hub.gates.refuse_all()
        await asyncio.sleep(5.0)
        assert len(kind.hosts) == 1


@inside(in_hub)
async def test_stop_of_all_between_two_runs_is_an_error_if_the_component_had_robots(made: MemoryHub) -> None:
    hosts = RecordingHosts()

    async def announce(host: Host) -> None:
        remote = host.announce_robots(hosts)
        assert host.kept("orders", list) == []
        host.kept("orders", list).append("stop")
        remote.announce(remote_robot(made.hub, "robot_7").known, host="lab")
        await asyncio.sleep(0.5)
        raise OSError("lost")

    async def announce_none(host: Host) -> None:
        assert host.kept("orders", list) == ["stop"]
        host.announce_robots(hosts)
        await asyncio.sleep(0.5)
        raise OSError("lost")

    device = await made.connect()
    kind = driver_of(announce, announce_none)
    async with supervised(made, kind):
        await asyncio.sleep(0.6)
        assert made.hub.robots.remote == {}
        drive_gate(made.robot(), FORWARD, owner="ann")
        made.hub.robots.stop_all()
        with pytest.raises(DeviceGone, match="driver: the component has failed, and does not run yet"):
            await made.hub.gates.settled()
        await asyncio.sleep(0.05)
        assert velocities(device)[-1] == (0.0, 0.0)
        assert hosts.sent == [("stop", None), ("settled",)]
        for _ in range(2):  # in the second run, and after it
            await asyncio.sleep(1.0)
            made.hub.robots.stop_all()
            assert await made.hub.gates.settled() == []
        assert len(kind.hosts) == 2


@inside(in_hub)
async def test_ended_run_joins_nothing_and_runs_nothing_more(made: MemoryHub) -> None:
    """A callback of a library that the component has not withdrawn may still call it."""

    async def keep(host: Host) -> None:
        host.announce_robots(RecordingHosts())
        raise OSError("lost")

    async def work() -> None:
        raise AssertionError("it runs")

    kind = driver_of(keep, drive_for_ever)
    async with supervised(made, kind):
        await asyncio.sleep(0.1)
        ended = kind.hosts[0]
        with pytest.raises(BadRequest, match="arm: the run of driver has ended"):
            ended.join("arm")
        with pytest.raises(BadRequest, match="the run of driver has ended"):
            ended.observe(lambda _: None)
        ended.spawn(work(), name="late")
        await asyncio.sleep(0.1)
        assert made.hub.isolation.crashes == {}
        made.hub.robots.stop_all()
        assert await made.hub.gates.settled() == []


@inside(in_hub)
async def test_component_that_swallows_its_cancellation_is_not_started_again(made: MemoryHub) -> None:
    async def swallow(_: Host) -> None:
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.Event().wait()

    kind = driver_of(swallow, drive_for_ever)
    async with supervised(made, kind):
        await asyncio.sleep(0.1)
    await asyncio.sleep(5.0)
    assert len(kind.hosts) == 1


# -- those that begin first ------------------------------------------------------------------------------------------


class First(Component[Settings]):
    """Component that begins first, and writes down what happens."""

    settings_type = Settings
    begins_first = True
    events: list[str]
    steps: dict[str, list[Exception | None]]  # of each by its name: what ends its runs before they are ready

    async def run(self, host: Host) -> None:
        steps = self.steps.get(self.name, [])
        await asyncio.sleep(0.1)
        if steps and (error := steps.pop(0)) is not None:
            raise error
        self.events.append(f"+{self.name}")
        host.ready()
        try:
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(0.1)
            self.events.append(f"-{self.name}")


def firsts(events: list[str], **steps: list[Exception | None]) -> list[Chosen]:
    facts: dict[str, Any] = {"events": events, "steps": steps}
    kinds = (
        type("A", (First,), {"name": "a", "uses": ("b", "none"), **facts}),
        type("B", (First,), {"name": "b", **facts}),
        type("Other", (First,), {"name": "other", "begins_first": False, **facts}),
    )
    return [Chosen(kind.name, kind, Settings()) for kind in kinds]


@inside(in_hub)
async def test_those_that_begin_first_begin_after_what_they_use_and_end_before_it(made: MemoryHub) -> None:
    events: list[str] = []
    chosen = firsts(events)
    async with begun_first(made.hub, chosen):
        assert events == ["+b", "+a"]
        async with begun(made.hub, chosen):
            await asyncio.sleep(0.2)
        events.append("the rest has ended")
    assert events == ["+b", "+a", "+other", "-other", "the rest has ended", "-a", "-b"]


@inside(in_hub, reraises=False)
async def test_one_that_fails_before_it_is_ready_holds_up_nothing_and_is_tried_again(made: MemoryHub) -> None:
    events: list[str] = []
    errors = [ValueError("a bug"), *[ConfigError("b", "later")] * 4]
    async with begun_first(made.hub, firsts(events, b=errors)):
        assert events == ["+a"]
        assert codes(made) == ["component_failed"]
        await asyncio.sleep(20.0)
        assert events == ["+a", "+b"]
        assert codes(made) == []
    assert [each["again_in_s"] for each in made.logged("component.ended")] == [1.0, 2.0, 4.0, 5.0, 5.0]


@inside(in_hub)
async def test_daemon_begins_without_one_that_hangs_and_holds_robots_when_that_fails(made: MemoryHub) -> None:
    hangs = asyncio.Event()

    async def hang(_: Host) -> None:
        await hangs.wait()
        raise ConfigError("driver.port", "is in use")

    began_s = made.now_s
    kind = type("Hangs", (driver_of(hang),), {"begins_first": True})
    async with begun_first(made.hub, [Chosen("driver", kind, Settings())]):
        assert made.now_s - began_s == pytest.approx(READY_S, abs=0.1)
        assert len(made.logged("component.late")) == 1
        hangs.set()
        await asyncio.sleep(0.1)
        assert codes(made) == ["component_failed"]


@inside(in_hub)
async def test_setting_that_cannot_be_served_ends_the_start_of_one_that_begins_first(made: MemoryHub) -> None:
    events: list[str] = []
    with pytest.raises(BaseExceptionGroup) as caught:
        async with begun_first(made.hub, firsts(events, a=[ConfigError("a.port", "is in use")])):
            raise AssertionError("it has begun")
    assert str(first_error(caught.value)) == "a.port: is in use"
    assert events == ["+b", "-b"]


@inside(in_hub)
async def test_offer_is_found_by_its_type_until_its_run_ends(made: MemoryHub) -> None:
    async with hosted(made.hub, "asks", Counter()) as asks:
        assert asks.offered(Needy) is None
        async with hosted(made.hub, "offers", Counter()) as old:
            old.offer(Needy(port=1))
            old.offer(Needy(port=2))
            assert asks.offered(Needy) == Needy(port=2)
            assert asks.offered(Settings) is None
            async with hosted(made.hub, "offers too", Counter()) as new:
                new.offer(Needy(port=3))
                old.close()
                assert asks.offered(Needy) == Needy(port=3)
        assert asks.offered(Needy) is None


@inside(in_hub)
async def test_each_run_has_the_settings_of_the_last_reload(made: MemoryHub) -> None:
    seen: list[float] = []

    async def note(host: Host) -> None:
        await asyncio.sleep(0.1)
        raise OSError("lost")

    class Noting(Driver):
        hosts: ClassVar = []
        steps: ClassVar = [note]

        def __init__(self, settings: Settings) -> None:
            super().__init__(settings)
            seen.append(settings.speed_m_s)

    async with begun(made.hub, [Chosen("driver", Noting, Settings())]):
        await asyncio.sleep(0.5)
        made.hub.config = replace(made.hub.config, component_settings={"driver": Settings(speed_m_s=0.3)})
        await asyncio.sleep(1.0)
    assert seen == [0.1, 0.3]


# -- members of a stranger's component --------------------------------------------------------------------------------


def failing(member: str, error: BaseException = ValueError("a bug")) -> type[Driver]:  # noqa: B008 - one for all
    def fail(*_: object) -> None:
        raise error

    return type("Faulty", (Driver,), {member: classmethod(fail) if member == "is_wanted" else fail})


ADVICE = "correct the component, or write driver = false below [components]"


@pytest.mark.parametrize(
    ("kind", "ask", "problem"),
    [
        (failing("__init__"), "make", f"__init__ has failed: ValueError('a bug'); {ADVICE}"),
        (failing("check"), "checked", f"check has failed: ValueError('a bug'); {ADVICE}"),
        (failing("check", SystemExit(3)), "checked", f"check has failed: SystemExit(3); {ADVICE}"),
        (failing("check", OSError("no disk")), "checked", f"check has failed: OSError('no disk'); {ADVICE}"),
        (failing("listens"), "checked", f"listens has failed: ValueError('a bug'); {ADVICE}"),
    ],
)
def test_member_that_fails_is_named_with_its_component(kind: type[Driver], ask: str, problem: str) -> None:
    with pytest.raises(ConfigError) as caught:
        getattr(Chosen("driver", kind, Settings()), ask)()
    assert str(caught.value) == f"components.driver: {problem}"


@pytest.mark.parametrize(
    ("facts", "ask", "problem"),
    [
        ({"check": lambda _: None}, "checked", "check has failed"),
        ({"check": lambda _: "two"}, "checked", "check has failed"),
        ({"check": lambda _: [3]}, "checked", "check has failed"),
        ({"listens": lambda _: None}, "checked", "listens has failed"),
        ({"listens": lambda _: {"driver": ("0.0.0.0", "80")}}, "checked", "listens has failed"),
        ({"connections": 7}, "connections", "connections has failed"),
        ({"connections": property(lambda _: {})}, "connections", "connections has failed"),
        ({"connections": {"driver": Connections(descriptors=0)}}, "connections", "least and descriptors must be"),
        ({"connections": {"driver": Connections(least=-1)}}, "connections", "least and descriptors must be"),
        ({"connections": {"tcp": Connections()}}, "connections", "connections names [tcp], which is not its table"),
        ({"connections": {"driver": Connections()}}, "connections", "has no attribute 'max_connections'"),
    ],
)
def test_result_of_a_member_is_checked(facts: dict[str, Any], ask: str, problem: str) -> None:
    with pytest.raises(ConfigError) as caught:
        getattr(Chosen("driver", type("Odd", (Driver,), facts), Settings()), ask)()
    assert str(caught.value).startswith("components.driver: ")
    assert problem in str(caught.value)


@pytest.mark.parametrize("most", [-500, 0])
def test_number_of_connections_must_be_positive(most: int) -> None:
    settings = make_dataclass("Settings", [("max_connections", int)])(most)
    chosen = Chosen("driver", type("Many", (Driver,), {"connections": {"driver": Connections()}}), settings)
    with pytest.raises(ConfigError, match=rf"^driver.max_connections: {most} is not allowed; choose at least 1$"):
        chosen.connections()


def test_failure_of_describe_is_told_in_its_line() -> None:
    line = Chosen("driver", failing("describe"), Settings()).line()
    assert line == "driver: describe has failed: ValueError('a bug')"


@pytest.mark.usefixtures("entry_points")
def test_failure_of_is_wanted_and_a_missing_settings_type_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_of(tmp_path, "[driver]")
    monkeypatch.setattr(f"{__name__}.Driver.is_wanted", classmethod(lambda *_: 1 / 0))
    with pytest.raises(ConfigError, match=r"components\.driver: is_wanted has failed: ZeroDivisionError"):
        chosen_components(config)
    monkeypatch.setattr(f"{__name__}.Driver.settings_type", dict)
    with pytest.raises(ConfigError, match=r"settings_type of .*:Driver is not a dataclass"):
        chosen_components(config)


def test_components_that_use_each_other_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, entry_points: Iterator[dict[str, EntryPoint]]
) -> None:
    assert next(entry_points)
    monkeypatch.setattr(f"{__name__}.Driver.begins_first", True)
    monkeypatch.setattr(f"{__name__}.Driver.uses", ("needy",))
    monkeypatch.setattr(f"{__name__}.NeedyDriver.uses", ("driver",), raising=False)
    with pytest.raises(ConfigError, match=r"components.\w+: they use each other: (driver - needy|needy - driver) - "):
        chosen_components(config_of(tmp_path, "[driver]\n[needy]\nport = 1"))


# -- what it gets -----------------------------------------------------------------------------------------------------


@contextlib.asynccontextmanager
async def a_host(made: MemoryHub) -> Any:
    """The host of a component that does nothing."""

    async def wait(_: Host) -> None:
        await asyncio.Event().wait()

    kind = driver_of(wait)
    async with supervised(made, kind):
        await asyncio.sleep(0.01)
        yield kind.hosts[0]


@inside(in_hub)
async def test_stop_by_a_component_reaches_a_robot_that_another_drives_and_says_what_was_measured(
    made: MemoryHub,
) -> None:
    device = await made.connect()
    async with a_host(made) as host, supervised(made, driver_of(drive_for_ever)):
        await asyncio.sleep(1.0)
        assert velocities(device)[-1] == (0.1, 0.0)
        stopped = await host.stop(by="a button")
        assert set(stopped.robots) == {"robot_0"}
        assert stopped.unreached == ()
        await asyncio.sleep(0.05)
        assert velocities(device)[-1] == (0.0, 0.0)


@inside(in_hub)
async def test_stop_and_lock_of_all_name_a_robot_that_its_zero_does_not_fit_and_those_that_it_fits(
    made: MemoryHub,
) -> None:
    stamped = topic(EndpointKind.SUBSCRIBER, 100, "/bad/cmd_vel", "geometry_msgs/TwistStamped", buffer_bytes=70)
    await made.connect()
    await made.connect([stamped], address="10.0.0.9")
    refusal = "bad: /bad/cmd_vel: frame of 85 bytes, the device takes 70"
    async with a_host(made) as host:
        stopped = await host.stop(by="a button", wait_s=0.0)
        assert (set(stopped.robots), stopped.unreached) == ({"bad", "robot_0"}, (refusal,))
        assert await host.lock(reason="a person", by="a button") == (refusal,)
        assert [robot.lock_reason for robot in host.robots()] == ["a person"] * 2
        for halt in (host.stop("bad", by="a button"), host.lock("bad", reason="a person", by="a button")):
            with pytest.raises(FrameTooLarge):
                await halt


@inside(in_hub)
async def test_lock_of_one_and_of_all_refuses_commands_until_unlock(made: MemoryHub) -> None:
    await made.connect()
    async with a_host(made) as host:
        me = host.join("arm")
        for name in ("robot_0", None):
            assert await host.lock(name, reason="a person", by="a button") == ()
            assert host.robot("robot_0").lock_reason == "a person"
            with pytest.raises(CommandRefused, match="a person"):
                host.drive(me, "robot_0", FORWARD)
            await host.unlock(name, by="a button")
            assert host.robot("robot_0").lock_reason is None
        assert host.drive(me, "robot_0", FORWARD, epoch=host.robot("robot_0").epoch) == FORWARD
        assert [robot.name for robot in host.robots()] == ["robot_0"]


@inside(in_hub)
async def test_command_that_waited_or_was_made_before_a_stop_is_refused(made: MemoryHub) -> None:
    device = await made.connect()
    async with a_host(made) as host:
        me = host.join("arm")
        epoch = host.robot("robot_0").epoch
        host.drive(me, "robot_0", FORWARD, received_s=host.now_s, epoch=epoch)
        await host.stop(by="a button", wait_s=0.0)
        sent = len(velocities(device))
        with pytest.raises(CommandRefused):
            host.drive(me, "robot_0", FORWARD, epoch=epoch)
        with pytest.raises(CommandRefused):
            host.drive(me, "robot_0", FORWARD, received_s=host.now_s - 1.0, epoch=host.robot("robot_0").epoch)
        assert all(each == (0.0, 0.0) for each in velocities(device)[sent - 1 :])


@inside(in_hub)
async def test_unknown_robot_and_lower_role_are_refused(made: MemoryHub) -> None:
    await made.connect()
    async with a_host(made) as host:
        me = host.join("arm")
        for work in (
            host.stop("robot_9", by="x"),
            host.lock("robot_9", reason="x", by="x"),
            host.unlock("robot_9", by="x"),
        ):
            with pytest.raises(UnknownTopic, match="robot_0"):
                await work
        with pytest.raises(UnknownTopic):
            host.robot("robot_9")
        with pytest.raises(UnknownTopic):
            host.follow("robot_9", lambda: None)
        with pytest.raises(UnknownTopic):
            host.drive(me, "robot_9", FORWARD)
        with pytest.raises(NoRole):
            host.drive(host.join("reader", role=Role.READ), "robot_0", FORWARD)


@inside(in_hub)
async def test_observers_of_a_component_end_with_its_run(made: MemoryHub) -> None:
    device = await made.connect()
    events: list[RobotEvent] = []
    poses: list[None] = []
    graphs: list[None] = []
    async with a_host(made) as host:
        host.observe(events.append)
        host.follow("robot_0", lambda: poses.append(None))
        host.watch_graph(lambda: graphs.append(None))
        await device.send(125, struct.pack("<3d", 0.0, 0.0, 0.0))
        host.join("arm").advertise("/chatter", "std_msgs/String")
        await host.lock(reason="x", by="x")
        await asyncio.sleep(0.5)
        assert events
        assert poses
        assert graphs
    seen = len(events), len(poses), len(graphs)
    made.robot().unlock()
    await asyncio.sleep(1.0)
    assert (len(events), len(poses), len(graphs)) == seen
    assert all(topic.name != "/chatter" for topic in made.hub.topics.all())


@inside(in_hub)
async def test_counters_and_troubles_are_shown_and_a_participant_that_left_is_forgotten(made: MemoryHub) -> None:
    async with a_host(made) as host:
        host.count("sent")
        host.count("sent", 2)
        assert made.hub.counts.components["driver"]()["sent"] == 3
        host.report("the broker does not answer")
        assert codes(made) == ["component_troubled"]
        host.report("")
        assert codes(made) == []
        before = len(host._participants)
        for number in range(100):
            host.join(f"program {number}").leave()
        assert len(host._participants) == before
        assert host.listening == made.hub.listening
        ends: list[str] = []
        host.request_end("no daemon ends by itself")
        made.hub.on_end_request = ends.append
        host.request_end("shut down")
        assert ends == ["shut down"]
        host.log.info("driver.done")
    assert made.logged("driver.done")[0]["component"] == "driver"


# -- which components run ---------------------------------------------------------------------------------------------


def config_of(tmp_path: Path, text: str) -> Config:
    path = tmp_path / "hostlink.toml"
    path.write_text(text)
    return load(path)


@pytest.mark.usefixtures("entry_points")
def test_component_runs_by_its_table_or_by_its_switch(tmp_path: Path) -> None:
    for text, wanted in (
        ("", []),
        ("[driver]", [("driver", Settings())]),
        ("[components]\ndriver = true", [("driver", Settings())]),
        ("[driver]\nspeed_m_s = 0.2\n[components]\ndriver = false", []),
        (
            '[driver]\nspeed_m_s = 0.2\nfolder = "keys"\ntags = ["a"]',
            [("driver", Settings(speed_m_s=0.2, folder=tmp_path / "keys", tags=("a",)))],
        ),
        ("[needy]\nport = 1", [("needy", Needy(port=1))]),
    ):
        chosen = chosen_components(config_of(tmp_path, text))
        assert [(name, settings) for name, _, settings in chosen] == wanted


@pytest.mark.usefixtures("entry_points")
@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[drivr]", "unknown key drivr"),
        ("component_settings = 1", "unknown key component_settings; each component has a table of its own name"),
        ("[driver]\nspeed = 1", "unknown key driver.speed; did you mean speed_m_s?"),
        ("[driver]\nspeed_m_s = 'x'", "Expected `float`, got `str` - at `$.driver.speed_m_s`"),
        ("driver = 3", "Expected `object`, got `int` - at `$.driver`"),
        ("[needy]", "Object missing required field `port` - at `$.needy`"),
        ("[components]\nneedy = true", "it needs a table [needy] with its settings: port"),
        ("[components]\ndrivr = true", "no installed package has this component; known: broken, driver"),
        ("[components]\ndriver = 1", "Expected `bool`, got `int`"),
        ("[broken]", "no_such_module:X cannot be imported: ModuleNotFoundError"),
        ("[module]", f"{__name__}:Settings is not a subclass of Component"),
        ("[other]", f"{__name__}:Driver has the name driver"),
    ],
)
def test_component_that_cannot_run_is_named_with_its_reason(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(ConfigError) as caught:
        chosen_components(config_of(tmp_path, text))
    assert problem in str(caught.value)


def test_usual_component_runs_unless_it_is_off_and_has_the_tables_that_are_its_own(tmp_path: Path) -> None:
    config = config_of(tmp_path, "[api]\nport = 1234\n[black_box]\nbefore_s = 7.0\n[components]\nmqtt = false")
    gateway, recorder = chosen_components(config, ["recorder", "gateway"])
    assert (gateway.settings.api.port, recorder.settings.black_box.before_s) == (1234, 7.0)  # type: ignore[attr-defined]
    assert chosen_components(config) == []
    off = config_of(tmp_path, "[components]\ngateway = false\nrecorder = true")
    assert [each.name for each in chosen_components(off, ["recorder", "gateway"])] == ["recorder"]
    with pytest.raises(
        ConfigError, match=r"recorder: the settings of this component are in \[recording\] and \[black_b"
    ):
        config_of(tmp_path, "[recorder]")
    with pytest.raises(ConfigError, match=r"unknown key mqqt; did you mean mqtt\?"):
        config_of(tmp_path, "[mqqt]")


@pytest.mark.parametrize(
    ("text", "is_chosen"),
    [
        pytest.param("[ros1]\nname = 'lab'", False, id="no master"),
        pytest.param("[ros1]\nmaster = 'http://localhost:11311'", True, id="master"),
        pytest.param("[ros1]\nmaster = 'http://localhost:11311'\n[components]\nros1 = false", False, id="off"),
        pytest.param("[components]\nros1 = true", True, id="on"),
    ],
)
def test_table_that_does_not_want_its_component_to_run_needs_a_switch(
    tmp_path: Path, text: str, is_chosen: bool
) -> None:
    assert [each.name for each in chosen_components(config_of(tmp_path, text))] == ["ros1"] * is_chosen


def test_installed_components_are_known_by_name() -> None:
    names = [each.name for each in importlib.metadata.entry_points(group=components.GROUP)]
    assert {"gateway", "mdns", "mqtt", "recorder", "ros1"} <= set(names)
    assert all(find_component(name).name == name for name in names)
