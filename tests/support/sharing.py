"""Which tests go to one worker of pytest-xdist."""

from xdist.scheduler import LoadScopeScheduling

SHARING = ("test_diagnoses.py", "test_page.py", "test_page_states.py")  # their tests share a daemon or a browser


class FilesThatShare(LoadScopeScheduling):
    """Each test goes to the next free worker; the tests of a file that share a fixture stay together.

    The `loadgroup` of pytest-xdist 3.8 has no effect beside pytest 9.2.
    """

    def _split_scope(self, nodeid: str) -> str:
        path = nodeid.partition("::")[0]
        return path if path.endswith(SHARING) else nodeid
