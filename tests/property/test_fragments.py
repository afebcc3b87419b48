"""Messages in pieces, in any order."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.gateway.rosbridge import Fragments
from hostlink.core.hub.byte_budget import Share


@given(st.lists(st.text(max_size=5), min_size=1, max_size=20), st.randoms())
def test_any_order_gives_the_message(pieces: list[str], random: object) -> None:
    fragments, order = Fragments(1000, Share(100_000)), list(range(len(pieces)))
    random.shuffle(order)  # type: ignore[attr-defined]
    got = [fragments.add("m", number=at, total=len(pieces), data=pieces[at], now_s=0.0) for at in order]
    assert got == [None] * (len(pieces) - 1) + ["".join(pieces)]
    assert fragments.add("m", number=0, total=1, data="x" * 1000, now_s=0.0) == "x" * 1000  # all pieces were released
