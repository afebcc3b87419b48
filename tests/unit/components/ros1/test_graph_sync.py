"""Publishers of a topic, named by one master after another."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.ros1.graph_sync import MAX_NAMED, merge_publishers


def test_a_master_that_began_anew_takes_none_away() -> None:
    assert merge_publishers(["http://a/", "http://b/"], ["http://b/", "http://c/"]) == [
        "http://b/",
        "http://c/",
        "http://a/",
    ]


@given(st.lists(st.lists(st.integers(0, 5000).map(str), max_size=MAX_NAMED), max_size=4))
def test_however_often_it_names_others_they_are_bounded_and_the_newest_are_kept(answers: list[list[str]]) -> None:
    known: list[str] = []
    for answered in answers:
        known = merge_publishers(known, answered)
        assert len(known) <= MAX_NAMED
        assert set(answered) <= set(known)
        assert len(set(known)) == len(known)
