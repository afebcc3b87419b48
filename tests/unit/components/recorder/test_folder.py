"""Folder of the recordings, changed by other programs too."""

import sys
import threading
from pathlib import Path

import pytest

from hostlink.components.recorder.folder import Folder


@pytest.mark.slow
def test_file_removed_while_the_folder_is_read_is_not_listed(tmp_path: Path) -> None:
    folder = Folder(tmp_path, max_disk_mb=1, min_free_disk_mb=0)
    (tmp_path / "stays.mcap").touch()
    is_over = threading.Event()

    def come_and_go() -> None:
        while not is_over.is_set():
            for number in range(50):
                (tmp_path / f"{number}.mcap").touch()
            for number in range(50):
                (tmp_path / f"{number}.mcap").unlink()

    other, interval_s = threading.Thread(target=come_and_go), sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    other.start()
    try:
        for _ in range(2000):
            assert "stays.mcap" in {file.name for file in folder.files()}
    finally:
        sys.setswitchinterval(interval_s)
        is_over.set()
        other.join()
