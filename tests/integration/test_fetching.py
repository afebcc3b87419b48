"""A file of the daemon that a command puts here."""

from pathlib import Path

import pytest

from hostlink.cli.files import fetch
from hostlink.client import connect
from hostlink.components.recorder.settings import RecordingConfig
from hostlink.core.config import Config
from hostlink.errors import HostlinkError
from tests.support.daemon import daemon


async def test_file_that_another_program_wrote_meanwhile_is_kept(tmp_path: Path) -> None:
    """Two who record into one file both found its name free when they began."""
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings" / "run.mcap").write_bytes(b"of the daemon")
    target = tmp_path / "run.mcap"
    config = Config().with_tables(recording=RecordingConfig(folder=tmp_path / "recordings"))
    async with daemon(config) as host, connect(host.url) as program:
        await fetch(program, "/api/recordings/run.mcap", target)
        assert target.read_bytes() == b"of the daemon"
        target.write_bytes(b"of somebody else")
        with pytest.raises(HostlinkError, match="File exists; the daemon still has the recording"):
            await fetch(program, "/api/recordings/run.mcap", target)
    assert target.read_bytes() == b"of somebody else"
