"""`python -W error -c CODE` for fork_parent.py: the client is imported, and CODE is the only argument."""

import sys
import warnings

from hostlink import client

IMPORTED = (client,)


def main() -> None:
    """Run the code as the main program."""
    warnings.simplefilter("error")
    exec(compile(sys.argv[1], "<string>", "exec"), {"__name__": "__main__"})  # noqa: S102 - code of the documents
