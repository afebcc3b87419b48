"""Screen of top: robots first in any size, colours, scrolling and orders."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.cli.driving import Action, Key
from hostlink.cli.figures import figures
from hostlink.cli.teleop_screen import RED, YELLOW, Line
from hostlink.cli.top_screen import ORDERS, SILENT_S, TopScreen
from tests.unit.cli.test_figures import link, robot, sample

URL = "http://127.0.0.1:9090"


def odometry(speed_m_s: float = 0.0, age_s: float = 0.1) -> dict[str, Any]:
    return {
        "pose": {"x_m": 0.0, "y_m": 0.0, "theta_rad": 0.0},
        "twist": {"linear_m_s": speed_m_s, "angular_rad_s": 0.0},
        "rate_hz": 10.0,
        "age_s": age_s,
    }


ROBOTS = [
    robot(name="robot_10", odometry=odometry(0.1)),
    robot(name="robot_2", odometry=odometry(-0.3), locked=True),
    robot(name="robot_3", odometry=odometry(0.0, 2 * SILENT_S)),
    robot(name="robot_4", link=None),
]


def shown(*links: int, robots: list[dict[str, Any]] | None = None) -> dict[str, Any]:
    return figures(sample(10.0), sample(12.0, *map(link, links), robots=ROBOTS if robots is None else robots))


def names(lines: list[Line]) -> list[str]:
    return [line.text.split()[0] for line in lines if line.text.startswith("robot_")]


def test_robots_are_first_at_40_columns_and_12_lines() -> None:
    lines = TopScreen(URL).lines(shown(1, 2), 40, 12)
    assert len(lines) == 12
    assert lines[1].text.split() == ["robot", "link", "driven", "by", "m/s", "age", "s"]
    assert names(lines) == ["robot_2", "robot_3", "robot_4", "robot_10"]
    assert lines[-1].text.endswith("; arrows scroll")


def test_a_wide_terminal_has_every_column() -> None:
    heads = TopScreen(URL).lines(shown(1), 200, 40)[1].text
    assert all(name in heads for name in ("link", "rad/s", "x m", "y m", "deg", "Hz"))


def test_locked_is_red_and_silent_is_yellow() -> None:
    lines = TopScreen(URL).lines(shown(1), 100, 40)
    colours = {line.text.split()[0]: line.colour for line in lines if line.text.startswith("robot_")}
    assert colours == {"robot_2": RED, "robot_3": YELLOW, "robot_4": YELLOW, "robot_10": ""}


def test_a_robot_in_several_lines_has_one_colour() -> None:
    lines = TopScreen(URL).lines(shown(1, robots=ROBOTS[1:2]), 22, 40)
    assert len([line for line in lines if line.colour == RED]) > 1


@pytest.mark.parametrize(
    ("presses", "wanted"),
    [
        (1, ["robot_2", "robot_3", "robot_4", "robot_10"]),  # state
        (2, ["robot_2", "robot_10", "robot_3", "robot_4"]),  # speed
        (3, ["robot_4", "robot_3", "robot_2", "robot_10"]),  # age
        (4, ["robot_2", "robot_3", "robot_4", "robot_10"]),  # name
    ],
)
def test_the_order_key_takes_the_next_order(presses: int, wanted: list[str]) -> None:
    screen = TopScreen(URL)
    for _ in range(presses):
        screen.press(Key("s"))
        screen.press(Key("s", Action.RELEASED))
    lines = screen.lines(shown(1), 100, 40)
    assert names(lines) == wanted
    assert lines[0].text.startswith(f"hostlink top by {list(ORDERS)[presses % len(ORDERS)]} ")


def test_keys_scroll_to_the_end_and_no_farther() -> None:
    screen, figures_shown = TopScreen(URL), shown(*range(30))
    first = screen.lines(figures_shown, 200, 12)
    assert first[-1].text == "29 lines more below, 0 above; arrows scroll"
    screen.press(Key("down"))
    assert screen.lines(figures_shown, 200, 12)[1:-2] == first[2:-1]
    for _ in range(9):
        screen.press(Key("space"))
    last = screen.lines(figures_shown, 200, 12)
    assert last[-2].text == "no findings"
    assert last[-1].text == "0 lines more below, 29 above; arrows scroll"
    screen.press(Key("up"))
    assert screen.lines(figures_shown, 200, 12)[-1].text == "1 lines more below, 28 above; arrows scroll"
    for _ in range(9):
        screen.press(Key("b"))
    assert screen.lines(figures_shown, 200, 12) == first
    assert screen.lines(figures_shown, 200, 60)[-1].text == "no findings"


@given(
    st.integers(1, 250), st.integers(1, 60), st.lists(st.sampled_from(["down", "up", "space", "b", "s"]), max_size=9)
)
def test_any_size_and_keys_give_lines_that_fit(columns: int, rows: int, keys: list[str]) -> None:
    screen = TopScreen(URL)
    for key in keys:
        screen.press(Key(key))
        lines = screen.lines(shown(1, 2, 3), columns, rows)
        assert len(lines) <= max(rows, 3)
        assert all(len(line.text) <= max(columns - 1, 1) for line in lines[1:-1])


def test_names_are_shown_without_control_codes() -> None:
    lines = TopScreen(URL).lines(shown(1, robots=[robot(name="\x1b]0;x\x07\x1b[2J")]), 100, 40)
    assert all(line.text.isprintable() for line in lines)
    assert any("\\u001b]0;x" in line.text for line in lines)


def test_a_daemon_without_robots_says_so() -> None:
    assert Line("no robot has connected") in TopScreen(URL).lines(shown(1, robots=[]), 100, 40)
