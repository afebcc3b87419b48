"""Work that is done once for all workers of a test run, such as compiling firmware."""

import fcntl
import os
from collections.abc import Callable
from pathlib import Path

BUILD = Path(__file__).resolve().parents[2] / "build"


def once_a_run(name: str, make: Callable[[], object]) -> None:
    """Call `make` in the first worker; the others wait for it. It is repeated where it failed."""
    BUILD.mkdir(exist_ok=True)
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid()))
    with (BUILD / f"{name}.made").open("a+") as made:
        fcntl.flock(made, fcntl.LOCK_EX)
        made.seek(0)
        if made.read() != run:
            make()
            made.truncate(0)
            made.write(run)
