"""Names, limits, tokens and origins change while robots are driven; what is wrong changes nothing."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import aiohttp
import pytest
from structlog.testing import capture_logs

from hostlink.client import connect
from hostlink.components.gateway.settings import ApiConfig, TokenConfig
from hostlink.core.config import Config, LinkConfig, RobotConfig, SerialConfig, TcpConfig
from hostlink.core.robot.velocity import ZERO
from hostlink.errors import ConfigError, HostlinkError
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import fake_device, robot_topics
from tests.support.logs import logged
from tests.support.rosbridge import Client
from tests.support.waiting import expect

ALICE, BOB = "the-token-of-alice-1", "the-token-of-bob-123"
BOTH = (TokenConfig(name="alice", role="drive", token=ALICE), TokenConfig(name="bob", role="drive", token=BOB))
GUARDED = Config().with_tables(api=ApiConfig(tokens=BOTH))
VELOCITY = "/robot_0/velocity_commands"


class File:
    """The configuration file; a test writes another one."""

    def __init__(self, config: Config) -> None:
        self.config = config


@contextlib.asynccontextmanager
async def served(config: Config) -> AsyncIterator[tuple[Daemon, File]]:
    """A daemon that was started with a file."""
    file = File(config)
    async with daemon(config, read=lambda: file.config) as host:
        yield host, file


async def reload(host: Daemon, token: str = "") -> tuple[int, dict[str, object]]:
    """(status, JSON)."""
    return await host.rest("POST", f"/api/reload?token={token}")


def robots(**configs: RobotConfig) -> Config:
    return Config(robots=configs)


# -- limits -----------------------------------------------------------------------------------------------------------


async def test_a_lower_limit_slows_a_robot_that_is_driven() -> None:
    async with (
        served(Config()) as (host, file),
        fake_device(host.tcp, robot_topics()) as device,
        connect(host.url) as program,
    ):
        await program.robot("robot_0").drive(0.5, 0.0)
        assert await device.velocity_other_than((0.0, 0.0)) == (0.5, 0.0)
        file.config = robots(robot_0=RobotConfig(max_linear_m_s=0.1))
        assert (await reload(host))[1]["changed"] == ["robots.robot_0.max_linear_m_s"]
        assert await device.velocity_other_than((0.5, 0.0)) == (0.1, 0.0)
        assert host.hub.robots.find_here("robot_0").gate.owner_name is not None  # it drives on


async def test_kinematics_apply_to_the_next_velocity() -> None:
    sideways = b'{"linear": 0.0, "linear_y_m_s": 0.2, "angular": 0}'
    async with served(Config()) as (host, file), fake_device(host.tcp, robot_topics()):
        await host.drive("robot_0", sideways)
        file.config = robots(robot_0=RobotConfig(kinematics="differential"))
        assert (await reload(host))[1]["changed"] == ["robots.robot_0.kinematics"]
        status, answer = await host.rest("PUT", "/api/robots/robot_0/velocity", sideways)
        assert (status, answer["error"]["kind"]) == (400, "unsupported")  # type: ignore[index]
        assert host.hub.robots.find_here("robot_0").odometry.is_differential
        file.config = robots(robot_0=RobotConfig(kinematics="mecanum", wheel_separation_m=0.4, wheelbase_m=0.2))
        await reload(host)
        await host.drive("robot_0", sideways)
        assert host.hub.robots.find_here("robot_0").admission.drive.wheels[2:] == ("rear_left", "rear_right")


# -- names ------------------------------------------------------------------------------------------------------------


async def test_two_robots_swap_their_names() -> None:
    left, right = RobotConfig(address="127.0.0.2"), RobotConfig(address="127.0.0.3")
    async with (
        served(robots(left=left, right=right)) as (host, file),
        fake_device(host.tcp, robot_topics(), local_host="127.0.0.2"),
        fake_device(host.tcp, robot_topics(), local_host="127.0.0.3") as device,
    ):
        await expect(lambda: [each.name for each in host.hub.robots.here()] == ["left", "right"])
        file.config = robots(left=right, right=left)
        assert (await reload(host))[1]["renamed"] == {"left": "right", "right": "left"}
        status, _ = await host.rest("PUT", "/api/robots/left/velocity", b'{"linear": 0.2, "angular": 0}')
        assert status == 200
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)


async def test_configured_name_is_kept_after_a_reconnection() -> None:
    named = robots(rover=RobotConfig(address="127.0.0.1"))
    async with served(Config()) as (host, file):
        async with fake_device(host.tcp, robot_topics()):
            await expect(lambda: host.hub.robots.has("robot_0"))
            file.config = named
            assert (await reload(host))[1]["renamed"] == {"robot_0": "rover"}
            assert [each.name for each in host.hub.robots.all()] == ["rover"]  # and nothing is left of the other name
        async with fake_device(host.tcp, robot_topics()):
            await expect(lambda: host.hub.robots.find_here("rover").link is not None)
        file.config = Config()
        assert (await reload(host))[1]["changed"] == ["robots.rover.address"]


async def test_a_locked_robot_that_is_away_keeps_its_name() -> None:
    async with served(Config()) as (host, file):
        async with fake_device(host.tcp, robot_topics()):
            await expect(lambda: host.hub.robots.has("robot_0"))
            await host.rest("POST", "/api/robots/robot_0/lock")
        await expect(lambda: host.hub.robots.find_here("robot_0").link is None)
        file.config = robots(rover=RobotConfig(address="127.0.0.1"))
        assert (await reload(host))[0] == 409
        async with fake_device(host.tcp, robot_topics()):
            await expect(lambda: host.hub.robots.find_here("robot_0").link is not None)
            assert host.hub.robots.find_here("robot_0").gate.lock_reason is not None


async def test_a_robot_that_is_configured_no_more_can_be_forgotten() -> None:
    config = replace(robots(robot_0=RobotConfig(max_linear_m_s=0.1)), link=LinkConfig(forget_robot_after_s=0.0))
    async with served(config) as (host, file):
        async with fake_device(host.tcp, robot_topics()):
            await expect(lambda: host.hub.robots.has("robot_0"))
        await expect(lambda: host.hub.robots.find_here("robot_0").link is None)
        file.config = replace(config, robots={})
        await reload(host)
        await expect(lambda: not host.hub.robots.has("robot_0"))


# -- tokens -----------------------------------------------------------------------------------------------------------


async def drive_on(host: Daemon) -> None:
    """Drive by the client, which repeats its command and connects again, until it is cut off."""
    with contextlib.suppress(HostlinkError):
        async with connect(host.url, token=ALICE) as program:
            await program.robot("robot_0").drive(0.2, 0.0)
            await asyncio.Event().wait()


async def test_driver_with_a_withdrawn_token_is_disconnected_and_the_robot_is_stopped() -> None:
    async with (
        served(GUARDED) as (host, file),
        fake_device(host.tcp, robot_topics()) as device,
        host.session.ws_connect(f"{host.url}/?token={BOB}") as neighbour,
        asyncio.TaskGroup() as tasks,
    ):
        await expect(lambda: host.hub.robots.has("robot_0"))
        driving = tasks.create_task(drive_on(host))
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
        file.config = Config().with_tables(api=ApiConfig(tokens=BOTH[1:]))
        changed = {"changed": ["api.tokens"], "needs_restart": [], "renamed": {}}
        assert await reload(host, BOB) == (200, changed)
        assert await device.velocity_other_than((0.2, 0.0)) == (0.0, 0.0)
        gate = host.hub.robots.find_here("robot_0").gate
        await asyncio.sleep(2 * gate.admission.lease_s)  # it may try again
        assert (gate.owner, gate.current) == (None, ZERO)
        await Client(neighbour).send(op="publish", topic=VELOCITY, msg={"linear": {"x": 0.1}})
        assert await device.velocity_other_than((0.0, 0.0)) == (0.1, 0.0)
        driving.cancel()


async def test_another_secret_in_the_token_s_file_withdraws_the_first(tmp_path: Path) -> None:
    (tmp_path / "token").write_text(ALICE)
    tokens = (TokenConfig(name="alice", role="drive", token_file=tmp_path / "token"),)
    async with served(Config().with_tables(api=ApiConfig(tokens=tokens))) as (host, _):
        async with host.session.ws_connect(f"{host.url}/?token={ALICE}") as socket:
            (tmp_path / "token").write_text(BOB)
            assert (await reload(host, ALICE))[0] == 200
            assert (await socket.receive()).type in (aiohttp.WSMsgType.CLOSED, aiohttp.WSMsgType.CLOSE)
        assert (await reload(host, ALICE))[0] == 401
        assert (await reload(host, BOB))[0] == 200


# -- what is refused --------------------------------------------------------------------------------------------------


async def test_other_settings_need_a_restart_and_are_named() -> None:
    async with served(Config()) as (host, file):
        file.config = Config(
            tcp=TcpConfig(max_connections=3),
            serial=(SerialConfig(path="/dev/ttyACM7"),),
            robots={"robot_0": RobotConfig(max_linear_m_s=0.1, publish_tf=False)},
        )
        with capture_logs() as lines:
            _, answer = await reload(host)
        assert answer["changed"] == ["robots.robot_0.max_linear_m_s"]
        assert answer["needs_restart"] == ["tcp.max_connections", "serial", "robots.robot_0.publish_tf"]
        assert logged(lines) == ["config.reloaded"]
        assert (await reload(host))[1]["changed"] == []


@pytest.mark.parametrize(
    "wrong",
    [
        Config(robots={"robot_0": RobotConfig(max_linear_m_s=-1.0)}).with_tables(api=ApiConfig(tokens=BOTH)),
        Config(robots={"robot_0": RobotConfig(max_linear_m_s=0.1)}).with_tables(
            api=ApiConfig(tokens=(BOTH[0], BOTH[0]))
        ),
        Config(robots={"robot_0": RobotConfig(max_linear_m_s=0.1)}).with_tables(api=ApiConfig(origins=("*",))),
    ],
    ids=["limit", "tokens", "origins"],
)
async def test_invalid_file_changes_nothing(wrong: Config) -> None:
    async with served(Config()) as (host, file), fake_device(host.tcp, robot_topics()):
        await expect(lambda: host.hub.robots.has("robot_0"))
        file.config = wrong
        status, _ = await reload(host)
        assert status >= 400
        assert host.hub.config.robots == {}
        assert host.hub.robots.find_here("robot_0").config == RobotConfig()
        assert (await host.rest("GET", "/api/robots"))[0] == 200  # without a token, as before


async def test_a_file_that_cannot_be_read_changes_nothing() -> None:
    def read() -> Config:
        raise ConfigError("hostlink.toml", "is not TOML")

    async with daemon(read=read) as host:
        status, answer = await reload(host)
        assert (status, answer["error"]) == (500, {"kind": "ConfigError", "reason": "hostlink.toml: is not TOML"})
