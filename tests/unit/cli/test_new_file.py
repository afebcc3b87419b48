"""A file that a command writes replaces nothing but a plain file."""

import os
from pathlib import Path

import pytest

from hostlink.cli.export import export, plot
from hostlink.cli.files import check_output
from hostlink.cli.setup import setup as command
from hostlink.errors import ConfigError


@pytest.mark.parametrize("is_forced", [False, True])
def test_a_configuration_replaces_no_pipe_no_folder_and_no_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, is_forced: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    for name, problem in (
        ("pipe", "setup: pipe is not a plain file; name a file, for example hostlink.toml"),
        (".", "setup: . is a folder"),
        ("-", "setup: '-' is not a file"),
        ("x" * 300, "File name too long"),
    ):
        with pytest.raises(ConfigError, match=problem):
            command(file=Path(name), yes=True, force=is_forced)
    assert Path("pipe").is_fifo()
    Path("link.toml").symlink_to("there.toml")
    command(file=Path("link.toml"), yes=True, force=is_forced)
    assert Path("link.toml").is_symlink()
    assert Path("there.toml").read_text()


def test_a_file_to_fetch_into_has_a_name_that_is_not_too_long(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="File name too long"):
        check_output(tmp_path / ("x" * 300))


@pytest.mark.parametrize("is_link", [False, True])
def test_plot_export_and_fetch_replace_no_file_and_no_link(tmp_path: Path, *, is_link: bool) -> None:
    file, recording = tmp_path / "run.png", tmp_path / "run.mcap"
    if is_link:
        file.symlink_to("nowhere")
    else:
        file.write_text("mine")
    for write in (
        lambda: plot(recording, ["/odometry.x"], output=file),
        lambda: plot(recording, ["/odometry.x"]),  # the default name
        lambda: export(recording, format_="csv", output=file),
        lambda: check_output(file),
    ):
        with pytest.raises(ConfigError, match=r"run\.png exists already; choose another name, or remove it"):
            write()
    assert (str(file.readlink()) if is_link else file.read_text()) == ("nowhere" if is_link else "mine")
