"""A daemon without a certificate in the network of a fleet that has some: nothing finds it, and it finds nothing."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
NAMESPACE = ("unshare", "--user", "--map-root-user", "--net")
TIMEOUT_S = 90.0


@pytest.mark.parametrize("way", ["multicast", pytest.param("gossip", marks=pytest.mark.long)])
def test_a_daemon_without_a_certificate_neither_finds_the_fleet_nor_is_found(way: str, tmp_path: Path) -> None:
    program = (sys.executable, "-m", "tests.support.zenoh_strangers", way, str(tmp_path))
    ended = subprocess.run(
        [*NAMESPACE, *program], capture_output=True, text=True, check=False, timeout=TIMEOUT_S, cwd=ROOT
    )
    assert ended.returncode == 0, ended.stderr[-2000:]
    found = json.loads(ended.stdout.splitlines()[-1])
    assert found == {"listeners": ["tcp 0100500A:1D17"], "is_seen": False, "obeyed": 0}  # 10.80.0.1:7447
