"""Serial port that disappears, returns under another name, or has a baud rate that must be found."""

import asyncio
import contextlib
import grp
import os
import stat
import subprocess
import termios
import tty
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Literal

import pytest
from structlog.testing import capture_logs

from hostlink.core.config import SerialConfig
from hostlink.core.diagnosis.evidence import port_finding
from hostlink.core.hub.hub import Hub
from hostlink.core.listeners.accepting import serve_serial
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.transport.serial import (
    DTR_PULSE_S,
    UsbPort,
    choose_by_serial,
    explain_permission,
    find_port,
    open_serial,
    pulse,
)
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import robot_topics
from tests.support.pty_pair import pty_pair
from tests.support.resources import in_use, open_descriptors
from tests.support.virtual_loop import run_virtual
from tests.support.waiting import expect

RETRY_S = 0.01
ANNOUNCEMENT = (
    encode(Id.TIME, bytes(8)) + b"".join(encode(i.kind, encode_topic_info(i)) for i in robot_topics())
) + encode(Id.TIME, bytes(8))
CFLAG, LFLAG, INPUT_SPEED, OUTPUT_SPEED = 2, 3, 4, 5


def found_by_doctor(hub: Hub) -> dict[str, str]:
    """Detail of each finding of the live links, by its code."""
    return {each.code: each.detail for link in hub.links.all() for each in hub.diagnoses.of(link)}


class Board:
    """A device on a pseudo terminal: answers each request for topics, if the port has the rate that it talks at."""

    def __init__(self, *, baud: int | None = None) -> None:
        self.descriptor, self._theirs = os.openpty()
        for end in (self.descriptor, self._theirs):
            tty.setraw(end, termios.TCSANOW)
        self.path = os.ttyname(self._theirs)
        self.speeds_set: list[int] = []
        self._speed = None if baud is None else getattr(termios, f"B{baud}")
        os.set_blocking(self.descriptor, False)
        asyncio.get_running_loop().add_reader(self.descriptor, self._answer)

    def _answer(self) -> None:
        with contextlib.suppress(OSError):  # the other end is closed
            if encode(Id.PUBLISHER, b"") in os.read(self.descriptor, 4096):
                speed = termios.tcgetattr(self.descriptor)[OUTPUT_SPEED]
                self.speeds_set.append(speed)
                os.write(self.descriptor, ANNOUNCEMENT if self._speed in (None, speed) else b"\x00\xf0garbage")

    def unplug(self) -> None:
        asyncio.get_running_loop().remove_reader(self.descriptor)
        for end in (self.descriptor, self._theirs):
            os.close(end)


@contextlib.asynccontextmanager
async def served(config: SerialConfig) -> AsyncIterator[Daemon]:
    """A daemon with one serial port that is looked for without a pause."""
    async with daemon() as host, asyncio.TaskGroup() as tasks:
        port = tasks.create_task(serve_serial(host.hub, config, retry_s=RETRY_S))
        yield host
        port.cancel()


def is_connected(hub: Hub) -> Callable[[], bool]:
    return lambda: hub.robots.find("robot_0").link is not None


async def test_board_that_returns_under_another_port_name_is_found(tmp_path: Path) -> None:
    by_id = tmp_path / "usb-Arduino_7543-if00"
    with capture_logs() as lines:
        async with served(SerialConfig(path=str(tmp_path / "usb-Arduino_*"))) as host:
            await expect(lambda: any(line["event"] == "serial.waiting" for line in lines))
            for _ in range(3):
                board = Board()
                by_id.symlink_to(board.path)
                await expect(is_connected(host.hub))
                assert host.hub.links.all()[0].address == str(tmp_path / "usb-Arduino_*")
                by_id.unlink()
                board.unplug()
                await expect(lambda: not host.hub.links.all())
    waiting = next(line["reason"] for line in lines if line["event"] == "serial.waiting")
    assert "[Errno" not in waiting
    assert "no such port; available:" in waiting


async def test_the_rates_are_tried_until_frames_come() -> None:
    board = Board(baud=115200)
    config = SerialConfig(path=board.path, baud=(57600, 115200), baud_try_s=1.5)  # the second request is sent after 2 s
    with capture_logs() as lines:
        async with served(config) as host:
            await expect(is_connected(host.hub))
            assert [link.number for link in host.hub.links.all()] == [1]  # the port was opened once
            await expect(lambda: any(line["event"] == "serial.baud_found" for line in lines))
    assert board.speeds_set == [termios.B57600, termios.B115200]
    assert next(line["baud"] for line in lines if line["event"] == "serial.baud_found") == 115200
    board.unplug()


async def test_a_port_that_vanishes_during_the_search_for_its_rate_is_waited_for(tmp_path: Path) -> None:
    board, path = Board(baud=9600), tmp_path / "port"
    path.symlink_to(board.path)
    with capture_logs() as lines:
        async with served(SerialConfig(path=str(path), baud=(57600, 115200), baud_try_s=0.01)) as host:
            await expect(lambda: board.speeds_set)
            path.unlink()  # another program may get the name of this pseudo terminal at once
            board.unplug()
            await expect(lambda: any(line["event"] == "serial.waiting" for line in lines))
            assert not host.hub.isolation.crashes


