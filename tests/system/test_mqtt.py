"""hostlink at a real mosquitto: states, stops, locks, velocities, and a broker or a sender that vanishes."""

import asyncio
import contextlib
import json
import signal
import ssl
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import aiohttp
import aiomqtt
import pytest

from tests.support.mosquitto import Program, broker, program
from tests.support.process import Process, free_port, run, serve, simulated
from tests.support.waiting import expect

ROBOT = "hostlink/robots/robot_0"


def config(folder: Path, port: int, *lines: str, rest: str = "") -> str:
    """Write hostlink.toml; returns its path."""
    file = folder / "hostlink.toml"
    file.write_text("\n".join([rest, "[mqtt]", f"port = {port}", "interval_s = 0.2", *lines, ""]))
    return str(file)


@contextlib.asynccontextmanager
async def world(
    folder: Path, *lines: str, rest: str = "", has_robot: bool = True
) -> AsyncIterator[tuple[Process, Program]]:
    """A broker, a daemon that is connected to it, a robot and a program that sees the robot's state."""
    port = free_port()
    async with (
        broker(folder, port),
        serve("--config", config(folder, port, *lines, rest=rest)) as daemon,
        contextlib.AsyncExitStack() as stack,
    ):
        if has_robot:
            await stack.enter_async_context(simulated(daemon.tcp))
        mqtt = await stack.enter_async_context(program(port))
        await daemon.logged("mqtt.connected")
        if has_robot:
            await expect(lambda: mqtt.state()["connected"])
        yield daemon, mqtt


async def velocity(daemon: Process) -> float:
    """The velocity that the robot is sent."""
    return float((await daemon.get("/api/robots/robot_0"))["velocity"]["linear_m_s"])


async def until(daemon: Process, wanted: float) -> None:
    """Wait for a velocity of the robot."""
    async with asyncio.timeout(90):
        while await velocity(daemon) != wanted:  # noqa: ASYNC110 - of another process
            await asyncio.sleep(0.02)


@contextlib.asynccontextmanager
async def driving_by_rest(daemon: Process, linear: float) -> AsyncIterator[list[int]]:
    """Another program that drives ten times a second and does not let go; the list has the statuses of its requests."""
    statuses: list[int] = []
    epoch = (await daemon.get("/api/robots/robot_0"))["epoch"]  # after a stop it is refused, also after a pause

    async def drive() -> None:
        async with aiohttp.ClientSession() as session:
            url = f"{daemon.url}/api/robots/robot_0/velocity"
            while True:
                async with session.put(url, json={"linear": linear, "epoch": epoch}) as answer:
                    statuses.append(answer.status)
                await asyncio.sleep(0.1)

    async with asyncio.TaskGroup() as tasks:
        driver = tasks.create_task(drive())
        try:
            await until(daemon, linear)
            yield statuses
        finally:
            driver.cancel()


@contextlib.asynccontextmanager
async def driving_by_mqtt(daemon: Process, mqtt: Program, linear: float) -> AsyncIterator[None]:
    """A program that drives by MQTT, for the length of the block."""

    async def drive() -> None:
        with contextlib.suppress(aiomqtt.MqttError):  # the broker has died
            while True:
                await mqtt.drive(linear)
                await asyncio.sleep(0.05)

    async with asyncio.TaskGroup() as tasks:
        driver = tasks.create_task(drive())
        try:
            await until(daemon, linear)
            yield
        finally:
            driver.cancel()


async def counted(daemon: Process, what: str) -> float:
    """A counter of the component."""
    async with aiohttp.ClientSession() as session, session.get(f"{daemon.url}/metrics") as answer:
        wanted = f'hostlink_graph_events_total{{graph="mqtt",what="{what}"}} '
        lines = (await answer.text()).splitlines()
        return sum(float(line.removeprefix(wanted)) for line in lines if line.startswith(wanted))


