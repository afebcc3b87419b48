"""Tests that run in one worker of pytest-xdist."""

from xdist.scheduler import LoadScopeScheduling  # type: ignore[import-untyped]

SHARING = (  # their tests share what is slow to make: a daemon, a compiled program, a large file, all parsed sources
    "test_board_headers.py",
    "test_board_library.py",
    "test_diagnoses.py",
    "test_large_recordings.py",
    "test_page.py",
    "test_page_firefox.py",
    "test_words.py",
)


class FilesThatShare(LoadScopeScheduling):  # type: ignore[misc]
    """Scheduler that gives each test to the next free worker; tests of a file that share a fixture stay together.

    The `loadgroup` of pytest-xdist 3.8 has no effect with pytest 9.2.
    """

    def _split_scope(self, nodeid: str) -> str:
        path = nodeid.partition("::")[0]
        return path if path.endswith(SHARING) else nodeid
