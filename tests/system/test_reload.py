"""`hostlink reload` and SIGUSR1, with a daemon in its own process."""

import json
import signal
from pathlib import Path

from tests.support.process import run, serve


async def test_a_file_is_read_again_by_a_command_and_by_a_signal(tmp_path: Path) -> None:
    file = tmp_path / "hostlink.toml"
    file.write_text("")
    async with serve("--config", str(file)) as daemon:
        words = ("reload", "--url", daemon.url)
        assert await run(*words) == (0, "nothing has changed\n", "")
        file.write_text("[robots.rover]\nmax_linear_m_s = 0.2\n[tcp]\nmax_connections = 7\n")
        changed = "changed: robots.rover.max_linear_m_s\nneeds a restart: tcp.max_connections\n"
        assert await run(*words) == (0, changed, "")
        file.write_text("[robots.rover]\nmax_linear_m_s = 0.3\n")
        daemon.child.send_signal(signal.SIGUSR1)
        reloaded = await daemon.read_log("config.reloaded")
        assert reloaded["changed"] == ["robots.rover.max_linear_m_s"]
        assert json.loads((await run(*words, "--json"))[1]) == {"changed": [], "needs_restart": [], "renamed": {}}
        file.write_text("[robots.rover]\nmax_linear = 0.2\n")
        daemon.child.send_signal(signal.SIGUSR1)
        assert "max_linear" in (await daemon.read_log("config.refused"))["reason"]
        status, _, complaint = await run(*words)
        assert status == 1
        assert complaint.count("\n") == 1
        assert "max_linear" in complaint
        assert await daemon.end(signal.SIGTERM) == 0
