"""Commands read recordings that are larger than the memory of a small computer."""

import asyncio
import os
import random
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hostlink.components.recorder.channel import DEVICE, VELOCITY, ros_channel
from hostlink.components.recorder.mcap_writer import McapWriter
from hostlink.core.messages.catalog import Catalog
from hostlink.core.robot.velocity import TWIST_TYPE, PlanarVelocity
from hostlink.core.runtime.units import NS_PER_S
from tests.support.process import serve, simulated

MEGABYTE = 1_000_000
FILE_BYTES = 200 * MEGABYTE
IMAGE_BYTES = 1_000_000
IMAGES = FILE_BYTES // IMAGE_BYTES
POSES_PER_IMAGE = 20
MOST_MB = 150  # of a Raspberry Pi's memory: what a command may use for a recording of any size
BEGIN_NS = 1_700_000_000 * NS_PER_S
CATALOG = Catalog()
POSE, TEXT, TWIST = (CATALOG.message(name) for name in ("geometry_msgs/Pose2D", "std_msgs/String", TWIST_TYPE))
assert POSE is not None
ODOMETRY = ros_channel("/robot_0/odometry", POSE.name, POSE, is_latched=False, robot="robot_0", origin=DEVICE)
VELOCITIES = ros_channel("/robot_0/cmd_vel", TWIST_TYPE, TWIST, is_latched=False, robot="robot_0", origin=VELOCITY)
IMAGE = ros_channel("/robot_0/camera", "std_msgs/String", TEXT, is_latched=False, robot="robot_0", origin=DEVICE)


def write(path: Path) -> None:
    """Write pictures that cannot be compressed, and poses between them: the poses are a thousandth of the file."""
    assert POSE is not None
    noise = random.Random(1).randbytes(IMAGE_BYTES)
    writer = McapWriter(path, metadata={"owner": "test"})
    for number in range(IMAGES):
        for part in range(POSES_PER_IMAGE):
            stamp_ns = BEGIN_NS + (number * POSES_PER_IMAGE + part) * NS_PER_S // 100
            writer.write(ODOMETRY, stamp_ns, POSE.encode({"x": number / 10}))
        writer.write(VELOCITIES, stamp_ns, PlanarVelocity(0.1).encode())
        writer.write(IMAGE, stamp_ns, IMAGE_BYTES.to_bytes(4, "little") + number.to_bytes(8, "little") + noise[8:])
        writer.end_chunk()
    writer.close()


