"""Settings are written into a person's file: comments, order and everything else stay."""

import os
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.cli.settings import load
from hostlink.cli.settings_file import changed, require_changeable, toml_lines, write_settings
from hostlink.errors import ConfigError

FILE = """\
# the lab's robots
[tcp]
port = 11411  # as always

[parameters]   # of the firmware
"/robot_0/wheel_radius" = 0.045     # by the drawing
"/robot_0/gains_left" = [23.0, 36.0, 0.1]

[robots.robot_0]
max_linear_m_s = 0.3
"""
PARAMETERS = {"parameters": {'"/robot_0/wheel_radius"': "[0.0448, 0.0453]", '"/robot_0/wheel_separation"': "0.2142"}}
CALIBRATION = {"robots.robot_0.calibration": {"left_factor": "0.995", "right_factor": "1.006"}}


def test_a_line_is_replaced_and_another_is_added() -> None:
    after = changed(FILE, PARAMETERS)
    values = tomllib.loads(after)["parameters"]
    assert values["/robot_0/wheel_radius"] == [0.0448, 0.0453]
    assert values["/robot_0/wheel_separation"] == 0.2142
    assert values["/robot_0/gains_left"] == [23.0, 36.0, 0.1]
    assert "port = 11411  # as always" in after
    assert '"/robot_0/wheel_radius" = [0.0448, 0.0453]     # by the drawing\n' in after
    assert len(after.splitlines()) == len(FILE.splitlines()) + 1


def test_a_table_that_is_not_there_is_added() -> None:
    assert tomllib.loads(changed(FILE, CALIBRATION))["robots"]["robot_0"] == {
        "max_linear_m_s": 0.3,
        "calibration": {"left_factor": 0.995, "right_factor": 1.006},
    }
    assert tomllib.loads(changed("", CALIBRATION))["robots"]["robot_0"]["calibration"]["left_factor"] == 0.995


def test_the_file_as_it_was_stays_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "hostlink.toml"
    path.write_text(FILE)
    path.chmod(0o640)
    first = write_settings(path, PARAMETERS)
    second = write_settings(path, CALIBRATION)
    assert (first.name, second.name) == ("hostlink.toml.before", "hostlink.toml.before2")
    assert first.read_text() == FILE
    assert path.stat().st_mode & 0o777 == 0o640
    config = load(path)
    assert config.parameters["/robot_0/wheel_separation"] == 0.2142
    assert config.robots["robot_0"].calibration.left_factor == 0.995
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [path.name, first.name, second.name]


@pytest.mark.parametrize(
    "text",
    [
        'parameters = { "/robot_0/wheel_radius" = 0.045 }\n',
        '[parameters]\n"/robot_0/wheel_radius" = [\n  0.045,\n  0.046,\n]\n',
        "[parameters]\n'/robot_0/wheel_radius' = 0.045\n",
        "[robots.robot_0\n",
    ],
    ids=["inline table", "several lines", "another quote", "no TOML"],
)
def test_a_file_in_another_form_is_left_as_it_is(tmp_path: Path, text: str) -> None:
    path = tmp_path / "hostlink.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"hostlink\.toml"):
        write_settings(path, PARAMETERS)
    assert path.read_text() == text
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize(
    ("line", "comment"),
    [
        ('"/a#b" = "x # y"', ""),
        ('"/a#b" = "x # y"  # why # not', "  # why # not"),
        ('"/a#b" = 1# why', "# why"),
    ],
)
def test_a_comment_behind_a_replaced_setting_stays(line: str, comment: str) -> None:
    after = changed(f"[parameters]\n{line}\n", {"parameters": {'"/a#b"': "2"}})
    assert after == f'[parameters]\n"/a#b" = 2{comment}\n'


def test_ends_of_lines_stay_what_they_were(tmp_path: Path) -> None:
    path = tmp_path / "hostlink.toml"
    path.write_bytes(FILE.replace("\n", "\r\n").encode())
    write_settings(path, PARAMETERS)
    assert path.read_bytes().decode() == changed(FILE, PARAMETERS).replace("\n", "\r\n")


def test_a_comment_may_have_what_python_takes_for_an_end_of_a_line() -> None:
    text = f"# a\u2028b\n{FILE}"
    assert changed(text, PARAMETERS).startswith("# a\u2028b\n")


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    file, link = tmp_path / "robots.toml", tmp_path / "hostlink.toml"
    file.write_text(FILE)
    link.symlink_to(file)
    write_settings(link, PARAMETERS)
    assert link.is_symlink()
    assert file.read_text() == changed(FILE, PARAMETERS)


def test_the_file_stays_its_owner_s(tmp_path: Path) -> None:
    path, group = tmp_path / "hostlink.toml", 12345 if os.getuid() == 0 else max(os.getgroups())
    path.write_text(FILE)
    os.chown(path, os.getuid(), group)
    path.chmod(0o640)
    write_settings(path, PARAMETERS)
    assert (path.stat().st_uid, path.stat().st_gid, path.stat().st_mode & 0o777) == (os.getuid(), group, 0o640)


def test_file_that_cannot_be_changed_is_refused_before_the_drives(tmp_path: Path) -> None:
    path = tmp_path / "hostlink.toml"
    path.write_text(FILE)
    require_changeable(path, PARAMETERS)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    assert path.read_text() == FILE
    path.write_text("[parameters]\n'/robot_0/wheel_radius' = 0.045\n")
    with pytest.raises(ConfigError, match="hostlink cannot change this file"):
        require_changeable(path, PARAMETERS)


def test_settings_that_the_daemon_refuses_are_not_kept(tmp_path: Path) -> None:
    path = tmp_path / "hostlink.toml"
    path.write_text(FILE)
    with pytest.raises(ConfigError):
        write_settings(path, {"robots.robot_0.calibration": {"left_factor": "9.0"}})
    assert path.read_text() == FILE


def test_a_file_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is not changed"):
        write_settings(tmp_path / "hostlink.toml", PARAMETERS)


keys = st.sampled_from(["a", "b", '"/robot/x"', '"c d"'])
numbers = st.floats(0.1, 9.0).map(lambda value: f"{value:.3f}")
tables = st.dictionaries(
    st.sampled_from(["parameters", "robots.r.calibration"]), st.dictionaries(keys, numbers, min_size=1)
)


@given(tables, tables)
def test_settings_of_any_earlier_spelling_are_replaced(
    first: dict[str, dict[str, str]], second: dict[str, dict[str, str]]
) -> None:
    after = tomllib.loads(changed(changed(FILE, first), second))
    for header, values in {**first, **second}.items():
        expected = tomllib.loads("\n".join(toml_lines({"t": {**first.get(header, {}), **values}})))["t"]
        table = after
        for name in header.split("."):
            table = table[name]
        assert expected.items() <= table.items()
    assert after["robots"]["robot_0"] == {"max_linear_m_s": 0.3}
