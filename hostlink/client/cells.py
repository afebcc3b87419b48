"""End of a notebook's cell: the robots that it drove stop. IPython and Jupyter catch its errors, and report the end."""

import concurrent.futures
import sys
import weakref
from typing import Any, Protocol

STOP_TIMEOUT_S = 1.5  # of all connections together

Names = concurrent.futures.Future[tuple[str, ...]]


class Connection(Protocol):
    """Interface of a connection that drives robots."""

    def end_cell(self, *, has_failed: bool) -> Names | None:
        """Stop what the cell drove without `keep`; after an error, everything. Return the names of the robots.

        None: there is no connection.
        """
        ...


watched: weakref.WeakSet[Connection] = weakref.WeakSet()  # the ends of cells are reported to these
_shells: weakref.WeakSet[Any] = weakref.WeakSet()


def watch_cells(connection: Connection) -> None:
    """Report the ends of cells to a connection, as long as it exists. Do nothing in another program."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    if shell is None:
        return
    watched.add(connection)
    if shell not in _shells:
        _shells.add(shell)
        shell.events.register("post_run_cell", _end_cell)


def _end_cell(result: Any) -> None:
    """Handle IPython's event. `result` is None for a cell that was cancelled."""
    has_failed = result is None or not result.success
    begun = [connection.end_cell(has_failed=has_failed) for connection in list(watched)]
    done, _ = concurrent.futures.wait([stop for stop in begun if stop is not None], timeout=STOP_TIMEOUT_S)
    names = [name for stop in done if not stop.cancelled() and stop.exception() is None for name in stop.result()]
    if names and not has_failed:
        sys.stderr.write(
            f"{', '.join(names)} stopped at the end of the cell; "
            "drive(..., for_s=2) drives for a time, drive(..., keep=True) over cells\n"
        )
