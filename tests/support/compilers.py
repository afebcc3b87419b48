"""Compilers of C++ in tests: warnings that are errors, sanitizers, and the report of a failure."""

import subprocess
from collections.abc import Sequence
from typing import Final

SKETCH_WARNINGS: Final = ("-Wall", "-Wextra", "-Werror")  # where headers of a board's core are included
WARNINGS: Final = (*SKETCH_WARNINGS, "-Wconversion", "-Wshadow", "-Wdouble-promotion")
CORE: Final = ("-std=c++11", "-pedantic-errors", *WARNINGS)  # what runs on every board
SKETCH: Final = ("-std=gnu++11", *SKETCH_WARNINGS)
UNDEFINED: Final = ("-fsanitize=undefined", "-fno-sanitize-recover=all")
SANITIZERS: Final = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def run(command: Sequence[object]) -> str:
    """Run a command and return its output.

    Raises:
        AssertionError: it failed, or it wrote a warning.
    """
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return done.stdout
