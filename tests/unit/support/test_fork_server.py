"""tests/support/fork_server.py: copies of one parent fork the same program, each for its own process."""

import os
from pathlib import Path

from tests.support.fork_server import ForkServer, Program


def test_copies_of_a_parent_fork_its_program_and_report_its_end(tmp_path: Path) -> None:
    file = tmp_path / "noting.py"
    file.write_text("import os, sys\nIMPORTED_BY = os.getpid()\ndef main():\n    sys.exit(int(sys.argv[1]))\n")
    original = ForkServer(Program("noting", str(file)))
    copies = [ForkServer(original.program, original) for _ in range(2)]
    with open(os.devnull, "r+b") as nothing:  # noqa: PTH123 - a device
        for number, copy in enumerate(copies):
            copy.await_ready()
            files = (nothing.fileno(),) * 3
            pid = copy.fork([str(number + 3)], files, os.environ)
            assert copy.wait(pid) == number + 3
    for each in (*copies, original):
        each.close()
