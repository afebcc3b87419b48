"""Fleet with certificates: links without TLS, certificates of others, and names of another daemon."""

import asyncio
import contextlib
import functools
import json
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from structlog.testing import capture_logs

from hostlink.components.zenoh.session import ZenohSample, ZenohSession, opened
from hostlink.components.zenoh.settings import ZenohSettings
from hostlink.core.config import Config
from hostlink.core.hub.isolation import Isolation
from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, robot_topics
from tests.support.process import free_port
from tests.support.waiting import expect
from tests.support.zenoh_certificates import make_authority, make_certificate
from tests.support.zenoh_fleet import drive, robot, shown

STILL = (0.0, 0.0)
OPEN_TIMEOUT_MS = 3000
TLS = "transport/link/tls"


def certified(folder: Path, certificate: str, **settings: Any) -> ZenohSettings:
    """Settings with the certificate of this name, and that name unless another is claimed."""
    pem, key = make_certificate(folder, certificate)
    return ZenohSettings(**{"name": certificate, "ca": folder / "ca.pem", "certificate": pem, "key": key, **settings})


# -- ways in ----------------------------------------------------------------------------------------------------------


def raw(endpoint: str, **settings: object) -> zenoh.Config:
    """Zenoh as its users have it, which fails when it cannot connect."""
    made = zenoh.Config()
    for name, value in {
        "connect/endpoints": [endpoint],
        "connect/exit_on_failure": True,
        "connect/timeout_ms": OPEN_TIMEOUT_MS,
        "transport/unicast/open_timeout": OPEN_TIMEOUT_MS,
        "scouting/multicast/enabled": False,
        **settings,
    }.items():
        made.insert_json5(name, json.dumps(value))
    return made


def shows(folder: Path, name: str) -> dict[str, object]:
    """The settings of one who shows a certificate of the authority in this folder."""
    certificate, key = map(str, make_certificate(folder, name))
    return {f"{TLS}/connect_certificate": certificate, f"{TLS}/connect_private_key": key, f"{TLS}/enable_mtls": True}


def trusts(folder: Path) -> dict[str, object]:
    return {f"{TLS}/root_ca_certificate": str(folder / "ca.pem")}


async def connects(settings: zenoh.Config) -> bool:
    try:
        session = await asyncio.to_thread(zenoh.open, settings)
    except zenoh.ZError:
        return False
    try:
        return bool(session.info.peers_zid())
    finally:
        await asyncio.to_thread(session.close)


async def test_a_fleet_with_certificates_is_entered_by_tls_and_a_certificate_alone(tmp_path: Path) -> None:
    fleets, others = tmp_path / "fleet", tmp_path / "others"
    for folder in (fleets, others):
        folder.mkdir()
        make_authority(folder)
    port = free_port()
    ways = {
        "tcp": raw(f"tcp/127.0.0.1:{port}"),
        "udp": raw(f"udp/127.0.0.1:{port}"),
        "ws": raw(f"ws/127.0.0.1:{port}"),
        "quic": raw(f"quic/127.0.0.1:{port}", **trusts(fleets), **shows(fleets, "desk")),
        "no certificate": raw(f"tls/127.0.0.1:{port}", **trusts(fleets)),
        "another authority": raw(f"tls/127.0.0.1:{port}", **trusts(fleets), **shows(others, "desk")),
        "a certificate": raw(f"tls/127.0.0.1:{port}", **trusts(fleets), **shows(fleets, "desk")),
    }
    own = certified(fleets, "lab-1", listen=(f"tls/127.0.0.1:{port}",))
    async with daemon(Config(component_settings={"zenoh": own})), asyncio.TaskGroup() as tasks:
        tries = {way: tasks.create_task(connects(settings)) for way, settings in ways.items()}
        await asyncio.wait(tries.values())
    assert [way for way, is_open in tries.items() if is_open.result()] == ["a certificate"]


