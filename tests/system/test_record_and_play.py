"""`hostlink record`, `play` and `incidents`, as a person and as a program use them."""

import asyncio
import json
import os
import random
import signal
import sys
from asyncio.subprocess import PIPE
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

import hostlink.recording
from hostlink.client import Host, connect
from hostlink.components.recorder.reader import McapReader, StoredMessage
from tests.support.background import meanwhile
from tests.support.driving import hold
from tests.support.process import HOSTLINK, TIMEOUT_S, Process, run, serve, simulated
from tests.support.stopwatch import Stopwatch

KILLS = int(os.environ.get("HOSTLINK_RECORDING_KILLS", "3"))
WAKE_INTERVAL_S = 0.01
SPEED_M_S = 0.1
SILENCE = "nothing was heard from it"
SOAK = str(Path(__file__).parents[2] / "tools" / "soak_recording.py")


def settings(folder: Path) -> tuple[str, ...]:
    """A daemon that keeps its recordings there."""
    file = folder / "hostlink.toml"
    recording = f'[recording]\nfolder = "{folder / "recordings"}"\nmin_free_disk_mb = 0\n'
    file.write_text(f"{recording}[black_box]\nafter_s = 0.5\n")
    return ("--config", str(file))


async def record(daemon: Process, output: Path, *arguments: str, seconds: float = 2.0) -> None:
    words = ("record", "-o", str(output), "--seconds", str(seconds), *arguments)
    status, _, err = await run(*words, "--url", daemon.url)
    assert status == 0, err


def of_device(path: Path) -> list[StoredMessage]:
    return [message for message in McapReader(path).messages() if message.channel.origin == "device"]


def shown(messages: Iterable[StoredMessage]) -> list[tuple[str, bytes]]:
    return [(message.channel.topic, message.payload) for message in messages]


def find(part: list[tuple[str, bytes]], whole: list[tuple[str, bytes]]) -> int:
    """Return where the part begins in the whole."""
    return next(at for at in range(len(whole)) if whole[at : at + len(part)] == part)


async def note_lateness(late_s: list[float]) -> None:
    """Measure until cancelled how late this machine wakes a process."""
    now_s = asyncio.get_running_loop().time
    while True:
        due_s = now_s() + WAKE_INTERVAL_S
        await asyncio.sleep(WAKE_INTERVAL_S)
        late_s.append(now_s() - due_s)


async def test_played_messages_are_recorded_again_byte_for_byte_at_their_times(tmp_path: Path) -> None:
    first = tmp_path / "first.mcap"
    async with serve(*settings(tmp_path)) as daemon, simulated(daemon.tcp):
        await daemon.read_log("robot.appeared")
        async with connect(daemon.url) as host:
            await hold(host.robot("robot_0"), SPEED_M_S, 0.3)
            await record(daemon, first, "/robot_0/*")
    (tmp_path / "again").mkdir()
    async with serve(*settings(tmp_path / "again")) as daemon:
        async with connect(daemon.url) as host:
            recording = await host.post("/api/recordings", {"name": "second"})
            timers_late_s: list[float] = []
            async with meanwhile(note_lateness(timers_late_s)):
                status, _, err = await run("play", str(first), "--connect", "{}:{}".format(*daemon.tcp))
            assert status == 0, err
            await host.post("/api/recordings/second/stop")
        second = Path((await daemon.get("/api/recordings"))["folder"] + "/" + recording["files"][0])
    before, after = of_device(first), of_device(second)
    after = [message for message in after if message.channel.topic != "/robot_0/played"]
    begin = find(shown(before)[:5], shown(after))
    after = after[begin : begin + len(before)]
    assert shown(after) == shown(before)
    shift_s = np.array([(new.stamp_ns - old.stamp_ns) / 1e9 for old, new in zip(before, after, strict=True)])
    late_s = np.abs(shift_s - np.median(shift_s))
    timers_s = np.array(timers_late_s)  # each counts for the milliseconds until it woke
    of_machine_s = np.percentile(np.repeat(timers_s, (1000 * (WAKE_INTERVAL_S + timers_s)).astype(int)), 75)
    # The player, the daemon and the recorder wait for a core each.
    assert np.percentile(late_s, 75) < 0.010 + 3 * of_machine_s, late_s
    assert len({message.channel.topic for message in before}) >= 4
    moved = hostlink.recording.read(second)["/robot_0/odometry"]
    assert moved["x"].max() > SPEED_M_S


