"""`hostlink stop`, `lock` and `unlock` of several robots, and of all."""

import asyncio
import json
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, cast

import pytest
import typer

from hostlink.cli.robots import _halt, _lock, _stop, _unlock
from hostlink.client import Host, Robot, Standstill, StandstillState, Stopped, StoppedRobot
from hostlink.core.config import Config, RobotConfig
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.errors import CommandRefused, HostlinkError, Refused, StopFailed
from tests.support.background import cancelling
from tests.support.fake_device import topic
from tests.support.memory_client import memory_host
from tests.support.memory_hub import SETTLED_S, MemoryHub, in_hub
from tests.support.participants import publish
from tests.support.remote_robots import RecordingHosts, connected_robot, reach

STOPPED = StoppedRobot(StandstillState.STOPPED, 0.0, 0.0, 0.0)


class _Host:
    """A host with robots of these names, which notes what is asked of it."""

    def __init__(self, *names: str) -> None:
        self.names = names
        self.asked: list[str] = []

    async def robots(self) -> list[dict[str, Any]]:
        return [{"name": name, "locked": True, "connected": True} for name in self.names]

    def robot(self, name: str) -> Any:
        return _Robot(self, name)

    async def stop_all(self) -> Stopped:
        self.asked.append("stop all")
        return Stopped(await self.standstill())

    async def lock_all(self, reason: str) -> Stopped:
        self.asked.append(f"lock all: {reason}")
        return Stopped(await self.standstill())

    async def unlock_all(self) -> list[dict[str, Any]]:
        self.asked.append("unlock all")
        return await self.robots()

    async def get(self, path: str) -> dict[str, Any]:
        assert path == "/api/devices"
        return {"devices": [], "lock_reason": None}

    async def standstill(self) -> dict[str, Standstill]:
        return dict.fromkeys(self.names, STOPPED)


class _Robot:
    def __init__(self, host: _Host, name: str) -> None:
        self.host, self.name = host, name

    async def unlock(self) -> None:
        self.host.asked.append(f"unlock {self.name}")

    async def state(self) -> dict[str, Any]:
        return {"name": self.name}


