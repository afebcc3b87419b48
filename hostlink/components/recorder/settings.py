"""Settings of the recorder: the tables [recording] and [black_box] of hostlink.toml."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingConfig:
    """Folder of recordings, and its limits."""

    folder: Path | None = None  # None: the state folder of a service or of the user
    max_disk_mb: float = 4096.0  # of all recordings; above it the oldest are removed
    min_free_disk_mb: float = 256.0  # below it a recording ends, because a full disk harms other programs
    max_file_mb: float = 512.0  # afterwards a new file is started
    max_file_s: float = 3600.0
    fsync: bool = False  # sync each second to the disk: survives a power failure, and wears out SD cards
    drives: bool = True  # log in this folder who drove which robot, and when

    def __post_init__(self) -> None:
        if min(self.max_disk_mb, self.max_file_mb, self.max_file_s) <= 0:
            raise ValueError("max_disk_mb, max_file_mb and max_file_s must be more than zero")


@dataclass(frozen=True, slots=True, kw_only=True)
class BlackBoxConfig:
    """Black box: the last minutes of every robot, saved after an incident."""

    enabled: bool = True
    before_s: float = 120.0
    after_s: float = 30.0
    max_memory_mb: float = 32.0  # of all robots
    max_disk_mb: float = 512.0  # of all incidents, in the folder of the recordings; above it the oldest are removed

    def __post_init__(self) -> None:
        if min(self.before_s, self.max_memory_mb, self.max_disk_mb) <= 0 or self.after_s < 0:
            raise ValueError("before_s, max_memory_mb and max_disk_mb must be more than zero, after_s not less")
