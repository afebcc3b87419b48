"""`hostlink info NAME|FILE`: which of both is meant."""

from pathlib import Path

import pytest

from hostlink.cli.topics import is_recording


@pytest.mark.parametrize("name", ["/robot_0/odometry", "robot_0", "x" * 5000, "/" + "x" * 5000, "a\0b"])
def test_name_without_a_file_is_a_name_of_the_graph(name: str) -> None:
    assert not is_recording(name)


def test_file_of_any_name_is_a_recording(tmp_path: Path) -> None:
    (tmp_path / "run").touch()
    assert is_recording(str(tmp_path / "run"))
    assert is_recording("no/such/file.mcap")