# -- names ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_robots_daemon_called", [True, False], ids=["it is called", "it calls"])
async def test_a_name_that_is_not_in_the_certificate_does_not_drive(
    tmp_path: Path, is_robots_daemon_called: bool
) -> None:
    make_authority(tmp_path)
    ports = [free_port() for _ in range(3)]
    here, desk, wall = [(f"tls/127.0.0.1:{port}",) for port in ports]
    calls = {"connect": () if is_robots_daemon_called else (*desk, *wall)}
    called = {"connect": here if is_robots_daemon_called else ()}
    lab = certified(tmp_path, "lab-1", listen=here, drivers=("desk",), **calls)
    with capture_logs() as logs:
        await _try_names(tmp_path, Config(component_settings={"zenoh": lab}), desk, wall, called)
    differs = [each for each in logs if each["event"] == "fleet.name_differs"]
    assert {(each["host"], each["certificate"]) for each in differs} == {("desk", "wall")}


async def _try_names(
    folder: Path, lab: Config, desk: tuple[str], wall: tuple[str], called: dict[str, tuple[str, ...]]
) -> None:
    async with (
        daemon(Config(component_settings={"zenoh": certified(folder, "desk", listen=desk, **called)})) as driver,
        daemon(
            Config(component_settings={"zenoh": certified(folder, "wall", name="desk", listen=wall, **called)})
        ) as pretender,
        daemon(lab) as host,
        fake_device(host.tcp, robot_topics("robot_7")) as device,
    ):
        await shown(driver, "robot_7")
        await shown(pretender, "robot_7")
        status, answer = await drive(pretender, "robot_7", 0.3)
        assert (status, answer["error"]["kind"]) == (503, "DeviceGone")
        assert (await robot(pretender, "robot_7"))["holder"] is None
        assert (await drive(driver, "robot_7", 0.2))[0] == 200
        assert await device.velocity_other_than(STILL) == (0.2, 0.0)
        assert (await pretender.rest("POST", "/api/stop"))[0] == 200
        assert await device.velocity_other_than((0.2, 0.0)) == STILL


@contextlib.asynccontextmanager
async def session(config: ZenohSettings) -> AsyncIterator[ZenohSession]:
    async with opened(config, Isolation().around) as made:
        yield made


def is_in(key: str, received: list[str], first: int) -> bool:
    return key in received[first:]


async def test_only_drivers_send_what_moves_a_robot_in_the_fleet_and_in_ros_2(tmp_path: Path) -> None:
    make_authority(tmp_path)
    listen = (f"tls/127.0.0.1:{free_port()}",)
    keys = [
        "hostlink/drive/1a/desk/2b",
        "hostlink/drive/1a/wall/2b",
        "hostlink/publish/1a/desk/2b/robot_7/led",
        "hostlink/publish/1a/wall/2b/robot_7/led",
        "hostlink/stop/desk/2b",
        "0/robot_7/cmd_vel/geometry_msgs::msg::dds_::Twist_/RIHS01_1",
        "1/robot_7/cmd_vel/geometry_msgs::msg::dds_::Twist_/RIHS01_1",
        "hostlink/state/desk/2b",
    ]
    received: dict[bytes, list[str]] = {b"desk": [], b"wall": []}

    def receive(sample: ZenohSample) -> None:
        received[sample.payload].append(sample.key)

    lab = certified(tmp_path, "lab-1", listen=listen, drivers=("desk",), ros2=True)
    async with (
        session(lab) as here,
        session(certified(tmp_path, "desk", connect=listen)) as desk,
        session(certified(tmp_path, "wall", connect=listen)) as wall,
    ):
        asked, last = list[bytes](), keys[-1]  # what each query carries: its own key
        here.subscribe("**", receive)
        here.serve("**", lambda query: (asked.append(query.payload), query.close()))
        for name, each in ((b"desk", desk), (b"wall", wall)):
            # a message from before the links know of the subscription is lost, so the last is repeated
            while not received[name]:
                each.put(last, name)
                await asyncio.sleep(0.05)
            before = len(received[name])
            for key in keys:
                each.put(key, name)
            await expect(functools.partial(is_in, last, received[name], before))
            for key in (
                "0/robot_7/unlock/std_srvs::srv::dds_::Trigger_/RIHS01_1",
                f"hostlink/topics/{name.decode()}/2b",
            ):
                await each.get(key, key.encode(), timeout_s=1.0)
    assert set(received[b"desk"]) == {keys[0], keys[2], keys[4], keys[5], keys[7]}
    assert set(received[b"wall"]) == {keys[4], keys[7]}
    assert sorted(asked) == [
        b"0/robot_7/unlock/std_srvs::srv::dds_::Trigger_/RIHS01_1",
        b"hostlink/topics/desk/2b",
        b"hostlink/topics/wall/2b",
    ]
