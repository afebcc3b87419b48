"""Counts of a micro-ROS board over bad links: the bounds, and the tables of docs/micro-ros.md."""

from random import Random

import pytest

from tools.micro_ros_tables import BEGIN, DOCUMENT, END, SEED, drive, equal_boards, text, written

DICE = Random("loss")
SEEDS = [DICE.randrange(10**6) for _ in range(8)]


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_loss_of_5_percent_at_20_hz_blocks_no_publish_and_ages_no_command(seed: int) -> None:
    found = drive(seed, loss=0.05)
    assert found.failed == 0
    assert found.longest_s <= 0.3
    assert found.p99_s < 0.25
    assert found.stood_s < 0.5


@pytest.mark.slow
def test_two_boards_with_one_client_key_are_commanded_one_by_one() -> None:
    driven, other = equal_boards(SEED)
    assert driven.taken > 0.9 * driven.commanded
    assert driven.zeros > 0
    assert (other.taken, other.zeros) == (0, 0)
    assert driven.failed == other.failed == 0


def test_row_of_5_percent_at_20_hz_is_the_one_in_the_document() -> None:
    row = " | ".join(drive(SEED, loss=0.05).cells)
    assert f"| 5 % | 20 Hz | {row} |" in DOCUMENT.read_text()


@pytest.mark.long
def test_tables_in_the_document_are_those_that_the_tool_prints() -> None:
    document = DOCUMENT.read_text()
    assert document.count(BEGIN) == document.count(END) == 1
    assert written(document, text()) == document