async def test_state_availability_and_discovery_arrive_and_follow_the_robot(tmp_path: Path) -> None:
    async with world(tmp_path, has_robot=False) as (daemon, mqtt):
        await expect(lambda: mqtt.newest["hostlink/status"] == "online")
        async with simulated(daemon.tcp):
            await expect(lambda: mqtt.newest[f"{ROBOT}/availability"] == "online")
            await expect(lambda: mqtt.state()["pose"] is not None)
            assert (mqtt.state()["locked"], mqtt.state()["holder"]) == (False, None)
            device = json.loads(mqtt.newest["homeassistant/device/hostlink_robot_0/config"])
            assert device["components"]["stop"]["command_topic"] == f"{ROBOT}/stop"
            async with driving_by_rest(daemon, 0.2):
                await expect(lambda: mqtt.state()["velocity"]["linear_m_s"] == 0.2)
                await expect(lambda: mqtt.state()["measured"]["linear_m_s"] > 0.1)
                assert mqtt.state()["holder"]
        await expect(lambda: mqtt.newest[f"{ROBOT}/availability"] == "offline")
        assert not mqtt.state()["connected"]


async def test_stop_by_mqtt_stops_a_robot_that_another_program_drives(tmp_path: Path) -> None:
    async with world(tmp_path) as (daemon, mqtt):
        for topic in (f"{ROBOT}/stop", "hostlink/stop"):
            async with driving_by_rest(daemon, 0.2) as statuses:
                answer = await mqtt.ask(topic)
                assert (answer["ok"], answer["robots"].keys()) == (True, {"robot_0"})
                assert await velocity(daemon) == 0
                await expect(lambda: statuses[-1] != 200)
            await expect(lambda: mqtt.state()["holder"] is None)


async def test_lock_and_unlock_by_mqtt(tmp_path: Path) -> None:
    async with world(tmp_path) as (daemon, mqtt):
        async with driving_by_rest(daemon, 0.2) as statuses:
            assert (await mqtt.ask(f"{ROBOT}/lock", "a visitor"))["ok"]
            assert await velocity(daemon) == 0
            await expect(lambda: mqtt.state()["lock_reason"] == "a visitor")
            await expect(lambda: statuses[-1] != 200)
        assert (await mqtt.ask(f"{ROBOT}/unlock"))["ok"]
        await expect(lambda: not mqtt.state()["locked"])
        assert (await mqtt.ask("hostlink/lock"))["ok"]
        await expect(lambda: mqtt.state()["lock_reason"] == "locked by MQTT")
        assert (await mqtt.ask(f"{ROBOT}/set_lock", "UNLOCK"))["ok"]
        await expect(lambda: not mqtt.state()["locked"])
        assert (await mqtt.ask("hostlink/robots/nope/stop"))["kind"] == "UnknownTopic"


async def test_drive_is_refused_by_default(tmp_path: Path) -> None:
    async with world(tmp_path) as (daemon, mqtt):
        await mqtt.drive(0.2)
        await expect(lambda: mqtt.answers)
        assert mqtt.answers[0]["reason"] == "driving by MQTT is off: set drive = true in [mqtt]"
        assert await velocity(daemon) == 0


async def test_drive_moves_the_robot_until_its_sender_ends(tmp_path: Path) -> None:
    async with world(tmp_path, "drive = true") as (daemon, mqtt):
        async with driving_by_mqtt(daemon, mqtt, 0.2):
            await expect(lambda: "MQTT" in str(mqtt.state()["holder"]))
        await until(daemon, 0)
        await expect(lambda: mqtt.state()["holder"] is None)
        mqtt.answers.clear()
        await mqtt.send(f"{ROBOT}/drive", '{"linear": 0.2}')
        await mqtt.drive(0.2, sent_s=time.time() - 5)
        await expect(lambda: len(mqtt.answers) == 2)
        assert ["sent_s" in answer["reason"] for answer in mqtt.answers] == [True, True]
        assert await velocity(daemon) == 0