@pytest.fixture
def halted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Commands that robots got; the commands of the shell name the methods of Robot."""
    asked: list[str] = []

    def noting(word: str) -> Any:
        async def halt(robot: Any, **_: object) -> StoppedRobot:
            if robot.name not in robot.host.names:
                raise Refused("UnknownTopic", f"no robot is named {robot.name}")
            asked.append(f"{word} {robot.name}")
            return STOPPED

        return halt

    for word in ("stop", "lock"):
        monkeypatch.setattr(Robot, word, noting(word))
    return asked


async def test_no_stop_waits_for_a_robot_whose_daemon_does_not_answer(capsys: pytest.CaptureFixture[str]) -> None:
    is_near_stopped = asyncio.Event()

    async def stop(robot: Robot, *, wait_s: float) -> StoppedRobot:
        if robot.name == "far":
            await is_near_stopped.wait()
            raise HostlinkError("far does not answer")
        is_near_stopped.set()
        return STOPPED

    async with asyncio.timeout(1.0):
        with pytest.raises(HostlinkError, match="far does not answer"):
            await _halt(cast("Host", _Host("far", "near")), ["far", "near"], stop, json=False, of_all="")
    assert capsys.readouterr().out.startswith("near is stopped")


@pytest.mark.parametrize("names", [["all"], ["*"], ["ALL"], ["/all"], ["far", "all"], ["all", "nonsense"], []])
async def test_the_word_all_stops_locks_and_unlocks_every_robot(names: list[str], halted: list[str]) -> None:
    made = _Host("far", "near")
    host = cast("Host", made)
    await _stop(host, names, json=False)
    assert made.asked == ["stop all"]
    await _lock(host, names, "a foot", json=False)
    await _unlock(host, names, everything=not names)
    assert (halted, made.asked) == ([], ["stop all", "lock all: a foot", "unlock all"])


async def test_a_robot_that_is_named_all_keeps_its_name(halted: list[str]) -> None:
    made = _Host("all", "near")
    host = cast("Host", made)
    await _stop(host, ["all"], json=False)
    await _lock(host, ["all"], "a foot", json=False)
    await _unlock(host, ["all"], everything=False)
    assert (halted, made.asked) == (["stop all", "lock all"], ["unlock all"])


async def test_the_refusal_of_an_unknown_robot_names_the_command_for_every_robot(halted: list[str]) -> None:
    host = cast("Host", _Host("robot_0"))
    for wanted, done in (
        ("`hostlink stop` stops every robot", _stop(host, ["robot_9"], json=False)),
        ("`hostlink lock` locks every robot", _lock(host, ["robot_9"], "a foot", json=False)),
    ):
        with pytest.raises(HostlinkError, match="no robot named robot_9") as found:
            await done
        assert str(found.value).endswith(wanted)
    assert halted == []


# -- robots and boards of a hub ---------------------------------------------------------------------------------------

MOTOR = topic(EndpointKind.SUBSCRIBER, 110, "/left_motor", "std_msgs/Int16")
WORD = topic(EndpointKind.SUBSCRIBER, 111, "/motor_command", "std_msgs/String")
CAR = topic(EndpointKind.SUBSCRIBER, 100, "/car/cmd_vel", "geometry_msgs/Twist")  # of a robot without odometry
SENT = " of link 2 (10.0.0.3)"


def in_daemon(test: Callable[[MemoryHub, Host], Awaitable[None]], config: Config | None = None) -> None:
    """Run a test with a connection of the client to a hub."""

    async def run(made: MemoryHub) -> None:
        async with cancelling() as tasks, memory_host(made.hub, tasks) as host:
            await test(made, host)

    in_hub(run, config)


def outcome(work: Coroutine[Any, Any, None], capsys: pytest.CaptureFixture[str]) -> Awaitable[tuple[int, list[str]]]:
    """Return the exit status of a command, and what it wrote."""

    async def run() -> tuple[int, list[str]]:
        status = 0
        try:
            await work
        except typer.Exit as end:
            status = end.exit_code
        return status, capsys.readouterr().out.splitlines()

    return run()


class OtherDaemons(RecordingHosts):
    """Other daemons, of which one has a robot with a topic that nothing guards. Two orders are on their way."""

    async def settled(self) -> list[CommandEndpoint]:
        far = CommandEndpoint(
            4, "10.0.0.9", "far", "/far/motor", "std_msgs/Int16", is_guarded=False, is_locked=True, host="lab"
        )
        return [far, far._replace(robot="another", topic="/another/motor")]


@pytest.mark.parametrize("verb", ["stop", "lock"])
def test_unguarded_topics_of_a_robot_of_another_daemon_are_named_as_those_of_one_here(
    verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    async def test(made: MemoryHub, host: Host) -> None:
        reach(made.hub, OtherDaemons())
        connected_robot(made.hub, "far", OtherDaemons())
        await made.connect([CAR, MOTOR])
        for names in (["far"], ["far", "car"]):
            work = _stop(host, names, json=False) if verb == "stop" else _lock(host, names, "a foot", json=False)
            status, lines = await outcome(work, capsys)
            named = [line.split(" of link ")[0] for line in lines if " of link " in line]
            assert named == ["/far/motor", "/left_motor"][: len(names)]
            assert next(line for line in lines if "/far/motor" in line).startswith(
                "/far/motor of link 4 (10.0.0.9) at lab"
            )
            assert status == (1 if verb == "stop" else 0)

    in_daemon(test)


def test_lock_of_all_holds_for_a_robot_and_a_board_without_one(capsys: pytest.CaptureFixture[str]) -> None:
    async def test(made: MemoryHub, host: Host) -> None:
        await made.connect([CAR])
        board = await made.connect([MOTOR], address="10.0.0.3")
        assert await outcome(_lock(host, [], "a foot", json=False), capsys) == (
            0,
            [
                "car is locked: a foot",
                "zero sent; car has no odometry, so nobody can say that it is stopped",
                f"/left_motor{SENT} is locked: a foot; zero sent",
            ],
        )
        await asyncio.sleep(SETTLED_S)
        assert board.payloads(110) == [bytes(2)]
        with pytest.raises(CommandRefused, match="/left_motor: locked: a foot"):
            publish(made.hub, "/left_motor", {"data": 50}, type_name="std_msgs/Int16")
        assert await outcome(_unlock(host, [], everything=False), capsys) == (
            0,
            ["car may be driven", "boards that are not robots may be driven"],
        )
        publish(made.hub, "/left_motor", {"data": 50}, type_name="std_msgs/Int16")

    in_daemon(test)


def test_lock_of_all_names_a_topic_without_a_zero_and_fails(capsys: pytest.CaptureFixture[str]) -> None:
    async def test(made: MemoryHub, host: Host) -> None:
        await made.connect()
        await made.connect([WORD], address="10.0.0.3")
        status, lines = await outcome(_lock(host, [], "a foot", json=False), capsys)
        assert (status, lines[-1]) == (
            1,
            f"/motor_command{SENT} is locked: a foot; was not sent a zero: std_msgs/String has no value that surely "
            "means stop; `hostlink robots --explain` shows the setting that makes a robot of it",
        )

    in_daemon(test)


def test_lock_of_one_robot_names_what_else_its_board_takes(capsys: pytest.CaptureFixture[str]) -> None:
    async def test(made: MemoryHub, host: Host) -> None:
        await made.connect([CAR, WORD])
        await made.connect([MOTOR], address="10.0.0.3")
        status, lines = await outcome(_lock(host, ["car"], "a foot", json=False), capsys)
        assert status == 1
        assert lines[-1].startswith("/motor_command of link 1 (10.0.0.2) is locked: a foot; was not sent a zero")

    in_daemon(test)


def test_stop_of_a_board_without_any_robot_is_sent_and_not_confirmed(capsys: pytest.CaptureFixture[str]) -> None:
    async def test(made: MemoryHub, host: Host) -> None:
        board = await made.connect([MOTOR], address="10.0.0.3")
        sent = "/left_motor of link 1 (10.0.0.3): zero sent"
        assert await outcome(_stop(host, [], json=False), capsys) == (
            1,
            [f"{sent}; it is not a robot's, so nobody can say that it is stopped"],
        )
        await asyncio.sleep(SETTLED_S)
        assert (await outcome(_stop(host, [], is_measured=False, json=False), capsys))[0] == 0
        await asyncio.sleep(SETTLED_S)
        assert board.payloads(110) == [bytes(2)] * 2

    in_daemon(test)


def test_stop_of_a_robot_without_odometry_needs_no_measure_for_success(capsys: pytest.CaptureFixture[str]) -> None:
    async def test(made: MemoryHub, host: Host) -> None:
        await made.connect([CAR])
        told = "zero sent; car has no odometry, so nobody can say that it is stopped"
        for names in ([], ["car"]):
            assert await outcome(_stop(host, names, json=False), capsys) == (1, [told])
            assert await outcome(_stop(host, names, is_measured=False, json=False), capsys) == (0, ["car: zero sent"])

    in_daemon(test)


def test_stop_of_all_without_measure_fails_for_a_topic_without_a_zero(capsys: pytest.CaptureFixture[str]) -> None:
    async def test(made: MemoryHub, host: Host) -> None:
        await made.connect([CAR, WORD])
        status, lines = await outcome(_stop(host, [], is_measured=False, json=True), capsys)
        robot, endpoint = json.loads(lines[0])
        assert (status, robot["name"], endpoint["topic"], endpoint["is_zero_sent"]) == (
            1, "car", "/motor_command", False,
        )  # fmt: skip

    in_daemon(test)


def test_unlock_of_boards_alone_needs_no_robot(capsys: pytest.CaptureFixture[str]) -> None:
    async def test(made: MemoryHub, host: Host) -> None:
        await made.connect([MOTOR], address="10.0.0.3")
        await outcome(_lock(host, [], "a foot", json=False), capsys)
        assert await outcome(_unlock(host, [], everything=True), capsys) == (
            0,
            ["boards that are not robots may be driven"],
        )
        with pytest.raises(HostlinkError, match="no robot has connected yet"):
            await _unlock(host, [], everything=True)

    in_daemon(test)


@pytest.mark.parametrize("names", [["car"], []])
def test_robot_whose_device_is_away_is_locked_and_the_status_says_that_it_was_sent_nothing(
    names: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    async def test(made: MemoryHub, host: Host) -> None:
        device = await made.connect([CAR])
        await device.aclose()
        await asyncio.sleep(SETTLED_S)
        assert await outcome(_stop(host, names, is_measured=False, json=False), capsys) == (
            1,
            ["car: not sent a zero: its device is not connected"],
        )
        assert await outcome(_lock(host, names, "a foot", json=False), capsys) == (
            1,
            ["car is locked: a foot", "car: it is not known whether it is stopped: its device is not connected"],
        )
        assert made.robot("car").gate.lock_reason == "a foot"

    in_daemon(test)


def test_robot_of_the_settings_is_stopped_and_locked_by_its_name_before_it_has_connected(
    capsys: pytest.CaptureFixture[str],
) -> None:
    config = Config(robots={"duo": RobotConfig(devices=("10.0.0.3", "10.0.0.4"))})

    async def test(made: MemoryHub, host: Host) -> None:
        board = await made.connect([MOTOR], address="10.0.0.3")
        why = "duo: it is not known whether it is stopped: its device 10.0.0.4 is not connected"
        status, lines = await outcome(_lock(host, ["duo"], "a foot", json=False), capsys)
        assert status == 1
        assert lines[:2] == ["duo is locked: a foot", why]
        assert lines[2].startswith("/left_motor of link 1 (10.0.0.3) is locked: a foot; zero sent")
        await asyncio.sleep(SETTLED_S)
        assert set(board.payloads(110)) == {bytes(2)}
        await made.connect([CAR], address="10.0.0.4")
        assert made.robot("duo").state(made.now_s).lock_reason == "a foot"
        with pytest.raises(HostlinkError, match="there is no robot named dou; similar names: duo"):
            await _stop(host, ["dou"], json=False)

    in_daemon(test, config)


def test_stop_of_a_robot_without_its_encoder_board_says_that_the_zero_was_sent(
    capsys: pytest.CaptureFixture[str],
) -> None:
    config = Config(robots={"duo": RobotConfig(devices=("10.0.0.3", "10.0.0.4"))})

    async def test(made: MemoryHub, host: Host) -> None:
        await made.connect([CAR], address="10.0.0.3")
        assert await outcome(_stop(host, [], is_measured=False, json=False), capsys) == (
            1,
            ["duo: zero sent as far as possible: its device 10.0.0.4 is not connected"],
        )

    in_daemon(test, config)


@pytest.mark.parametrize("verb", ["stop", "stop --no-measure", "lock"])
def test_robot_whose_zero_does_not_fit_hides_no_other_in_the_answer_of_a_stop_of_all(
    verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    stamped = topic(EndpointKind.SUBSCRIBER, 101, "/bad/cmd_vel", "geometry_msgs/TwistStamped", buffer_bytes=70)

    async def test(made: MemoryHub, host: Host) -> None:
        await made.connect([CAR])
        await made.connect([stamped], address="10.0.0.4")
        await made.connect([MOTOR], address="10.0.0.3")
        is_lock, is_measured = verb == "lock", verb == "stop"
        if is_lock:
            work = _lock(host, [], "a foot", json=False)
        else:
            work = _stop(host, [], is_measured=is_measured, json=False)
        with pytest.raises(StopFailed, match="/bad/cmd_vel: frame of ") as failed:
            await work
        assert failed.value.kind == "FrameTooLarge"
        lines = capsys.readouterr().out.splitlines()
        about = [line for line in lines if "bad" in line]
        assert "frame of " in about[-1]
        assert any(
            line.startswith("zero sent; car has" if is_lock or is_measured else "car: zero sent") for line in lines
        )
        assert lines[-1].startswith("/left_motor of link 3 (10.0.0.3)")
        assert "zero sent" in lines[-1]
        assert all(robot.gate.lock_reason == ("a foot" if is_lock else None) for robot in made.hub.robots.here())

    in_daemon(test)
