"""`hostlink setup` as a person runs it, and what it writes served."""

from pathlib import Path

from tests.support.process import HOSTLINK, run
from tests.support.screen import screen


def names_in(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


async def test_settings_that_setup_writes_pass_the_check(tmp_path: Path) -> None:
    file = tmp_path / "hostlink.toml"
    answers = "usb\nCOM3\n/dev/ttyUSB7\n115200\nmule\n0.21\n0.4\n\nnetwork\n"
    status, out, err = await run("setup", str(file), input_text=answers)
    assert status == 0
    assert "answer with a path that begins with /dev/" in err
    assert f"hostlink serve --check-config {file}" in out
    assert file.stat().st_mode & 0o077 == 0
    status, out, _ = await run("serve", "--check-config", str(file))
    assert (status, "/dev/ttyUSB7 at 115200 baud" in out) == (0, True)
    assert names_in(tmp_path) == ["hostlink.toml"]


async def test_a_file_that_is_there_stays(tmp_path: Path) -> None:
    file = tmp_path / "hostlink.toml"
    file.write_text("mine")
    status, _, err = await run("setup", str(file), "--yes")
    assert (status, file.read_text()) == (2, "mine")
    assert err == f"hostlink: setup: {file} exists already; name another file, or replace it with --force\n"
    assert (await run("setup", str(file), "--yes", "--force"))[0] == 0


async def test_an_end_before_the_last_question_writes_nothing(tmp_path: Path) -> None:
    file = tmp_path / "hostlink.toml"
    status, _, err = await run("setup", str(file), input_text="wifi\n")
    assert (status, file.exists()) == (1, False)
    assert "standard input ended at question 2/10, and nothing was written" in err


async def test_a_file_that_cannot_be_written_is_a_line(tmp_path: Path) -> None:
    status, _, err = await run("setup", str(tmp_path / "none" / "hostlink.toml"), "--yes")
    assert (status, len(err.splitlines())) == (2, 1)
    assert "cannot be written: No such file or directory" in err


async def test_setup_in_a_terminal_at_ctrl_c_writes_nothing(tmp_path: Path) -> None:
    file = tmp_path / "hostlink.toml"
    async with screen() as terminal:
        await terminal.keys(f"{HOSTLINK} setup {file}; echo status $?", "Enter")
        await terminal.shows("1/10  How do robots connect")
        await terminal.keys("lan", "Enter")
        await terminal.shows("one of wifi, usb, both")
        await terminal.keys("wifi", "Enter")
        await terminal.shows("2/10  From which network")
        assert "\nstatus 130" in await terminal.interrupt("status 130")
        assert "Traceback" not in await terminal.text()
    assert not file.exists()
