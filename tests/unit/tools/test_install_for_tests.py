"""tools/install_for_tests.py: lanes run side by side, each step is told, and a failure does not end the others."""

import re
import threading

from tools import install_for_tests


def test_lanes_run_side_by_side_and_targets_of_a_lane_in_turn() -> None:
    both_run, made = threading.Barrier(2, timeout=30), []

    def make(target: str) -> bool:
        if target in ("first", "other"):
            both_run.wait()
        made.append(target)
        return True

    results = install_for_tests.install([["first", "second"], ["other"]], make, lambda _: None)
    assert [each.target for each in results] == ["first", "second", "other"]
    assert made.index("first") < made.index("second")


def test_target_that_fails_is_told_and_the_next_one_is_made() -> None:
    said: list[str] = []
    results = install_for_tests.install(
        [["build/ros2-venv/.installed", "next"]], lambda target: target == "next", said.append
    )
    assert [each.is_made for each in results] == [False, True]
    assert [re.sub(r"\d+ s$", "N s", line) for line in said] == [
        "  rclpy and hostlink: about 240 MB ...",
        "  rclpy and hostlink: FAILED after N s",
        "  next: ...",
        "  next: ready after N s",
    ]
