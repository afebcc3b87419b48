"""Files that `hostlink arduino-library` writes, and folders and names that it refuses."""

import json
import os
import resource
import zipfile
from pathlib import Path

import pytest

from hostlink.cli.board import arduino_library as command
from hostlink.errors import ConfigError

SMALL = ["std_msgs/Empty"]


def package(folder: Path, text: str = "uint8 x\n") -> Path:
    """The folder with my_msgs/Mine in it."""
    (folder / "my_msgs" / "msg").mkdir(parents=True)
    (folder / "my_msgs" / "msg" / "Mine.msg").write_text(text)
    return folder


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("is_forced", [False, True])
def test_output_to_a_folder_a_pipe_or_standard_output_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, is_forced: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    Path("link").symlink_to("pipe")
    Path("folder").mkdir()
    for name, problem in (
        (".", "is a folder"),
        ("folder/", "is a folder"),
        ("pipe", "is not a plain file"),
        ("link", "is not a plain file"),
        ("-", "'-' is not a file"),
        ("x" * 300, "File name too long; name another"),
    ):
        with pytest.raises(ConfigError, match=problem):
            command(output=Path(name), only=SMALL, force=is_forced)
    assert names_in(tmp_path) == ["folder", "link", "pipe"]
    assert Path("pipe").is_fifo()


def test_a_link_stays_and_leads_to_the_zip(tmp_path: Path) -> None:
    (tmp_path / "here.zip").symlink_to("there.zip")
    for is_forced in (False, True):
        command(output=tmp_path / "here.zip", only=SMALL, force=is_forced)
    assert (tmp_path / "here.zip").is_symlink()
    assert zipfile.is_zipfile(tmp_path / "there.zip")
    assert names_in(tmp_path) == ["here.zip", "there.zip"]


def test_any_name_of_a_file_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Report a name that is not UTF-8, too."""
    output = Path(os.fsdecode(bytes(tmp_path) + b"/my \xc3\xa4\xff.zip"))
    command(output=output, only=SMALL, json=True)
    assert json.loads(capsys.readouterr().out)["output"].endswith("/my ä\ufffd.zip")
    assert output.exists()


def test_platformio_gets_the_path_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command(output=tmp_path / "my library ä.zip", only=SMALL)
    assert f"lib_deps = file://{tmp_path}/my library ä.zip" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("only", "problem"),
    [
        ([""], "--only: no name is given"),
        ([" , ", ""], "--only: no name is given"),
        (["std_msg"], "no package or type named std_msg; similar names: std_msgs"),
        (
            ["std_msgs/String", "qqq"],
            "no package or type named qqq; packages are: ackermann_msgs, actionlib, actionlib_msgs",
        ),
    ],
)
def test_an_only_that_selects_nothing_is_refused(tmp_path: Path, only: list[str], problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        command(output=tmp_path / "x.zip", only=only)
    assert names_in(tmp_path) == []


def test_a_folder_that_adds_nothing_is_refused_with_where_its_packages_are(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    package(tmp_path / "tree" / "repository")
    package(tmp_path / "work" / "src" / "repository")
    for folder, problem in (
        ("empty", "empty: contains no package with .msg or .srv files"),
        (
            "tree",
            "tree: the packages are in subfolders; give each folder that has some, such as .*/tree/repository$",
        ),
        (
            "work",
            "work: the packages are in subfolders; give each folder that has some, such as .*/work/src/repository$",
        ),
        ("tree/repository/my_msgs", "this is a package; give the folder that contains it"),
        ("tree/repository/my_msgs/msg", "this is a package; give the folder that contains it"),
        ("gone", "gone: the folder does not exist"),
    ):
        with pytest.raises(ConfigError, match=problem):
            command(output=tmp_path / "x.zip", messages=[tmp_path / folder])
    command(output=tmp_path / "x.zip", messages=[tmp_path / "tree" / "repository"], only=["my_msgs"])
    with zipfile.ZipFile(tmp_path / "x.zip") as archive:
        assert "hostlink_rosserial/src/my_msgs/Mine.h" in archive.namelist()


def test_hidden_files_of_another_system_are_not_read_as_definitions(tmp_path: Path) -> None:
    folder = package(tmp_path / "mine")
    (folder / "my_msgs" / "msg" / "._Mine.msg").write_bytes(b"\x00\x05\x16\x07")
    command(output=tmp_path / "x.zip", messages=[folder], only=["my_msgs"])


def test_a_folder_that_cannot_be_read_is_an_error_and_no_empty_one(tmp_path: Path) -> None:
    folder = package(tmp_path / "mine")
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, limits[1]))
    try:
        with pytest.raises(ConfigError, match=r"mine.*: Too many open files"):
            command(output=tmp_path / "x.zip", messages=[folder])
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
