"""Folders of definitions: their content, and the errors of unsuitable ones."""

from pathlib import Path

import pytest

from hostlink.core.messages.catalog import check_not_empty, find_definitions
from hostlink.errors import ConfigError


def put(file: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("int8 a\n")


def test_folder_of_packages_adds_their_types(tmp_path: Path) -> None:
    put(tmp_path / "robot_msgs" / "msg" / "Wheels.msg")
    put(tmp_path / "robot_srvs" / "Turn.srv")
    assert list(find_definitions(tmp_path, ".msg")) == ["robot_msgs/Wheels"]
    assert list(find_definitions(tmp_path, ".srv")) == ["robot_srvs/Turn"]
    check_not_empty(tmp_path)


@pytest.mark.parametrize(("deeper", "place"), [("ws/src/robot_msgs", "ws/src"), ("robots/robot_msgs", "robots")])
def test_packages_in_subfolders_are_named(tmp_path: Path, deeper: str, place: str) -> None:
    put(tmp_path / deeper / "msg" / "Wheels.msg")
    with pytest.raises(
        ConfigError,
        match=f"the packages are in subfolders; give each folder that has some, such as {tmp_path / place}$",
    ):
        check_not_empty(tmp_path)


def test_folder_without_a_package_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes").mkdir()
    with pytest.raises(ConfigError, match=r"contains no package with \.msg or \.srv files"):
        check_not_empty(tmp_path)


def test_unreadable_package_is_named_and_other_folders_are_ignored(tmp_path: Path) -> None:
    for name in ("lost+found", "robot_msgs"):
        assert find_definitions(tmp_path, ".msg") == {}
        (tmp_path / name).mkdir()
        (tmp_path / name / "msg").symlink_to(
            tmp_path / name / "msg"
        )  # a symlink loop, which cannot be read even by root
    with pytest.raises(ConfigError, match="robot_msgs/msg: Too many levels of symbolic links"):
        find_definitions(tmp_path, ".msg")
