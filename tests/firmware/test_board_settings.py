"""`hostlink board` against the library's side of the dialogue, compiled with sanitizers, over a pty."""

import asyncio
import contextlib
import os
import subprocess
import threading
import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from hostlink.board.settings import (
    LINE_BYTES_MAX,
    SETTINGS,
    BoardAnswer,
    assignment,
    check_value,
    parse_answer,
    request_line,
)
from hostlink.cli.board import app
from hostlink.client import connect
from hostlink.errors import BadRequest, ConfigError, HostlinkError
from tests.firmware.sketches import build, running
from tests.support import compilers
from tests.support.compilers import SANITIZERS, WARNINGS
from tests.support.once import BUILD, once
from tests.support.process import HOSTLINK, serve
from tests.support.pty_pair import pty_pair
from tests.support.screen import screen

FIRMWARE = Path(__file__).parents[2] / "firmware"
PROGRAM = BUILD / "settings_board"
PASSWORD = "p %#ss=wört"  # bytes at which a line must not be cut
KEY = "0123456789abcdef" * 2
CRC32 = 0xFFFFFFFF
EMPTY = Path(__file__).parents[1] / "__init__.py"


@pytest.fixture(scope="session", autouse=True)
def _compiled() -> None:
    once("settings_board_program", _compile, PROGRAM)
    build("board_settings")


def _compile() -> None:
    library = FIRMWARE / "rosserial" / "src"
    own = [library / "hostlink" / name for name in ("board_settings.cpp", "settings_line.cpp")]
    options = ["-std=c++11", "-O0", *WARNINGS, *SANITIZERS, f"-I{library}"]
    compilers.run(["g++", *options, FIRMWARE / "tests" / "settings_board.cpp", *own, "-o", PROGRAM])


class Board:
    """The program: path of its port, and the settings that it last reported."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process
        self.port = self._line()

    def stored(self) -> list[str]:
        """Host, port, name, WiFi name and password, key, password for updates: at the start, or stored now."""
        return self._line().split("\t")

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().rstrip("\n")


@contextlib.contextmanager
def board(flash: Path, kind: str = "plain") -> Iterator[Board]:
    with subprocess.Popen([PROGRAM, flash, kind], stdout=subprocess.PIPE, text=True) as process:
        try:
            yield Board(process)
        finally:
            process.kill()


def run(*arguments: object) -> str:
    """Output of `hostlink board`; its exceptions are raised."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0
    return result.output


@pytest.fixture
def flash(tmp_path: Path) -> Path:
    return tmp_path / "flash"


@pytest.fixture
def password_file(tmp_path: Path) -> Path:
    file = tmp_path / "password"
    file.write_text(f"{PASSWORD}\n")
    return file


@pytest.mark.parametrize("kind", ["plain", "preferences", "noisy", "deaf", "shared"])
def test_settings_are_stored_shown_and_there_after_a_restart(flash: Path, password_file: Path, kind: str) -> None:
    options = ["--host", "192.168.4.1", "--host-port", 11411, "--name", "robot_3", "--wifi-name", "My net #1"]
    with board(flash, kind) as robot:
        assert robot.stored() == ["", "11411", "", "", "", "", ""]
        output = run("setup", robot.port, *options, "--wifi-password-file", password_file)
        assert "192.168.4.1:11411" in output
        stored = ["192.168.4.1", "11411", "robot_3", "My net #1", PASSWORD, "", ""]
        assert robot.stored() == stored
        shown = run("info", robot.port)
    assert PASSWORD not in output + shown
    assert [line.split(maxsplit=1) for line in shown.splitlines()][3:6] == [
        ["wifi_name", "My net #1"], ["wifi_password", "set"], ["key", "unset"],
    ]  # fmt: skip
    with board(flash, kind) as restarted:
        assert restarted.stored() == stored


