"""Names of robots over restarts of the daemon: the file, its damage, a second daemon, a disk that refuses."""

import asyncio
import threading
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from hostlink.core.config import Config, SerialConfig, TcpConfig, UdpConfig
from hostlink.core.hub import kept as module
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.kept import MAX_FILE_BYTES, KeptFile, folder_of
from hostlink.core.hub.kept_names import NAMES, Names, kept_names
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.names import Remembered
from hostlink.core.runtime.folders import FolderTaken
from tests.support.fake_device import CATALOG, topic
from tests.support.memory_hub import MemoryHub, RecordingGuard, running
from tests.support.waiting import TIMEOUT_S, expect

V = Remembered("robot_0", "10.0.0.7", True)
UNNAMED = [topic(EndpointKind.SUBSCRIBER, 100, "cmd_vel", "geometry_msgs/Twist")]


@pytest.fixture(autouse=True)
def _waits_for_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "DISK_TIMEOUT_S", TIMEOUT_S)
    monkeypatch.setattr(module, "LAST_TIMEOUT_S", TIMEOUT_S)


def in_kept_hub(folder: Path, test: Callable[[MemoryHub], Coroutine[Any, Any, None]]) -> list[dict[str, Any]]:
    """Run a test with a hub that keeps its names in a folder, in real time: its thread writes a file."""

    async def run(logs: list[Any]) -> None:
        hub = Hub(Config(), CATALOG, reraises=True, guard=RecordingGuard())
        async with running(hub), kept_names(hub.links, KeptFile(folder, NAMES, Names)):
            await test(MemoryHub(hub, RecordingGuard(), logs))

    with capture_logs() as logs:
        asyncio.run(run(logs))
    return [dict(each) for each in logs if str(each["event"]).startswith("names.")]


def read(folder: Path) -> dict[str, Remembered]:
    """Read the file when the hub's thread, which may still write, has left it."""
    deadline_s = time.monotonic() + TIMEOUT_S
    while True:
        file = KeptFile(folder, NAMES, Names)
        try:
            return file.read()
        except FolderTaken:
            if time.monotonic() > deadline_s:
                raise
            time.sleep(0.01)
        finally:
            file.release()


async def named(made: MemoryHub, address: str) -> str:
    device = await made.connect(UNNAMED, address=address)
    await expect(lambda: made.hub.robots.of_link(device.link))
    robot = made.hub.robots.of_link(device.link)
    assert robot is not None
    return robot.name


def test_unnamed_boards_keep_their_names_over_a_restart_in_another_order(tmp_path: Path) -> None:
    async def first(made: MemoryHub) -> None:
        assert [await named(made, "10.0.0.7"), await named(made, "10.0.0.8")] == ["robot_0", "robot_1"]

    async def second(made: MemoryHub) -> None:
        assert [await named(made, "10.0.0.9"), await named(made, "10.0.0.8")] == ["robot_2", "robot_1"]
        assert await named(made, "10.0.0.7") == "robot_0"

    assert in_kept_hub(tmp_path, first) == []
    assert read(tmp_path)["robot_0"] == V
    assert in_kept_hub(tmp_path, second) == []
    assert [path.name for path in tmp_path.iterdir() if path.suffix == ".part"] == []


@pytest.mark.parametrize("data", [b"{", b"[]", b'{"robot_0": 3}', b"\xff", b" " * (MAX_FILE_BYTES + 1)])
def test_damaged_file_is_set_aside_with_a_warning(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "names.json").write_bytes(data)

    async def test(made: MemoryHub) -> None:
        assert await named(made, "10.0.0.7") == "robot_0"

    (warning,) = in_kept_hub(tmp_path, test)
    assert warning["event"] == "names.damaged"
    assert (tmp_path / "names.json.damaged").read_bytes() == data
    assert read(tmp_path) == {"robot_0": V}


def test_second_daemon_on_one_folder_runs_without_and_leaves_the_names(tmp_path: Path) -> None:
    owner = KeptFile(tmp_path, NAMES, Names)
    owner.read()
    owner.write({"robot_4": V})

    async def test(made: MemoryHub) -> None:
        assert await named(made, "10.0.0.8") == "robot_0"

    (warning,) = in_kept_hub(tmp_path, test)
    assert warning["reason"] == "another daemon with this port keeps its names there"
    assert owner.read() == {"robot_4": V}


def test_folder_that_cannot_be_written_is_said_once(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")

    async def test(made: MemoryHub) -> None:
        assert [await named(made, "10.0.0.7"), await named(made, "10.0.0.8")] == ["robot_0", "robot_1"]

    (warning,) = in_kept_hub(tmp_path / "file" / "names", test)
    assert (warning["event"], "Not a directory" in warning["reason"]) == ("names.not_kept", True)


def test_disk_that_fails_later_is_said_once_and_the_daemon_runs_on(tmp_path: Path) -> None:
    class Full(KeptFile[Names]):
        def write(self, names: object) -> None:  # noqa: ARG002 - the disk is full
            raise OSError("no space left")

    async def run() -> None:
        hub = Hub(Config(), CATALOG, reraises=True, guard=RecordingGuard())
        async with running(hub), kept_names(hub.links, Full(tmp_path, NAMES, Names)):
            made = MemoryHub(hub, RecordingGuard(), [])
            for number in range(3):
                await named(made, f"10.0.0.{number}")

    with capture_logs() as logs:
        asyncio.run(run())
    assert [each["reason"] for each in logs if each["event"] == "names.not_kept"] == ["no space left"]


def test_file_is_free_when_a_write_that_was_not_waited_for_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "LAST_TIMEOUT_S", 0.01)
    answers = threading.Event()

    def hang(path: Path, data: bytes) -> None:
        answers.wait(TIMEOUT_S)
        path.write_bytes(data)

    monkeypatch.setattr(module, "replace_file", hang)

    async def test(made: MemoryHub) -> None:
        assert await named(made, "10.0.0.7") == "robot_0"

    assert in_kept_hub(tmp_path, test) == []
    with pytest.raises(FolderTaken):
        KeptFile(tmp_path, NAMES, Names).read()
    answers.set()
    assert read(tmp_path) == {"robot_0": V}


def test_each_port_has_its_own_names_and_a_random_port_has_none(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    assert folder_of(Config(), NAMES) == tmp_path / "names" / "11411"
    assert folder_of(Config(tcp=TcpConfig(port=0)), NAMES) is None
    assert (
        folder_of(Config(tcp=TcpConfig(port=0), udp=UdpConfig(port=0)), NAMES) is None
    )  # no device finds the next daemon
    assert folder_of(Config(tcp=TcpConfig(port=0), udp=UdpConfig(port=4000)), NAMES) == tmp_path / "names" / "4000"
    serial = (SerialConfig(path="/dev/ttyUSB0"),)
    assert folder_of(Config(tcp=TcpConfig(port=0), serial=serial), NAMES) == tmp_path / "names" / "0"