async def test_ctrl_c_at_the_question_of_a_stepped_play_ends_it(tmp_path: Path) -> None:
    first = tmp_path / "first.mcap"
    async with serve(*settings(tmp_path)) as daemon:
        async with simulated(daemon.tcp):
            await daemon.read_log("robot.appeared")
            await record(daemon, first, seconds=0.5)
        words = ("play", str(first), "--step", "--connect", "{}:{}".format(*daemon.tcp))
        child = await asyncio.create_subprocess_exec(HOSTLINK, *words, stdin=PIPE, stderr=PIPE)
        assert child.stdin is not None
        assert child.stderr is not None
        async with asyncio.timeout(TIMEOUT_S):
            await child.stderr.readuntil(b"Enter sends it")
            child.stdin.write(b"\n")
            await child.stderr.readuntil(b"Enter sends it")
            child.send_signal(signal.SIGINT)
            await child.stderr.read()
            assert await child.wait() == 130
        child.stdin.close()


async def velocities(host: Host) -> int:
    """Return how many velocities the robot's gate has received; the gate stays while its device is away."""
    names = ("/robot_0/velocity_commands", "/robot_0/cmd_vel")
    return sum(topic["messages"] for topic in await host.topics() if topic["name"] in names)


async def test_a_recording_is_published_by_a_program_and_its_velocities_are_not(tmp_path: Path) -> None:
    first = tmp_path / "first.mcap"
    async with serve(*settings(tmp_path)) as daemon:
        async with simulated(daemon.tcp), connect(daemon.url) as host:
            await daemon.read_log("robot.appeared")
            await hold(host.robot("robot_0"), SPEED_M_S, 0.0)
            await record(daemon, first)
        async with connect(daemon.url) as host, host.subscribe("/robot_0/odometry") as poses:
            before = await velocities(host)
            words = ("play", str(first), "/robot_0/*", "--as-program", "--rate", "10", "--url", daemon.url)
            status, _, err = await run(*words)
            assert (status, "messages of /robot_0/* played" in err) == (0, True), err
            assert (await anext(aiter(poses)))["x"] >= 0.0
            assert await velocities(host) == before


async def test_a_robot_is_driven_by_a_recording_only_when_it_is_named(tmp_path: Path) -> None:
    first = tmp_path / "first.mcap"
    async with serve(*settings(tmp_path)) as daemon, simulated(daemon.tcp):
        await daemon.read_log("robot.appeared")
        async with connect(daemon.url) as host:
            await hold(host.robot("robot_0"), SPEED_M_S, 0.0)
            await record(daemon, first, seconds=1.5)
            await host.robot("robot_0").stop()
            before = (await host.robots())[0]["odometry"]
            assert before is not None
            status, err = 1, SILENCE
            while status and SILENCE in err:  # on a busy machine, the play stops the robot and ends
                status, _, err = await run("play", str(first), "--drive", "robot_0", "--url", daemon.url)
            assert (status, "driving robot_0 as robot_0 was driven" in err) == (0, True), err
            after = (await host.robots())[0]
            assert after["odometry"] is not None
            assert after["odometry"]["pose"]["x_m"] > before["pose"]["x_m"] + SPEED_M_S
            assert after["holder"] is None