@pytest.fixture(scope="module")
def large(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    path = tmp_path_factory.mktemp("large") / "run.mcap"
    write(path)
    assert path.stat().st_size >= FILE_BYTES
    if request.param == "unfinished":
        os.truncate(path, FILE_BYTES - 17)
    elif request.param == "damaged":
        with path.open("r+b") as file:
            for at in range(FILE_BYTES // 10, FILE_BYTES, FILE_BYTES // 10):
                file.seek(at)
                file.write(b"damage")
    yield path
    path.unlink()


PARENT = """
import os, sys
pid = os.posix_spawn(sys.executable, [sys.executable, "-m", "hostlink", *sys.argv[1:]], os.environ)
_, status, usage = os.wait4(pid, 0)
print(os.waitstatus_to_exitcode(status), usage.ru_maxrss)
"""


def peak_mb(words: list[str]) -> tuple[int, float]:
    """(status, megabytes) of a command, as the one child of a process that measures it."""
    done = subprocess.run([sys.executable, "-c", PARENT, *words], stdout=subprocess.PIPE, text=True, check=True)
    status, kilobytes = done.stdout.splitlines()[-1].split()
    return int(status), int(kilobytes) * 1024 / MEGABYTE


COMMANDS: dict[str, Callable[[Path, Path], list[str]]] = {
    "info": lambda file, _: ["info", str(file)],
    "plot": lambda file, out: ["plot", str(file), "/robot_0/odometry.x", "-o", str(out / "x.png")],
    "map": lambda file, out: ["plot", str(file), "--map", "-o", str(out / "map.png")],
    "csv": lambda file, out: ["export", str(file), "/robot_0/odometry", "--to", "csv", "-o", str(out / "csv")],
    "ros1": lambda file, out: ["export", str(file), "--to", "ros1", "-o", str(out / "run.bag")],
    "ros2": lambda file, out: ["export", str(file), "--to", "ros2", "-o", str(out / "ros2")],
    "rosbag2": lambda file, out: ["export", str(file), "--to", "rosbag2", "-o", str(out / "rosbag2")],
}


#: All commands read by components/recorder/reader.py: one runs without the tests marked long, without an index.
RUNS = [("unfinished", "csv")]
MORE_RUNS = [
    *(("finished", command) for command in COMMANDS),
    ("unfinished", "info"),
    *(("damaged", command) for command in ("info", "csv")),
]


@pytest.mark.parametrize(
    ("large", "command"),
    [*RUNS, *(pytest.param(*each, marks=pytest.mark.long) for each in MORE_RUNS)],
    indirect=["large"],
)
def test_command_reads_a_large_recording_in_bounded_memory(large: Path, tmp_path: Path, command: str) -> None:
    status, peak = peak_mb(COMMANDS[command](large, tmp_path))
    assert status == 0
    assert peak < MOST_MB


PLAYS = {
    "devices": ["--rate", "100"],
    "program": ["--as-program", "/robot_0/odometry"],
}


@pytest.mark.long
@pytest.mark.parametrize(
    ("large", "play"),
    [("finished", "devices"), ("finished", "program"), ("unfinished", "devices"), ("damaged", "devices")],
    indirect=["large"],
)
def test_play_reads_a_large_recording_in_bounded_memory(large: Path, play: str) -> None:
    """Play has read the whole file before it finds that the daemon cannot be reached."""
    words = PLAYS[play]
    status, peak = peak_mb(["play", str(large), "--connect", "127.0.0.1:9", "--url", "ws://127.0.0.1:9", *words])
    assert status == 1
    assert peak < MOST_MB


@pytest.mark.long
@pytest.mark.parametrize("large", ["finished"], indirect=True)
async def test_play_that_drives_reads_a_large_recording_in_bounded_memory(large: Path) -> None:
    async with serve() as daemon, simulated(daemon.tcp):
        await daemon.read_log("robot.appeared")
        words = ["play", str(large), "--drive", "robot_0", "--rate", "100", "--url", daemon.url]
        status, peak = await asyncio.to_thread(peak_mb, words)
    assert status == 0
    assert peak < MOST_MB


def test_reader_of_a_rare_topic_reads_a_small_part_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    assert POSE is not None
    writer = McapWriter(path, metadata={})
    noise = random.Random(1).randbytes(100_000)
    for number in range(400):
        channel, payload = (ODOMETRY, POSE.encode({})) if number % 100 == 50 else (IMAGE, noise)
        writer.write(channel, BEGIN_NS + number, payload)
        writer.end_chunk()
    writer.close()
    program = (
        "import sys; from pathlib import Path; from hostlink.components.recorder.reader import McapReader; "
        "found = list(McapReader(Path(sys.argv[1])).messages(lambda channel: channel.topic == sys.argv[2])); "
        "print(len(found), next(line for line in open('/proc/self/io') if line.startswith('rchar')).split()[1])"
    )

    def bytes_read(topic: str) -> tuple[int, int]:
        done = subprocess.run(
            [sys.executable, "-c", program, str(path), topic], capture_output=True, text=True, check=True
        )
        count, read = done.stdout.split()
        return int(count), int(read)

    (none, imports_bytes), (few, few_bytes), (many, many_bytes) = map(
        bytes_read, ("/x", "/robot_0/odometry", "/robot_0/camera")
    )
    assert (none, few, many) == (0, 4, 396)
    assert few_bytes - imports_bytes < (many_bytes - imports_bytes) / 20
