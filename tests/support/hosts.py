"""The interface of a component, and the parts that use it, in a hub of a test."""

from collections import Counter
from pathlib import Path

from hostlink.components.recorder.black_box import BlackBox
from hostlink.components.recorder.recordings import Recordings
from hostlink.components.recorder.settings import BlackBoxConfig, RecordingConfig
from hostlink.core.host import Host
from hostlink.core.hub.hub import Hub


def host_in(hub: Hub, name: str = "test") -> Host:
    """Make one that runs no tasks."""
    return Host(hub, name, lambda work, _, **__: work.close(), Counter())


def host_of(hub: Hub, name: str = "test") -> Host:
    """Make one whose tasks the hub runs."""
    return Host(hub, name, lambda work, part, **_: hub.spawn(work, name=part), Counter())


def recordings_of(hub: Hub) -> Recordings:
    """Make the recordings of a daemon with the hub's settings."""
    return Recordings(
        host_of(hub, "recorder"),
        hub.config.table("recording", RecordingConfig),
        hub.config.table("black_box", BlackBoxConfig),
    )


def black_box_of(hub: Hub, folder: Path) -> BlackBox:
    """Make the black box of a daemon with the hub's settings."""
    free_mb = hub.config.table("recording", RecordingConfig).min_free_disk_mb
    return BlackBox(
        host_of(hub, "recorder"), hub.config.table("black_box", BlackBoxConfig), folder, min_free_disk_mb=free_mb
    )