@pytest.mark.quiet
@pytest.mark.timeout(60 + 20 * KILLS)
async def test_a_daemon_that_is_killed_leaves_all_but_the_last_second(tmp_path: Path) -> None:
    random_ = random.Random(KILLS)
    for number in range(KILLS):
        folder = tmp_path / str(number)
        folder.mkdir()
        async with serve(*settings(folder)) as daemon, simulated(daemon.tcp) as robot:
            await daemon.read_log("robot.appeared")
            watch = Stopwatch(daemon.pid, robot.pid)
            async with connect(daemon.url, reconnect=False) as host:
                await host.post("/api/recordings", {"name": "run"})
            async with connect(daemon.url) as host, host.subscribe("/robot_0/odometry") as poses:
                async for _ in poses:  # the recording has what its neighbour has
                    break
            await asyncio.sleep(random_.uniform(1.2, 2.5))
            now_ns = await _now_ns(daemon)
            allowed_s = 1.0 + watch.kept_s
            daemon.child.kill()
        path = folder / "recordings" / "run.mcap"
        last_ns = max(message.stamp_ns for message in McapReader(path).messages())
        assert now_ns - last_ns < allowed_s * 1e9, number
        status, out, _ = await run("record", "--repair", str(path))
        assert (status, "the file is repaired" in out) == (0, True)


async def _now_ns(daemon: Process) -> int:
    async with connect(daemon.url) as host:
        answer = await host.call("/rosapi/get_time", {})
    return int(answer["time"]["secs"]) * 1_000_000_000 + int(answer["time"]["nsecs"])


async def test_incidents_are_listed_and_fetched(tmp_path: Path) -> None:
    async with serve(*settings(tmp_path)) as daemon, simulated(daemon.tcp):
        assert (await run("incidents", "--url", daemon.url))[1] == "there are no incidents\n"
        await daemon.read_log("robot.appeared")
        status, out, err = await run("incidents", "--save", "robot_0", "--reason", "it squeaks", "--url", daemon.url)
        assert (status, out) == (0, ""), err
        await daemon.read_log("incident.saved")
        (incident,) = json.loads((await run("incidents", "--json", "--url", daemon.url))[1])["incidents"]
        assert "it squeaks" in (await run("incidents", "--url", daemon.url))[1]
        file = tmp_path / "incident.mcap"
        assert (await run("incidents", "none.mcap", "-o", str(file), "--url", daemon.url))[0] == 1
        assert not file.exists()
        status, out, err = await run("incidents", incident["file"], "-o", str(file), "--url", daemon.url)
        assert (status, out) == (0, f"{file}\n"), err
    assert "/robot_0/odometry" in hostlink.recording.read(file)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("play", "none.mcap"), "No such file"),
        (("play", "/etc/passwd"), "is not an MCAP file"),
        (("record", "--repair", "/etc/passwd"), "is not an MCAP file"),
        (("record", "--repair", "."), "Is a directory; name a file"),
        (("export", "/usr", "--to", "csv", "-o", "none.csv"), "/usr is a folder without metadata.yaml"),
        (("record", "-o", "/no/such/folder/run.mcap"), "No such file"),
        (("play", "none.mcap", "/chat"), "--as-program"),
        (("play", "none.mcap", "--as-program"), "name the topics"),
        (("record", "run.mcap", "--seconds", "1"), "hostlink record -o run.mcap"),
    ],
)
async def test_play_with_impossible_words_fails_with_one_line(words: tuple[str, ...], complaint: str) -> None:
    status, _, err = await run(*words)
    assert status in (1, 2)
    assert complaint in err
    assert err.count("\n") == 1, err


async def test_a_play_without_a_host_says_so(tmp_path: Path) -> None:
    first = tmp_path / "first.mcap"
    async with serve(*settings(tmp_path)) as daemon, simulated(daemon.tcp):
        await daemon.read_log("robot.appeared")
        await record(daemon, first, seconds=1.0)
    status, _, err = await run("play", str(first), "--connect", "127.0.0.1:9")
    assert (status, "start one with `hostlink serve`" in err) == (1, True), err


@pytest.mark.long
async def test_thirty_robots_are_recorded_with_flat_memory(tmp_path: Path) -> None:
    """Two minutes of them as fast as the disk takes it; `make soak` does an hour."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, SOAK, "--minutes", "2", stdout=asyncio.subprocess.PIPE, cwd=tmp_path
    )
    async with asyncio.timeout(3 * TIMEOUT_S):
        out, _ = await process.communicate()
    found = json.loads(out)
    assert (process.returncode, found["dropped"]) == (0, 0), found
    assert found["messages"] >= found["sent"] == 30 * 2 * 10 * 120
