"""Programs at a serial port, from a /proc with what each of them may show."""

import os
from pathlib import Path

import pytest

from hostlink.core.transport.port_users import PortUsers, is_running, users_of

PORT = "/dev/null"  # a device with a number, which every system has: 1:3
TERMINAL = 1 << 8 | 3


@pytest.fixture
def proc(tmp_path: Path) -> Path:
    (tmp_path / "consoles").write_text("ttyAMA0              -W- (EC  p a)  204:64\n")
    return tmp_path


def add_process(
    proc: Path, pid: int, name: str, *, parent: int = 1, terminal: int = 0, target: str | None = None
) -> None:
    folder = proc / str(pid)
    folder.mkdir()
    (folder / "stat").write_text(f"{pid} ({name}) S {parent} 1 1 {terminal} 0 4194304 103 0\n")
    if target is not None:  # without the folder: a process of another user
        (folder / "fd").mkdir()
        (folder / "fd" / "3").symlink_to(target)


def test_program_with_the_port_open_is_named(proc: Path) -> None:
    add_process(proc, 12, "my (tool) 2", target=PORT)
    add_process(proc, 13, "bash", target="/dev/zero")
    assert users_of(PORT, proc) == PortUsers(("my (tool) 2 (pid 12)",))


def test_link_to_a_port_is_followed(proc: Path) -> None:
    add_process(proc, 12, "cat", target=PORT)
    (proc / "robot").symlink_to(PORT)
    assert users_of(str(proc / "robot"), proc).names == ("cat (pid 12)",)


def test_login_of_another_user_is_known_by_its_terminal(proc: Path) -> None:
    add_process(proc, 312, "agetty", terminal=TERMINAL)
    assert users_of(PORT, proc) == PortUsers(("agetty (pid 312)",), has_login=True)


def test_console_of_the_kernel_is_named(proc: Path) -> None:
    (proc / "consoles").write_text("null  -W- (EC  p a)  1:3\n")
    assert users_of(PORT, proc) == PortUsers(("the kernel's console",), has_login=True)


def test_terminal_of_the_same_number_in_a_container_is_another_one(proc: Path) -> None:
    host, port = os.openpty()
    path, number = os.ttyname(port), os.fstat(port).st_rdev
    add_process(proc, 12, "cat", target=path)
    (proc / "12" / "root").symlink_to("/")
    add_process(proc, 13, "dpkg", terminal=os.major(number) << 8 | os.minor(number), target=path)
    (proc / "13" / "root" / "dev" / "pts").mkdir(parents=True)
    assert users_of(path, proc) == PortUsers(("cat (pid 12)",))
    os.close(host)
    os.close(port)


def test_own_process_and_its_guardian_are_not_named(proc: Path) -> None:
    add_process(proc, os.getpid(), "hostlink", target=PORT)
    add_process(proc, 14, "guardian", parent=os.getpid(), target=PORT)
    assert users_of(PORT, proc) == PortUsers()


def test_missing_files_and_ports_are_ignored(tmp_path: Path) -> None:
    (tmp_path / "15").mkdir()  # a process that has just ended
    assert users_of(PORT, tmp_path) == PortUsers()
    assert users_of(str(tmp_path / "no-such-port"), tmp_path) == PortUsers()


def test_running_program_is_found_by_its_name(proc: Path) -> None:
    add_process(proc, 20, "brltty")
    assert is_running("brltty", proc)
    assert not is_running("brltt", proc)
