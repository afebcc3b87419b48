"""Let an earlier version write the settings and the state of a daemon, for tests/system/test_upgrade.py.

python -m tools.state_of TREE FOLDER

TREE is a checked-out tree of that version (`git worktree add TREE COMMIT`). Its daemon serves a simulated robot that is
driven, recorded and locked, so that FOLDER has a recording, the list of drives, an incident and the settings.
"""

import argparse
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.support.process import free_port

TIMEOUT_S = 60.0
RECORD_S = 2.0
SETTINGS = """\
[recording]
folder = "recordings"
min_free_disk_mb = 0

[black_box]
before_s = 3.0
after_s = 0.5

[robots.robot_0]
address = "127.0.0.1"
max_linear_m_s = 0.3
max_angular_rad_s = 2.0

[parameters]
"/robot_0/wheel_separation" = 0.2143
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tree", type=Path)
    parser.add_argument("folder", type=Path)
    chosen = parser.parse_args()
    shutil.rmtree(chosen.folder, ignore_errors=True)
    chosen.folder.mkdir(parents=True)
    write_state(chosen.tree.resolve(), chosen.folder.resolve())
    for file in sorted(chosen.folder.rglob("*")):
        print(f"{file.relative_to(chosen.folder)}: {file.stat().st_size} bytes")


def write_state(tree: Path, folder: Path) -> None:
    """Run a daemon of that tree until its folder has one of each."""
    (folder / "hostlink.toml").write_text(SETTINGS)
    environment = os.environ | {"PYTHONPATH": str(tree)}
    host, api = f"127.0.0.1:{free_port()}", f"127.0.0.1:{free_port()}"
    words = [sys.executable, "-m", "hostlink"]
    url = ("--url", f"http://{api}")

    def ask(*arguments: str) -> Any:
        command = [*words, *arguments, *url]
        done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, check=False)
        return done.stdout if done.returncode == 0 else None

    @contextlib.contextmanager
    def running(*arguments: str, end: signal.Signals = signal.SIGTERM) -> Iterator[None]:
        process = subprocess.Popen([*words, *arguments], cwd=tree, env=environment, stderr=subprocess.DEVNULL)
        try:
            yield
        finally:
            process.send_signal(end)
            process.wait(TIMEOUT_S)

    settings = ("--config", str(folder / "hostlink.toml"))
    with running("serve", *settings, "--listen", host, "--api", api), running("sim", "--connect", host):
        until(lambda: "robot_0" in (ask("robots", "--json") or ""))
        with running("pub", "/robot_0/cmd_vel", '{"linear": {"x": 0.1}}', "--count", "0", "--rate", "10", *url):
            until(lambda: ask("record", "--seconds", str(RECORD_S)) is not None)
        ask("lock")
        until(lambda: list(json.loads(ask("incidents", "--json") or "[]")))
        time.sleep(RECORD_S)  # the incident is saved after_s later
        ask("unlock")


def until(is_done: Any) -> None:
    deadline_s = time.monotonic() + TIMEOUT_S
    while not is_done():
        if time.monotonic() > deadline_s:
            raise TimeoutError("the earlier daemon does not what is asked")
        time.sleep(0.2)


if __name__ == "__main__":
    main()