@pytest.mark.slow
async def test_a_port_that_vanishes_again_and_again_leaves_nothing_behind(tmp_path: Path) -> None:
    path = tmp_path / "port"
    observed = []
    async with served(SerialConfig(path=str(path))) as host:
        for turn in range(100):
            board = Board()
            path.symlink_to(board.path)
            await expect(is_connected(host.hub))
            path.unlink()
            board.unplug()
            await expect(lambda: not host.hub.links.all())
            if turn >= 10:  # the pool of threads has grown to its size
                observed.append(in_use())
    for counts in zip(*observed, strict=True):
        assert max(counts) - min(counts) <= 2  # a thread more, a descriptor that is just open


@pytest.mark.parametrize("on_open", ["leave", "reset"])
async def test_closing_a_port_leaves_the_line_on_that_resets_a_board(on_open: Literal["leave", "reset"]) -> None:
    with pty_pair() as (descriptor, path):
        transport = await open_serial(SerialConfig(path=path, on_open=on_open))
        assert not termios.tcgetattr(descriptor)[CFLAG] & termios.HUPCL
        await transport.send(b"ready")
        await transport.aclose()


class Line:
    """The DTR line of a port."""

    def __init__(self) -> None:
        self.states: list[tuple[float, bool]] = []

    def set_dtr(self, *, is_on: bool) -> None:
        self.states.append((asyncio.get_running_loop().time(), is_on))


def test_a_reset_lets_the_line_go_for_a_tenth_of_a_second() -> None:
    line = Line()
    run_virtual(pulse(line))
    assert line.states == [(0.0, False), (DTR_PULSE_S, True)]


async def test_cancelled_opening_leaves_no_port_open() -> None:
    with contextlib.ExitStack() as lines:
        paths = [lines.enter_context(pty_pair())[1] for _ in range(20)]
        before = open_descriptors()
        for turn, path in enumerate(paths):
            async with asyncio.TaskGroup() as tasks:
                opening = tasks.create_task(open_serial(SerialConfig(path=path)))
                for _ in range(turn % 4 + 1):
                    await asyncio.sleep(0)
                opening.cancel()
            if not opening.cancelled():  # it was faster
                await opening.result().aclose()
        await asyncio.get_running_loop().shutdown_default_executor()  # every thread has opened what it was to open
        await expect(lambda: open_descriptors() <= before)


class Thief:
    """Another program at the same port, which takes the bytes that hostlink was just woken for.

    One descriptor is watched before hostlink opens the port and one after: one of them is always served first.
    """

    def __init__(self, path: str) -> None:
        self.taken = 0
        self._path = path
        self._descriptors: list[int] = []
        self.watch()

    def watch(self) -> None:
        descriptor = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._descriptors.append(descriptor)
        asyncio.get_running_loop().add_reader(descriptor, self._take, descriptor)

    def _take(self, descriptor: int) -> None:
        with contextlib.suppress(BlockingIOError):
            self.taken += len(os.read(descriptor, 4096))

    def close(self) -> None:
        for descriptor in self._descriptors:
            asyncio.get_running_loop().remove_reader(descriptor)
            os.close(descriptor)
        self._descriptors.clear()


async def test_bytes_that_another_program_takes_end_no_link() -> None:
    board = Board()
    thief = Thief(board.path)
    async with served(SerialConfig(path=board.path)) as host:
        await expect(host.hub.links.all)
        thief.watch()
        for _ in range(20):
            before = thief.taken
            # A busy computer may wake hostlink alone, which then takes all.
            await expect(lambda before=before: os.write(board.descriptor, ANNOUNCEMENT) and thief.taken > before)
        await expect(lambda: "serial_shared" in found_by_doctor(host.hub))  # also where only the reads show it
        assert "reads were lost to it" in found_by_doctor(host.hub)["serial_shared"]
        thief.close()
        os.write(board.descriptor, ANNOUNCEMENT)
        await expect(is_connected(host.hub))
        assert [link.number for link in host.hub.links.all()] == [1]
    board.unplug()


