"""A protocol of an installed package: its robot has all that a robot has, and hostlink names it nowhere."""

import asyncio
import contextlib
import os
import signal
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.support.process import HOSTLINK, Process, free_port, run, serve
from tests.support.waiting import expect

ROOT = Path(__file__).parents[2]
ENTRY_POINTS = (
    "[hostlink.protocols]\ntext = tests.support.text_protocol:TEXT\nbroken = tests.support.no_such_module:X\n"
)


@pytest.fixture
def installed(tmp_path: Path) -> dict[str, str]:
    """An environment in which a package with this protocol is installed."""
    package = tmp_path / "text_protocol-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: text-protocol\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text(ENTRY_POINTS)
    return {"PYTHONPATH": os.pathsep.join((str(tmp_path), str(ROOT)))}


class Car:
    """A device that speaks it: says who it is when asked, and its pose ten times a second."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.heard: list[str] = []
        self._reader, self._writer = reader, writer

    async def run(self) -> None:
        async with asyncio.TaskGroup() as tasks:
            reporting = tasks.create_task(self._report())
            with contextlib.suppress(OSError):
                async for data in self._reader:
                    self.heard.append(line := data.decode().strip("\n\0"))
                    if line == "HELLO?":
                        self._writer.write(b"HELLO car\n")
            reporting.cancel()

    async def _report(self) -> None:
        while True:
            self._writer.write(b"POSE 0.5 0 1.57\n")
            await asyncio.sleep(0.1)

    @property
    def velocities(self) -> list[str]:
        return [line for line in self.heard if line.startswith("VEL")]


@contextlib.asynccontextmanager
async def car(daemon: Process) -> AsyncIterator[Car]:
    reader, writer = await asyncio.open_connection(*daemon.tcp)
    made = Car(reader, writer)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(made.run())
        try:
            await expect(lambda: "VEL 0 0" in made.heard)  # the first velocity of a connection
            yield made
        finally:
            writer.close()
            running.cancel()


@contextlib.asynccontextmanager
async def served(tmp_path: Path, installed: dict[str, str]) -> AsyncIterator[Process]:
    file = tmp_path / "hostlink.toml"
    file.write_text('[tcp]\nprotocol = "text"\n')
    async with serve("--config", str(file), environment=installed, program=(HOSTLINK,)) as daemon:
        yield daemon


async def test_robot_of_another_protocol_has_lease_stop_lock_doctor_and_capture(
    tmp_path: Path, installed: dict[str, str]
) -> None:
    async with served(tmp_path, installed) as daemon, car(daemon) as robot:
        (view,) = (await daemon.get("/api/robots"))["robots"]
        assert (view["name"], view["connected"]) == ("car", True)
        await daemon.put("/api/robots/car/velocity", {"linear": 0.25})
        await expect(lambda: "VEL 0.25 0" in robot.velocities)
        await expect(lambda: robot.velocities[-1] == "VEL 0 0")  # the lease ends
        await daemon.put("/api/robots/car/velocity", {"linear": 0.5})
        await expect(lambda: "VEL 0.5 0" in robot.velocities)
        answer = await daemon.post("/api/robots/car/stop")
        assert answer["connected"]
        assert robot.velocities[-1] == "VEL 0 0"
        await daemon.post("/api/robots/car/lock")
        assert (await daemon.get("/api/robots/car"))["lock_reason"]
        odometry = (await daemon.get("/api/robots/car"))["odometry"]
        assert odometry["pose"] == {"x_m": 0.5, "y_m": 0.0, "theta_rad": 1.57}
        status, out, err = await run("doctor", "--url", daemon.url)
        assert status == 0, out + err
        (link,) = (await daemon.get("/api/links"))["links"]
        capture = await daemon.get(f"/api/links/{link['number']}/capture/0-0")
        assert any(b"HELLO car\n".hex() in read["hex"] for read in capture["reads"])


async def test_guardian_stops_a_robot_of_another_protocol(tmp_path: Path, installed: dict[str, str]) -> None:
    async with served(tmp_path, installed) as daemon, car(daemon) as robot:
        await daemon.put("/api/robots/car/velocity", {"linear": 0.25})
        await expect(lambda: robot.velocities[-1] == "VEL 0.25 0")
        await daemon.end(signal.SIGKILL)
        await expect(lambda: robot.velocities[-1] == "VEL 0 0")
        await expect(lambda: "BYE" in robot.heard)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("morse", "no installed package has this protocol; known: broken, micro-ros, rosserial, text"),
        ("broken", "no_such_module"),
    ],
)
@pytest.mark.parametrize("is_serial", [False, True])
async def test_protocol_that_cannot_be_used_is_refused_at_the_start(
    tmp_path: Path, installed: dict[str, str], name: str, reason: str, *, is_serial: bool
) -> None:
    file = tmp_path / "hostlink.toml"
    table = '[[serial]]\npath = "/dev/hostlink-none"\n' if is_serial else "[tcp]\n"
    file.write_text(f'{table}protocol = "{name}"\n')
    for words in (("--check-config", str(file)), ("--config", str(file), "--listen", f"127.0.0.1:{free_port()}")):
        child = await asyncio.create_subprocess_exec(
            HOSTLINK, "serve", *words, stderr=asyncio.subprocess.PIPE, env={**os.environ, **installed}
        )
        _, err = await child.communicate()
        assert (child.returncode, reason in err.decode()) == (2, True), err.decode()
