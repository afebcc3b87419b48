"""Read recordings in Python.

import hostlink.recording

run = hostlink.recording.read("run.mcap")
plot(run["/robot_0/odometry"].time_s, run["/robot_0/odometry"]["x"])
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hostlink.components.recorder.tables import Table, Tables, read

__all__ = ["Table", "Tables", "read"]


def __getattr__(name: str) -> object:
    """Import on first use, because the daemon records without numpy and without a reader."""
    if name in __all__:
        from hostlink.components.recorder import tables  # noqa: PLC0415 - see above

        return getattr(tables, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
