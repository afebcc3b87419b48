"""`hostlink lab`: what is wrong is one line that says what to do."""

from pathlib import Path

import pytest

from hostlink.cli.main import build_app
from hostlink.errors import ConfigError


def run(*arguments: str) -> None:
    build_app("lab")(["lab", *arguments], standalone_mode=False)


def test_a_missing_library_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(ConfigError, match=r"needs matplotlib, of the extra .lab.: run  .* -m pip install .matplotlib"):
        run("pictures")


@pytest.mark.parametrize(
    ("text", "problem"),
    [("track=0.2\n", "meant track_m"), ("track_m=wide\n", "track_m=wide"), ("left.radius\n", "left.radius")],
)
def test_a_wrong_world_is_named(tmp_path: Path, text: str, problem: str) -> None:
    world = tmp_path / "world.txt"
    world.write_text(text)
    with pytest.raises(ConfigError, match=problem):
        run("tables", "--world", str(world))


def test_a_world_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        run("tables", "--world", str(tmp_path / "none"))


def test_a_world_belongs_to_tables_and_pictures(tmp_path: Path) -> None:
    world = tmp_path / "world.txt"
    world.write_text("track_m=0.212\n")
    for what in ("causes", "claims"):
        with pytest.raises(ConfigError, match="hostlink lab tables"):
            run(what, "--world", str(world))


def test_a_picture_that_cannot_be_written_is_refused_before_anything_is_driven(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"must end in \.png"):
        run("pictures", "-o", str(tmp_path / "paths.svg"))
    with pytest.raises(ConfigError, match=r"the folder .* cannot be written; create it"):
        run("pictures", "-o", str(tmp_path / "none" / "paths.png"))


@pytest.mark.parametrize("arguments", [("everything",), ("tables", "--runs", "1"), ()])
def test_wrong_arguments_are_refused(arguments: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit, match="2"):
        build_app("lab")(["lab", *arguments])
