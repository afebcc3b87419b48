"""Disk budget: recordings that are removed when there is no room."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.recorder.folder import StoredFile, over_budget

FILES = st.lists(
    st.builds(
        StoredFile,
        name=st.text("abc", min_size=1, max_size=8),
        size_bytes=st.integers(0, 1000),
        modified_s=st.floats(0, 1e6),
        is_open=st.booleans(),
    ),
    unique_by=lambda file: file.name,
)


def test_oldest_recording_is_removed_first() -> None:
    files = [StoredFile("new", 40, 3.0), StoredFile("old", 40, 1.0), StoredFile("middle", 40, 2.0)]
    assert over_budget(files, 100) == ["old"]
    assert over_budget(files, 50) == ["old", "middle"]
    assert over_budget(files, 120) == []


def test_open_recording_is_kept() -> None:
    files = [StoredFile("open", 90, 1.0, is_open=True), StoredFile("new", 40, 3.0)]
    assert over_budget(files, 100) == ["new"]


@given(FILES, st.integers(0, 5000))
def test_kept_files_fit_or_are_open_and_no_other_is_removed(files: list[StoredFile], budget_bytes: int) -> None:
    gone = over_budget(files, budget_bytes)
    kept = [file for file in files if file.name not in gone]
    sizes = {file.name: file.size_bytes for file in files}
    total = sum(file.size_bytes for file in kept)
    assert total <= budget_bytes or all(file.is_open for file in kept)
    assert not any(file.is_open for file in files if file.name in gone)
    if gone:
        assert total + sizes[gone[-1]] > budget_bytes
