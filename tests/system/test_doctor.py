"""`hostlink doctor` and `hostlink capture` as a person runs them: a daemon, none, a serial port, a recording."""

import asyncio
import contextlib
import json
import os
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from hostlink.workbench.sim.robot import FAULTS, HEALTHY, Fault, SimulatedRobot
from hostlink.workbench.sim.run import run_over_streams
from tests.support.background import meanwhile
from tests.support.fork_server import start
from tests.support.process import Process, free_port, run, serve, simulated
from tests.support.pty_pair import pty_streams
from tests.support.waiting import TIMEOUT_S


def codes(report: str) -> list[str]:
    observed: dict[str, Any] = json.loads(report)
    reported = [*observed["findings"], *(each for link in observed["links"] for each in link["diagnosis"])]
    return [each["code"] for each in reported]


@contextlib.asynccontextmanager
async def robot_on_a_port(fault: Fault) -> AsyncIterator[str]:
    """A simulated robot behind a serial port; yields the port's path."""
    async with pty_streams() as (reader, writer, path):
        work = run_over_streams(SimulatedRobot("robot_0", baud=0), reader, writer, fault=fault)
        async with meanwhile(work):
            yield path


async def sends_odometry(daemon: Process, name: str = "robot_0") -> None:
    """Wait until the daemon receives the odometry of a robot at its rate, 10 Hz."""
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            robots = {robot["name"]: robot["odometry"] for robot in (await daemon.get("/api/robots"))["robots"]}
            if (odometry := robots.get(name)) and odometry["rate_hz"] > 5:
                return
            await asyncio.sleep(0.05)


async def test_a_healthy_daemon_is_status_0() -> None:
    async with serve() as daemon, simulated(daemon.tcp):
        await sends_odometry(daemon)
        status, out, err = await run("doctor", "--url", daemon.url)
    assert (status, err) == (0, "")
    assert out.startswith("link 1  127.0.0.1:")
    head, rates, odometry, topics = out.splitlines()
    assert head.endswith("8 topics)  healthy")
    assert "  robot_0  (" in head
    assert " frames/s from it, " in rates
    assert " to it, nothing lost, last heard " in rates
    assert odometry.startswith("  odometry ")
    assert odometry.endswith(" ms old; driven by nobody")
    assert topics.startswith("  topics /robot_0/battery, ")
    assert topics.endswith(" and 2 more")


async def test_two_robots_of_one_address_are_told_apart() -> None:
    async with serve() as daemon, simulated(daemon.tcp, "--first", "1", "--fault", "text"):
        await daemon.read_log("link.diagnosed")
        async with simulated(daemon.tcp):
            for name in ("robot_0", "robot_1"):
                await sends_odometry(daemon, name)
            report = json.loads((await run("doctor", "--json", "--url", daemon.url))[1])
    diagnosed = {link["robot"]: [each["code"] for each in link["diagnosis"]] for link in report["links"]}
    assert diagnosed == {"robot_0": [], "robot_1": ["text_on_line"]}
    assert all(link["odometry"]["rate_hz"] > 5 for link in report["links"])


async def test_a_daemon_without_a_device_has_advice() -> None:
    async with serve() as daemon:
        status, out, _ = await run("doctor", "--url", daemon.url)
    assert status == 1
    where = "listening on TCP {}:{}".format(*daemon.tcp)
    assert out.startswith(
        f"no_device: no device has connected to this computer ({where})\n  next: check the host address"
    )


async def test_doctor_says_which_daemon_owns_the_folder_of_recordings(tmp_path: Path) -> None:
    settings = tmp_path / "hostlink.toml"
    settings.write_text(f'[recording]\nfolder = "{tmp_path / "recordings"}"\n')
    async with serve("--config", str(settings)) as first, serve("--config", str(settings)) as second:
        reports = [(await run("doctor", "--json", "--url", daemon.url))[1] for daemon in (first, second)]
    assert [codes(report) for report in reports] == [["no_device"], ["no_device", "recordings_taken"]]


async def test_doctor_names_a_serial_port_that_the_daemon_cannot_open(tmp_path: Path) -> None:
    async with serve("--serial", str(tmp_path / "none")) as daemon:
        (waiting,), (started,) = daemon.lines("serial.waiting"), daemon.lines("daemon.started")
        assert daemon.log.index(waiting) < daemon.log.index(started)
        assert waiting["next_step"].startswith("plug the board in")
        assert started["missing"] == [str(tmp_path / "none")]
        status, out, _ = await run("doctor", "--json", "--url", daemon.url)
    assert (status, codes(out)) == (1, ["serial_missing"])


