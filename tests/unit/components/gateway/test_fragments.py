"""Fragments: joined in any order, bounded in every way."""

import pytest

from hostlink.components.gateway.rosbridge import MAX_PENDING, MAX_PIECES, TIMEOUT_S, Fragments
from hostlink.core.hub.byte_budget import Share
from hostlink.errors import BadRequest


@pytest.mark.parametrize(
    ("number", "total", "data", "reason"),
    [
        (0, 0, "", "total must be from 1"),
        (0, MAX_PIECES + 1, "", f"total must be from 1 to {MAX_PIECES}"),
        (3, 3, "", "num must be from 0 to 2"),
        (1, 4, "", "total was 3 and is 4"),
        (0, 3, "", "fragment 0 was sent twice"),
        (1, 3, "ä" * 50, "more than 100 bytes of fragments"),
    ],
)
def test_invalid_fragment_drops_its_message(number: int, total: int, data: str, reason: str) -> None:
    fragments = Fragments(100, Share(100_000))
    fragments.add("m", number=0, total=3, data="x", now_s=0.0)
    with pytest.raises(BadRequest, match=reason):
        fragments.add("m", number=number, total=total, data=data, now_s=0.0)
    assert fragments.add("m", number=0, total=1, data="y" * 100, now_s=0.0) == "y" * 100


def test_incomplete_messages_are_bounded_and_expire() -> None:
    fragments = Fragments(100, Share(100_000))
    for number in range(MAX_PENDING):
        fragments.add(number, number=0, total=2, data="x" * 20, now_s=0.0)
    with pytest.raises(BadRequest, match="more than 4 messages are incomplete"):
        fragments.add("late", number=0, total=2, data="", now_s=TIMEOUT_S - 1)
    assert fragments.add("late", number=0, total=1, data="z" * 100, now_s=TIMEOUT_S) == "z" * 100