async def test_retained_drive_and_unlock_are_ignored_and_retained_lock_acts(tmp_path: Path) -> None:
    port = free_port()
    async with serve("--config", config(tmp_path, port, "drive = true")) as daemon, simulated(daemon.tcp):
        await daemon.logged("robot.appeared")
        async with broker(tmp_path, port), program(port) as mqtt:
            await mqtt.send(f"{ROBOT}/unlock", "x", retain=True)
            await mqtt.send(f"{ROBOT}/lock", "kept", retain=True)
            await mqtt.send(f"{ROBOT}/drive", json.dumps({"linear": 0.2, "sent_s": time.time()}), retain=True)
            await daemon.logged("mqtt.retained_found", count=3)
            await expect(lambda: mqtt.state()["lock_reason"] == "kept")
            await expect(lambda: len([each for each in mqtt.answers if "retained" in str(each.get("reason"))]) == 2)
            assert (await counted(daemon, "retained_refused"), await counted(daemon, "drives")) == (2, 0)
            status, out, _ = await run("doctor", "--url", daemon.url)
            assert (status, "component_troubled" in out, "mosquitto_pub -r -n -t hostlink/" in out) == (1, True, True)
            for verb in ("drive", "lock", "unlock"):
                await mqtt.send(f"{ROBOT}/{verb}", retain=True)  # removes it
            assert (await mqtt.ask(f"{ROBOT}/unlock"))["ok"]
            await expect(lambda: not mqtt.state()["locked"])
            _, out, _ = await run("doctor", "--url", daemon.url)
            assert "component_troubled" not in out


async def test_broker_that_dies_stops_what_mqtt_drives_and_is_found_again(tmp_path: Path) -> None:
    port = free_port()
    async with serve("--config", config(tmp_path, port, "drive = true")) as daemon, simulated(daemon.tcp):
        async with broker(tmp_path, port) as child, program(port) as mqtt:
            await daemon.logged("mqtt.connected")
            await expect(lambda: mqtt.state()["connected"])
            async with driving_by_mqtt(daemon, mqtt, 0.2):
                child.kill()
                await until(daemon, 0)
            await daemon.logged("component.ended")
            status, out, _ = await run("doctor", "--url", daemon.url)
            assert (status, "component_failed" in out, f"mqtt://127.0.0.1:{port}" in out) == (1, True, True)
        async with broker(tmp_path, port), program(port) as mqtt:
            await daemon.logged("mqtt.connected", count=2)
            assert (await mqtt.ask(f"{ROBOT}/stop"))["ok"]
            await expect(lambda: mqtt.newest[f"{ROBOT}/availability"] == "online")
            status, out, err = await run("doctor", "--url", daemon.url)
            assert status == 0, out + err


async def test_topics_of_forgotten_robots_are_removed(tmp_path: Path) -> None:
    port = free_port()
    async with broker(tmp_path, port), program(port) as mqtt:
        await mqtt.send("hostlink/robots/old/availability", "online", retain=True)
        await mqtt.send("hostlink/robots/old/state", "{}", retain=True)
        await mqtt.send("homeassistant/device/hostlink_old/config", "{}", retain=True)
        rest = "[link]\nforget_robot_after_s = 1.0\n"
        async with serve("--config", config(tmp_path, port, "forget_after_s = 1.0", rest=rest)) as daemon:
            async with simulated(daemon.tcp):
                await expect(lambda: mqtt.state()["connected"])
            await expect(lambda: not [topic for topic in mqtt.newest if "robot" in topic or "homeassistant" in topic])
            assert mqtt.newest["hostlink/status"] == "online"


async def test_status_is_offline_after_the_end_of_the_daemon(tmp_path: Path) -> None:
    port = free_port()
    async with broker(tmp_path, port), program(port) as mqtt:
        for number in (signal.SIGTERM, signal.SIGKILL):  # the second one by the last will
            async with serve("--config", config(tmp_path, port)) as daemon:
                await expect(lambda: mqtt.newest["hostlink/status"] == "online")
                await daemon.end(number)
            await expect(lambda: mqtt.newest["hostlink/status"] == "offline")