async def test_an_address_in_use_names_the_program_that_has_it() -> None:
    async with serve() as daemon:
        status, out, _ = await run("doctor", "--listen", "{}:{}".format(*daemon.tcp))
    assert status == 1
    assert "address_in_use: another program listens on the device port" in out
    assert f"hostlink (pid {daemon.child.pid})" in out


async def test_doctor_listens_by_itself() -> None:
    port = free_port()
    listening = await start("doctor", "--json", "--listen", f"127.0.0.1:{port}", "--seconds", "4", stdout=PIPE)
    async with simulated(("127.0.0.1", port), "--fault", "wrong_md5"):
        out, _ = await listening.communicate()
    assert (listening.returncode, codes(out.decode())) == (1, ["wrong_md5"])


async def test_doctor_without_a_device_reports_no_device() -> None:
    port = free_port()
    status, out, _ = await run("doctor", "--json", "--listen", f"127.0.0.1:{port}", "--seconds", "1")
    assert (status, codes(out)) == (1, ["no_device"])
    assert json.loads(out)["findings"][0]["detail"] == f"listening on 127.0.0.1, port {port}"


async def test_doctor_probes_a_serial_port() -> None:
    async with robot_on_a_port(FAULTS["small_buffer"]) as path:
        status, out, _ = await run("doctor", "--json", "--serial", path)
    assert (status, codes(out)) == (1, ["buffer_too_small"])
    assert json.loads(out)["links"][0]["baud"] == 57600


async def test_a_busy_serial_port_names_the_program_that_has_it() -> None:
    async with robot_on_a_port(HEALTHY) as path, serve("--serial", path) as daemon:
        await daemon.read_log("topics.negotiated")
        status, out, _ = await run("doctor", "--serial", path)
    assert status == 1
    assert out.startswith("serial_busy: another program has the serial port open")
    assert any(f"(pid {number})" in out for number in (daemon.child.pid, os.getpid()))  # a pty's other end is ours


async def test_doctor_with_a_file_that_is_not_a_port_says_so() -> None:
    status, out, _ = await run("doctor", "--json", "--serial", "/dev/null")
    assert (status, codes(out)) == (1, ["serial_unusable"])


async def test_a_capture_is_diagnosed_like_the_link_that_it_is_of(tmp_path: Path) -> None:
    file = tmp_path / "link.jsonl"
    async with serve() as daemon:
        async with simulated(daemon.tcp, "--fault", "text"):
            await daemon.read_log("link.diagnosed")
            status, live, err = await run("capture", "1", "--seconds", "0.6", "--url", daemon.url)
            assert (status, err.startswith("link 1: ")) == (0, True)
        await daemon.read_log("link.closed")
        assert (await run("capture", "--last", "-o", str(file), "--url", daemon.url))[0] == 0
    status, out, _ = await run("doctor", "--json", str(file))
    assert (status, codes(out)) == (1, ["text_on_line"])
    assert file.read_text().startswith(live[: live.rindex("\n", 0, -1) + 1])
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    assert [line["event"] for line in lines if "event" in line] == ["open", "close"]


@pytest.mark.parametrize(
    ("arguments", "status", "complaint"),
    [([], 2, "name a link by its number, or use --last"), (["7"], 1, "no link named 7"), (["--last"], 1, "no device")],
)
async def test_doctor_with_an_empty_capture_says_so(arguments: list[str], status: int, complaint: str) -> None:
    async with serve() as daemon:
        got, _, err = await run("capture", *arguments, "--url", daemon.url)
    assert got == status
    assert complaint in err


async def test_devices_that_are_not_admitted_are_a_finding(tmp_path: Path) -> None:
    config = tmp_path / "hostlink.toml"
    config.write_text('[tcp]\nallow = ["10.1.2.3"]\n')
    async with serve("--config", str(config)) as daemon, simulated(daemon.tcp):
        await daemon.read_log("connection.refused")
        status, out, _ = await run("doctor", "--url", daemon.url)
    assert status == 1
    assert out.startswith("not_let_in: devices reach this computer, but their connections are refused (")


@pytest.mark.parametrize(
    ("file", "status", "complaint"),
    [
        ("none/link.jsonl", 2, "none/link.jsonl cannot be written: No such file or directory; name another file"),
        pytest.param("", 2, "cannot be written: Is a directory", marks=pytest.mark.long),
        ("/dev/full", 1, "/dev/full is not complete: No space left on device"),
    ],
)
async def test_a_capture_into_a_file_that_cannot_be_written(
    tmp_path: Path, file: str, status: int, complaint: str
) -> None:
    async with serve() as daemon, simulated(daemon.tcp):
        await daemon.read_log("robot.appeared")
        got, out, err = await run("capture", "1", "-o", str(tmp_path / file), "--url", daemon.url)
    assert (got, out, len(err.splitlines())) == (status, "", 1)
    assert complaint in err
