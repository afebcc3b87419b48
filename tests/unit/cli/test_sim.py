"""`hostlink sim`: a world that is read, or refused with its line; and what is said without wasmtime."""

import platform
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hostlink.cli import calibrate, demo, lab, sim
from hostlink.errors import ConfigError


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"track_m=0.2\ntrack=0.2\n", "line 2: track: no such parameter; meant track_m?"),
        (b"track_m=wide\n", "line 1: 'track_m=wide' is not of the form name=number"),
        (b"left.radius_m=0\n", "line 1: left.radius_m: 0 is not in 1e-06..10"),
        (b"\xff\x00", "'utf-8' codec can't decode byte 0xff in position 0: invalid start byte; save it as UTF-8"),
        (None, "No such file or directory"),
    ],
)
def test_invalid_world_is_refused_with_its_line(tmp_path: Path, content: bytes | None, reason: str) -> None:
    file = tmp_path / "world.txt"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ConfigError) as refused:
        sim.command(world=file)
    assert str(refused.value) == f"--world: {file}: {reason}"


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"world": Path("w")}, "--world: a robot of --kinematics has no motors and no floor; leave out one of the two"),
        (
            {"fault": "stalled_wheel"},
            "--fault: stalled_wheel is a fault of a motor, which a robot of --kinematics does not have",
        ),
        ({"fault": "rust"}, "--fault: unknown fault 'rust'; choose one of "),
    ],
)
def test_options_of_the_firmwares_world_are_refused_for_another_drive(options: dict[str, Any], reason: str) -> None:
    with pytest.raises(ConfigError) as refused:
        sim.command(kinematics="mecanum", **options)
    assert str(refused.value).startswith(reason)


STARTS: dict[str, Callable[[], None]] = {
    "hostlink sim": sim.command,
    "hostlink demo": demo.command,
    "hostlink lab": lambda: lab.command("tables"),
    "--simulate": lambda: calibrate.command("robot_0", simulate=True),
}


@pytest.mark.parametrize(
    ("machine", "advice"),
    [
        (
            "aarch64",
            "needs wasmtime, of the extra 'sim': "
            f"run  {shlex.quote(sys.executable)} -m pip install 'wasmtime<100,>=38'",
        ),
        ("armv7l", "needs wasmtime, which has no library for armv7l: run it on x86_64 or arm64"),
    ],
)
@pytest.mark.parametrize("where", STARTS)
def test_simulation_without_wasmtime_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, where: str, machine: str, advice: str
) -> None:
    monkeypatch.setitem(sys.modules, "wasmtime", None)
    monkeypatch.setattr(platform, "machine", lambda: machine)
    with pytest.raises(ConfigError) as error:
        STARTS[where]()
    assert str(error.value) == f"{where}: {advice}"
