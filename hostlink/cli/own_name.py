"""The words that start this program, for commands that a user is asked to type."""

import os
import shlex
import shutil
import sys
from pathlib import Path

NAME = "hostlink"


def own_name(program: str | None = None, folder: Path | None = None) -> str:
    """Return `hostlink` if the shell finds this program by it, else its path, as `.venv/bin/hostlink` in a clone.

    `program`: its path; `folder`: in which the user types.
    """
    program, folder = sys.argv[0] if program is None else program, Path.cwd() if folder is None else folder
    found, own = shutil.which(NAME), folder / program
    if own.name != NAME or not os.access(own, os.X_OK) or (found is not None and Path(found).samefile(own)):
        return NAME
    place = own.absolute()
    return shlex.quote(str(place.relative_to(folder) if place.is_relative_to(folder) else place))
