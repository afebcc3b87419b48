"""`hostlink` for fork_parent.py: every command is imported, and a process ends without freeing what it shares."""

import atexit
import contextlib
import gc
import importlib
import io
import os
import sys
import threading
import traceback
from typing import NoReturn

from hostlink.cli import main as command_line
from hostlink.core.messages.catalog import Catalog
from hostlink.workbench.sim import firmware_module


def main() -> NoReturn:
    """Run and end as the interpreter does, but free nothing: that would copy every page that the parent shares."""
    status = 0
    try:
        command_line.main()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:  # noqa: BLE001 - the process ends with it
        traceback.print_exc()
        status = 1
    gc.collect()  # reports of objects that were not closed
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for output in (sys.stdout, sys.stderr):
        try:
            output.flush()
        except OSError:
            status = 120  # as of the interpreter
    os._exit(status)


def _import_everything() -> None:
    for command in command_line.COMMANDS:
        importlib.import_module(command_line.module_of(command))
    for late in ("serve", "ros1_parameters"):  # which commands import when they run
        importlib.import_module(f"hostlink.cli.{late}")
    Catalog()
    firmware_module._compiled()  # for simulated robots
    sys.argv = ["hostlink", "serve", "--example", "config"]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        command_line.main()


_import_everything()
