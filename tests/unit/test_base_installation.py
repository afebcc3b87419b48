"""Base installation: the daemon, the recorder and the client run without any extra; others name theirs."""

import struct
import subprocess
import sys

import pytest

from hostlink.errors import LibraryMissing, requirements_of

EXTRAS = (
    "aiomqtt",
    "apsw",
    "lz4",
    "matplotlib",
    "rosbags",
    "uvloop",
    "wasmtime",
    "xxhash",
    "zenoh",
    "zeroconf",
)
# An import of None fails like that of a module that is not installed, and find_spec does not find it.
WITHOUT = f"import sys; sys.modules.update(dict.fromkeys({EXTRAS!r}))\n"


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", WITHOUT + code], capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_daemon_recorder_and_client_load_without_the_extras() -> None:
    modules = (
        "hostlink.cli.serve, hostlink.cli.check, hostlink.cli.record, hostlink.cli.play, hostlink.cli.topics, "
        "hostlink.cli.export, hostlink.components.recorder.salvage, hostlink.components.recorder.export, "
        "hostlink.client, hostlink.components.ros1.node, hostlink.board.library"
    )
    done = run(f"import {modules}; hostlink.core.messages.catalog.Catalog().message('nav_msgs/Odometry').md5")
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "library", "extra"),
    [
        (["ros2"], "ros2: needs rosbags", "ros2"),
        (["export", "none.mcap", "--to", "ros1"], "--to ros1: needs rosbags", "export"),
        (["export", "none.bag", "--to", "csv"], "none.bag: needs rosbags", "export"),
        (["plot", "none.mcap", "/odom.x"], "plot: needs matplotlib", "plot"),
    ],
)
def test_command_without_its_extra_names_the_installation(command: list[str], library: str, extra: str) -> None:
    done = run(f"sys.argv = ['hostlink', *{command!r}]\nfrom hostlink.cli.start import main\nmain()")
    advice = str(LibraryMissing(library.partition(":")[0], library.rpartition(" ")[2], extra))
    assert (done.returncode, done.stdout) == (2, "")
    assert advice in done.stderr.replace("\n", " ")


def test_chunk_compressed_with_lz4_names_the_extra_that_reads_it() -> None:
    chunk = struct.pack("<QQQI", 0, 0, 3, 0) + struct.pack("<I3sQ3s", 3, b"lz4", 3, b"abc")
    done = run(f"from hostlink.components.recorder.mcap_format import unpack_chunk\nunpack_chunk({chunk!r}, 100)")
    assert "Damaged: needs lz4, of the extra 'export': run" in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(sys.version_info >= (3, 14), reason="zstd is part of Python 3.14")
def test_recordings_without_zstd_name_the_installation() -> None:
    block = "sys.modules.update({'backports.zstd': None})\n"
    done = run(f"{block}sys.argv = ['hostlink', 'info', 'none.mcap']\nfrom hostlink.cli.start import main\nmain()")
    assert done.returncode == 2
    wanted = (
        f"recordings: needs backports.zstd, which is not installed: run  {sys.executable} -m pip install backports.zstd"
    )
    assert wanted in done.stderr.replace("\n", " ")
    assert "Traceback" not in done.stderr


def test_advice_is_a_command_with_the_requirements_of_the_extra() -> None:
    assert requirements_of("export") == ["rosbags<0.12,>=0.10"]
    assert requirements_of("no such extra") == []
    advice = str(LibraryMissing("here", "rosbags", "export"))
    wanted = f"{sys.executable} -m pip install 'rosbags<0.12,>=0.10'"
    assert advice == f"here: needs rosbags, of the extra 'export': run  {wanted}"


def test_advice_in_the_debian_package_is_the_wheel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "prefix", "/usr/lib/hostlink")
    advice = str(LibraryMissing("plot", "matplotlib", "plot"))
    assert advice.endswith("the Debian package does not have it; install the wheel with pip")
    advice = str(LibraryMissing("recordings", "backports.zstd", ""))
    assert advice.endswith("which is not installed: run  sudo apt install --reinstall hostlink")