async def test_another_program_at_a_silent_port_is_named() -> None:
    with pty_pair() as (_, path):
        command = (
            f"cat {path} >/dev/null & echo $!; read end; kill $!"  # not a child of this process, as its guardian is
        )
        shell = await asyncio.create_subprocess_shell(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert shell.stdout is not None
        pid = int(await shell.stdout.readline())
        try:
            async with served(SerialConfig(path=path)) as host:
                await expect(lambda: "serial_shared" in found_by_doctor(host.hub))
                assert found_by_doctor(host.hub)["serial_shared"] == f"cat (pid {pid})"
        finally:
            await shell.communicate(b"\n")


async def test_settings_that_another_program_changes_are_set_again() -> None:
    with pty_pair() as (_, path):
        transport = await open_serial(SerialConfig(path=path, baud=115200))
        assert not transport.keep_settings()
        other = os.open(path, os.O_RDWR | os.O_NOCTTY)
        settings = termios.tcgetattr(other)
        settings[LFLAG] |= termios.ICANON | termios.ECHO  # as a login does
        settings[INPUT_SPEED] = settings[OUTPUT_SPEED] = termios.B9600
        termios.tcsetattr(other, termios.TCSANOW, settings)
        assert transport.keep_settings()
        found = termios.tcgetattr(other)
        assert not found[LFLAG] & (termios.ICANON | termios.ECHO)
        assert found[OUTPUT_SPEED] == termios.B115200
        assert not found[CFLAG] & termios.HUPCL
        os.close(other)
        await transport.aclose()


async def test_removed_port_ends_the_transport() -> None:
    board = Board()
    transport = await open_serial(SerialConfig(path=board.path))
    board.unplug()
    with pytest.raises(OSError, match=board.path):
        await transport.receive()
    assert not transport.keep_settings()
    await transport.aclose()


def test_a_pattern_that_fits_two_ports_is_not_guessed(tmp_path: Path) -> None:
    for name in ("ttyACM0", "ttyACM1"):
        (tmp_path / name).touch()
    with pytest.raises(OSError, match=r"ttyACM\*: matches 2 ports: .*ttyACM0, .*ttyACM1; name one of them"):
        find_port(SerialConfig(path=str(tmp_path / "ttyACM*")))
    assert find_port(SerialConfig(path=str(tmp_path / "*1"))) == str(tmp_path / "ttyACM1")


def test_a_usb_device_is_known_by_its_serial_number() -> None:
    found = [  # a device with two ports
        UsbPort("/dev/ttyACM2", "7543", "1-1.2"),
        UsbPort("/dev/ttyACM0", "8000", "1-1.3"),
        UsbPort("/dev/ttyACM1", "7543", "1-1.2"),
    ]
    assert choose_by_serial("7543", found) == "/dev/ttyACM1"
    with pytest.raises(OSError, match=r"^\[Errno 2\] 9999: no USB device .*; available: 7543 \(/dev/ttyACM1\), 7543"):
        choose_by_serial("9999", found)


def test_two_adapters_with_one_serial_number_are_refused_with_both_paths(tmp_path: Path) -> None:
    found = [UsbPort("/dev/ttyUSB0", "0001", "1-1.2"), UsbPort("/dev/ttyUSB1", "0001", "1-1.3")]
    (tmp_path / "usb-0:1.3:1.0-port0").symlink_to("/dev/ttyUSB1")
    with pytest.raises(OSError, match=r"0001: 2 ports have this serial number; .*by its path in") as raised:
        choose_by_serial("0001", found, tmp_path)
    assert f"/dev/ttyUSB0 = USB 1-1.2, /dev/ttyUSB1 = {tmp_path}/usb-0:1.3:1.0-port0" in str(raised.value)
    assert port_finding(raised.value).code == "serial_ambiguous"


@pytest.mark.parametrize(
    ("mode", "group", "text"),
    [
        (0o660, 0, "none for its group root: install the udev rule"),
        (0o660, 20, f"no permission: sudo usermod -aG {grp.getgrgid(20).gr_name} $USER"),
        (0o600, 20, "install the udev rule"),
        (0o660, 54321, "usermod -aG 54321 $USER"),
    ],
)
def test_missing_permission_is_explained_by_the_group_of_the_port(mode: int, group: int, text: str) -> None:
    assert text in explain_permission(os.stat_result((stat.S_IFCHR | mode, 0, 0, 1, 0, group, 0, 0, 0, 0)))


@pytest.mark.parametrize("is_on", [True, False])
async def test_lines_of_a_port_are_set_before_it_is_opened(is_on: bool) -> None:
    with pty_pair() as (_, path):
        transport = await open_serial(SerialConfig(path=path, dtr=is_on, rts=is_on))
        assert transport.lines == (is_on, is_on)
        await transport.aclose()


def test_a_missing_usb_device_is_reported() -> None:
    with pytest.raises(OSError, match="no-such-number: no USB device with this serial number; available: "):
        find_port(SerialConfig(usb_serial="no-such-number"))


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("/dev/ttyNONE", r"/dev/ttyNONE: no such port; available: "),
        ("/dev/null", r"/dev/null: not a serial port"),
        ("/dev", r"/dev: not a serial port"),
    ],
)
async def test_a_port_that_cannot_be_opened_gives_the_reason(path: str, text: str) -> None:
    with pytest.raises(OSError, match=text):
        await open_serial(SerialConfig(path=path))


async def test_an_impossible_baud_rate_is_reported() -> None:
    with pty_pair() as (_, path), pytest.raises(OSError, match=f"{path}: -1 baud: Not a valid baudrate"):
        await open_serial(SerialConfig(path=path, baud=-1))


async def test_a_port_that_another_program_uses_is_reported() -> None:
    with pty_pair() as (_, path):
        first = await open_serial(SerialConfig(path=path))
        with pytest.raises(OSError, match="another program has it open"):
            await open_serial(SerialConfig(path=path))
        await first.aclose()