def test_setup_keeps_unnamed_settings_and_an_empty_value_clears(flash: Path, tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_text(KEY)
    with board(flash) as robot:
        robot.stored()
        run("setup", robot.port, "--host", "mule.local", "--key-file", key)
        robot.stored()
        run("setup", robot.port, "--name", "mule")
        assert robot.stored() == ["mule.local", "11411", "mule", "", "", KEY, ""]
        run("setup", robot.port, "--host", "")
        assert robot.stored() == ["", "11411", "mule", "", "", KEY, ""]


def test_a_board_that_restarts_before_it_stores_has_the_new_key_in_the_end(flash: Path, tmp_path: Path) -> None:
    """`info` shows only whether a key is set, so an older key would not be noticed."""
    key = tmp_path / "key"
    key.write_text("an-older-key-of-it")
    with board(flash) as robot:
        run("setup", robot.port, "--key-file", key)
    key.write_text(f"\ufeff{KEY}\r\n")  # like an editor of Windows
    with board(flash, "forgetful") as robot:
        robot.stored()
        run("setup", robot.port, "--key-file", key, "--name", "mule")
        assert robot.stored() == ["", "11411", "mule", "", "", KEY, ""]


async def test_a_person_answers_questions_and_no_password_is_on_the_screen(flash: Path) -> None:
    with board(flash) as robot:
        robot.stored()
        await asyncio.to_thread(run, "setup", robot.port, "--wifi-name", "red\x9b31m")  # an old control sequence
        robot.stored()
        async with screen() as terminal:
            await terminal.keys(f"{HOSTLINK} board setup {robot.port}; echo status $?", "Enter")
            for question, wrong, complaint, answer in (
                ("The host's name", "my host", "host: no spaces", "mule.local"),
                ("The host's port", "70000", "port: 1 to 65535", "11411"),
                ("The robot's name", "3x", "name: a letter", "robot_3"),
                (r"The WiFi's name [red\u009b31m]", "x" * 33, "wifi_name: at most 32 bytes", "My net"),
                ("The WiFi's password", "s3cret", "wifi_password: 8 to 64 bytes, this has 6", "s3cret-s3cret"),
            ):
                await terminal.shows(question)
                await terminal.keys(wrong, "Enter")
                await terminal.shows(complaint)
                await terminal.keys(answer, "Enter")
            await terminal.shows("The key that")
            await terminal.keys("Enter")
            await terminal.shows("for updates")
            await terminal.keys("Enter")
            text = await terminal.shows("status 0")
        assert "s3cret" not in text
        assert "stored. The board connects to mule.local:11411" in text
        assert robot.stored() == ["mule.local", "11411", "robot_3", "My net", "s3cret-s3cret", "", ""]


async def test_ctrl_c_at_a_question_stores_nothing(flash: Path) -> None:
    with board(flash) as robot:
        async with screen() as terminal:
            await terminal.keys(f"{HOSTLINK} board setup {robot.port}; echo status $?", "Enter")
            await terminal.shows("The host's name")
            await terminal.keys("mule.local", "Enter")
            await terminal.shows("The host's port")
            assert "Traceback" not in await terminal.interrupt("status 130")
    with board(flash) as restarted:
        assert restarted.stored()[0] == ""


async def test_a_sketch_with_these_settings_is_at_the_host_under_its_name(
    flash: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    key = tmp_path / "key"
    key.write_text(KEY)
    config = tmp_path / "hostlink.toml"
    config.write_text('[tcp]\nkey_file = "key"\n')
    with board(flash, "preferences") as robot:  # flash like the example's: only the record
        options = ("--host", "127.0.0.1", "--name", "robot_3", "--key-file", str(key))
        await asyncio.to_thread(run, "setup", robot.port, *options)
    monkeypatch.setenv("ANY_BOARD_FLASH", str(flash))
    async with (
        serve("--config", str(config)) as daemon,
        running("board_settings", daemon.tcp),
        connect(daemon.url) as host,
        asyncio.timeout(15.0),
        host.subscribe("/robot_3/chatter", type_name="std_msgs/String") as messages,
    ):
        assert await anext(aiter(messages)) == {"data": "hello from a board that knows its host"}


@pytest.mark.parametrize("at", [0, 30, -1])
def test_damaged_flash_counts_as_empty(flash: Path, at: int) -> None:
    with board(flash, "preferences") as robot:
        run("setup", robot.port, "--host", "mule.local")
    damaged = bytearray(flash.read_bytes())
    damaged[at] ^= 0x20
    flash.write_bytes(damaged)
    with board(flash, "preferences") as robot:
        assert robot.stored() == ["", "11411", "", "", "", "", ""]


def test_power_that_fails_at_any_byte_leaves_the_old_settings_the_new_ones_or_none(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    for file, host in ((first, "mule.local"), (second, "192.168.4.100")):
        with board(file, "preferences") as robot:
            run("setup", robot.port, "--host", host, "--name", f"robot_at_{len(host)}")
    done = subprocess.run([PROGRAM, first, "torn", second], capture_output=True, text=True, check=True)
    found = done.stdout.split()
    record_bytes = len(first.read_bytes())
    assert len(found) == 2 * (record_bytes + 1)
    assert (found[0], found[-1]) == ("first", "second")
    assert set(found) == {"first", "second", "empty"}


def test_flash_with_a_text_that_never_ends_is_not_read(flash: Path) -> None:
    with board(flash, "preferences") as robot:
        run("setup", robot.port, "--host", "mule.local")
    record = bytearray(flash.read_bytes())
    record[4:68] = b"x" * 64  # the whole field of the host, without its terminating zero
    record[-4:] = zlib.crc32(record[:-4]).to_bytes(4, "little")
    flash.write_bytes(record)
    with board(flash, "preferences") as robot:
        assert robot.stored()[0] == ""


def test_a_port_that_is_gone_is_named_once() -> None:
    with pty_pair() as (other, port):
        closing = threading.Timer(0.3, os.close, (other,))
        closing.start()
        with pytest.raises(HostlinkError, match=rf"^{port}: (?!.*{port})"):
            run("info", port)
        closing.join()


def test_flash_that_cannot_be_written_is_an_error_and_changes_nothing(flash: Path) -> None:
    with board(flash, "worn") as robot:
        with pytest.raises(HostlinkError, match="the value could not be stored"):
            run("setup", robot.port, "--host", "mule.local")
        assert "mule.local" not in run("info", robot.port)


def test_a_board_that_does_not_answer_is_an_error_with_the_next_step() -> None:
    with pty_pair() as (_, port), pytest.raises(HostlinkError, match=r"needs a hostlink::SettingsLine .*--baud"):
        run("info", port, "--wait", 0.2)


def test_a_board_of_another_library_that_has_no_host_is_set_up() -> None:
    answers = {b"info": [b"value name=mule", b"value hue=blue"]}

    def serve_board(port: int) -> None:
        received = b""
        while b"info" not in received:
            received += os.read(port, 4096)
            *lines, received = received.split(b"\n")
            for words in (line.split(b" ") for line in lines):
                for answer in (*answers.get(words[2], ()), b"ok"):
                    os.write(port, request_line(int(words[1]), answer.decode()))
                if words[2] == b"info":
                    return

    with pty_pair() as (other, port):
        serving = threading.Thread(target=serve_board, args=(other,))
        serving.start()
        try:
            assert "stored. The board connects to ?:11411" in run("setup", port, "--name", "mule", "--wait", 2)
        finally:
            serving.join()


@pytest.mark.parametrize(
    ("text", "reason"), [(b"\x8a\x03k" * 30, "other bytes; set the baud"), (b"\xff\xfe", "rosserial")]
)
def test_a_port_with_other_bytes_is_an_error_that_names_them(text: bytes, reason: str) -> None:
    is_over = threading.Event()

    def print_on(descriptor: int) -> None:
        while not is_over.wait(0.02):
            os.write(descriptor, text)

    with pty_pair() as (other, port):
        printing = threading.Thread(target=print_on, args=(other,))
        printing.start()
        try:
            with pytest.raises(HostlinkError, match=reason):
                run("info", port, "--wait", 0.5)
        finally:
            is_over.set()
            printing.join()


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--name", "3x"), "name: a letter"),
        (("--host-port", "65536"), "port: 1 to 65535"),
        (("--host", "my host"), "host: no spaces"),
        (("--wifi-name", "x" * 33), "wifi_name: at most 32 bytes, this has 33"),
        (("--name", "a//b"), "name: a letter"),
        (("--key-file", "/gone"), "No such file"),
        (("--key-file", EMPTY), "is empty; name /dev/null to clear the setting"),
        ((), "standard input is not a terminal"),
    ],
)
def test_a_wrong_value_is_refused_before_anything_is_stored(flash: Path, options: tuple[str, ...], reason: str) -> None:
    with board(flash) as robot, pytest.raises(ConfigError, match=reason):
        run("setup", robot.port, *options)


requests = st.one_of(
    st.sampled_from(
        ["info", "save", "save 0", "save 1", "save 10", "forget", "set", "", "info ", "set x=1", "set host"]
    ),
    st.builds(assignment, st.sampled_from(list(SETTINGS)), st.text(max_size=90)),
    st.builds("set {}={}".format, st.sampled_from(list(SETTINGS)), st.text("%0Aaf#= x", max_size=200)),
)
lines = st.one_of(
    st.builds(request_line, st.integers(0, 70000), requests),
    st.builds(
        lambda line, cut: line[:cut] + line[cut + 1 :],
        st.builds(request_line, st.just(7), requests),
        st.integers(0, 40),
    ),
    st.binary(max_size=300),
    st.just(b"#hl " + b"x" * 600),
)


@settings(deadline=None, max_examples=max(20, settings().max_examples // 3))
@given(st.lists(lines, max_size=40))
def test_board_after_any_bytes_answers_the_next_request(sent: list[bytes]) -> None:
    wire = b"".join(sent) + b"\n" + request_line(9, "info")
    done = subprocess.run([PROGRAM, "/dev/null", "pipe"], input=wire, capture_output=True, check=False, timeout=20)
    assert done.returncode == 0, done.stderr.decode()
    answers = [parse_answer(line) for line in done.stdout.splitlines()]
    assert None not in answers
    assert answers[-1] == BoardAnswer(9, "ok")
    assert [answer.words.partition("=")[0].split()[1] for answer in answers[-8:-1] if answer] == list(SETTINGS)


@settings(deadline=None, max_examples=max(20, settings().max_examples // 3))
@given(st.lists(st.tuples(st.sampled_from(list(SETTINGS)), st.text(max_size=70)), min_size=1, max_size=30))
def test_the_board_accepts_the_values_that_the_command_does(values: list[tuple[str, str]]) -> None:
    lines = [request_line(number, assignment(*value)) for number, value in enumerate(values)]
    values = [value for value, line in zip(values, lines, strict=True) if len(line) <= LINE_BYTES_MAX]
    wire = b"".join(lines)  # a longer line is not a request: the command refuses it before
    done = subprocess.run([PROGRAM, "/dev/null", "pipe"], input=wire, capture_output=True, check=False, timeout=20)
    answers = [parse_answer(line) for line in done.stdout.splitlines()]
    accepted = [answer.words == "ok" for answer in answers if answer]
    assert accepted == [is_accepted(name, value) for name, value in values]


def is_accepted(name: str, value: str) -> bool:
    try:
        check_value(SETTINGS[name], value)
    except BadRequest:
        return False
    return True