async def test_daemons_with_one_prefix_report_it_and_keep_their_robots(tmp_path: Path) -> None:
    port = free_port()
    async with (
        broker(tmp_path, port),
        program(port) as mqtt,
        serve("--config", config(tmp_path, port)) as daemon,
        simulated(daemon.tcp),
    ):
        await expect(lambda: mqtt.state()["connected"])
        async with serve("--config", config(tmp_path, port, "forget_after_s = 1.0")):
            found = await daemon.logged("daemon.diagnosed")
            assert "give each daemon a prefix of its own" in found["detail"]
        await expect(lambda: mqtt.statuses[-2:] == ["offline", "online"])  # the first is the last will of the other
        await expect(lambda: mqtt.newest[f"{ROBOT}/availability"] == "online")


async def test_wrong_password_says_what_to_check_and_the_right_one_works(tmp_path: Path) -> None:
    port, passwords, secret = free_port(), tmp_path / "passwords", tmp_path / "secret"
    made = await asyncio.create_subprocess_exec("mosquitto_passwd", "-c", "-b", str(passwords), "robots", "right")
    assert await made.wait() == 0
    secret.write_text("wrong\n")
    file = config(tmp_path, port, 'username = "robots"', 'password_file = "secret"')
    async with (
        broker(tmp_path, port, "allow_anonymous false", f"password_file {passwords}"),
        serve("--config", file) as daemon,
    ):
        ended = await daemon.read_log("component.ended")
        assert "the broker refuses the login" in ended["reason"]
        assert "check username and password_file" in ended["reason"]
        assert not [line for line in daemon.log if "wrong" in str(line)]
        secret.write_text("right\n")
        await daemon.logged("mqtt.connected")
        secret.unlink()


async def test_tls_connects_with_the_right_authority_only(tmp_path: Path) -> None:
    for name in ("right", "other"):
        made = await asyncio.create_subprocess_exec(
            "openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
            "-days", "1", "-subj", "/CN=127.0.0.1", "-addext", "subjectAltName=IP:127.0.0.1",
            "-keyout", f"{tmp_path}/{name}.key", "-out", f"{tmp_path}/{name}.pem", stderr=asyncio.subprocess.DEVNULL,
        )  # fmt: skip
        assert await made.wait() == 0
    port = free_port()
    lines = ("allow_anonymous true", f"certfile {tmp_path}/right.pem", f"keyfile {tmp_path}/right.key")
    async with broker(tmp_path, port, *lines):
        async with serve("--config", config(tmp_path, port, "tls = true", 'ca = "other.pem"')) as daemon:
            assert "certificate" in (await daemon.read_log("component.ended"))["reason"]
        async with serve("--config", config(tmp_path, port, "tls = true", 'ca = "right.pem"')) as daemon:
            await daemon.logged("mqtt.connected")
            context = ssl.create_default_context(cafile=tmp_path / "right.pem")
            async with program(port, tls_context=context) as mqtt:
                assert (await mqtt.ask("hostlink/stop"))["ok"]


async def test_stop_is_not_delayed_by_a_flood_of_drives(tmp_path: Path) -> None:
    async with world(tmp_path, "drive = true") as (daemon, mqtt):
        async with driving_by_rest(daemon, 0.2):
            await mqtt.flood(f"{ROBOT}/drive", "x", 2_000)
            assert (await mqtt.ask(f"{ROBOT}/stop"))["ok"]
            assert await velocity(daemon) == 0
        assert await counted(daemon, "malformed") > 0
        assert await counted(daemon, "answers_dropped") + await counted(daemon, "answers") > 0


@pytest.mark.parametrize(
    ("lines", "status", "text"),
    [
        ([], 0, "under hostlink, takes stop, lock, unlock, discovery under homeassistant"),
        (
            ["drive = true"],
            0,
            "drive = true without username: every program that reaches the broker may drive the robots",
        ),
        (['prefix = "a/+"'], 2, "mqtt.prefix: 'a/+' is not the beginning of a topic"),
        (['pasword_file = "x"'], 2, "unknown key mqtt.pasword_file; did you mean password_file?"),
    ],
)
async def test_check_config_tells_about_the_component(tmp_path: Path, lines: list[str], status: int, text: str) -> None:
    got: tuple[Any, ...] = await run("serve", "--check-config", config(tmp_path, 1883, *lines))
    assert (got[0], text in got[1] + got[2]) == (status, True), got
