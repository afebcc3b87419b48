"""Print what the parts of an installation and other hosts of robots weigh: the tables of docs/weight.md.

python -m tools.measure_weight [--work FOLDER] [--only PART]... [--deb FILE]...

Installs each part into a virtual environment of its own, without pip, and counts its packages and bytes. Debian's
ROS 1 is what apt would add to a minimal Debian 12 with python3, by the sizes that it states.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = ("sim", "export", "ros2", "uvloop", "mdns", "mqtt", "zenoh", "pictures", "lab", "all")
OTHERS = {  # packages of PyPI that take a similar place, and what they are
    "OctoPrint": "octoprint",
    "Moonraker": "moonraker",
    "foxglove-sdk, a server for Foxglove alone": "foxglove-sdk",
    "roslibpy, a client alone": "roslibpy",
}
ROS1 = {  # what rosserial_python needs of Debian: its imports, and with roscore
    "rospy and messages of Debian's ROS 1": ("python3-rospy", "python3-geometry-msgs", "python3-nav-msgs"),
    "the same with roscore": ("python3-rospy", "python3-geometry-msgs", "python3-nav-msgs", "python3-roslaunch"),
}
NOT_MEASURED = {
    "rosserial (rosserial_python, rosserial_server)": "neither on PyPI nor in Debian 12; it needs ROS 1",
    "rosbridge_suite": "neither on PyPI nor in Debian 12; it needs ROS 1 or ROS 2",
    "foxglove_bridge": "neither on PyPI nor in Debian 12; it needs ROS 1 or ROS 2",
}


class Weight(NamedTuple):
    """Size of one installation."""

    packages: int
    megabytes: float  # of 1,000,000 bytes, as files, not as blocks of the disk


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, help="folder of the environments; a temporary one without it")
    parser.add_argument("--only", action="append", choices=("extras", "others", "ros1", "deb"), help="may be repeated")
    parser.add_argument("--deb", action="append", type=Path, default=[], help="Debian package to weigh")
    chosen = parser.parse_args()
    parts = chosen.only or ("extras", "others", "ros1", "deb")
    with tempfile.TemporaryDirectory() as folder:
        work = chosen.work or Path(folder)
        if "extras" in parts:
            print_extras(work)
        if "others" in parts or "ros1" in parts:
            print_others(work, parts)
        if "deb" in parts:
            print_packages(chosen.deb or sorted((ROOT / "build" / "release").glob("*.deb")))
    return 0


def print_extras(work: Path) -> None:
    wheel = built_wheel(work)
    base = installed(work, [str(wheel)])
    print("| installation | packages | MB | more packages | more MB |\n|---|---|---|---|---|")
    print(f"| base | {base.packages} | {base.megabytes:.0f} | | |", flush=True)
    for extra in EXTRAS:
        found = installed(work, [f"{wheel}[{extra}]"])
        more = f"{found.packages - base.packages} | {found.megabytes - base.megabytes:.0f}"
        print(f"| `[{extra}]` | {found.packages} | {found.megabytes:.0f} | {more} |", flush=True)


def print_others(work: Path, parts: Iterable[str]) -> None:
    print("\n| program | packages | MB | measured |\n|---|---|---|---|")
    if "others" in parts:
        for name, package in OTHERS.items():
            try:
                found = installed(work, [package])
            except subprocess.CalledProcessError as error:
                reason = error.stderr.strip().splitlines()[-1] if error.stderr.strip() else "pip failed"
                print(f"| {name} | | | not measured: {reason[:120]} |", flush=True)
            else:
                print(f"| {name} | {found.packages} | {found.megabytes:.0f} | `pip install {package}` |", flush=True)
    if "ros1" in parts:
        for name, packages in ROS1.items():
            found = debian_closure(packages)
            print(f"| {name} | {found.packages} | {found.megabytes:.0f} | apt, `{' '.join(packages)}` |", flush=True)
    for name, reason in NOT_MEASURED.items():
        print(f"| {name} | | | not measured: {reason} |")


def print_packages(debs: Iterable[Path]) -> None:
    print("\n| Debian package | to download, MB | installed, MB |\n|---|---|---|")
    for deb in debs:
        text = output("dpkg-deb", "--field", str(deb), "Installed-Size")
        print(f"| {deb.name} | {deb.stat().st_size / 1e6:.0f} | {int(text) * 1024 / 1e6:.0f} |")


def built_wheel(work: Path) -> Path:
    """Build the wheel of this checkout."""
    folder = work / "wheel"
    shutil.rmtree(folder, ignore_errors=True)
    output(sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder))
    (wheel,) = folder.glob("*.whl")
    return wheel


def installed(work: Path, requirements: list[str]) -> Weight:
    """Install requirements into an empty environment without pip, and weigh it with its compiled files.

    Raises:
        subprocess.CalledProcessError: pip fails.
    """
    venv = work / "venv"
    shutil.rmtree(venv, ignore_errors=True)
    output(sys.executable, "-m", "venv", "--without-pip", str(venv))
    python = str(venv / "bin" / "python")
    words = ["--python", python, "install", "--quiet", "--disable-pip-version-check", "--prefer-binary"]
    output(sys.executable, "-m", "pip", *words, *requirements)
    packages = len(list(venv.glob("lib/python*/site-packages/*.dist-info")))
    sizes = (file.lstat().st_size for file in venv.rglob("*") if file.is_file() and not file.is_symlink())
    found = Weight(packages, sum(sizes) / 1e6)
    shutil.rmtree(venv)
    return found


def debian_closure(names: Iterable[str]) -> Weight:
    """Return the packages that apt would add to a Debian that has python3, by the sizes that it states."""
    found = sorted(apt_installs(names) - apt_installs(["python3"]))
    total = count = 0
    for text in output("apt-cache", "show", "--no-all-versions", *found).split("\n\n"):
        fields = dict(line.split(": ", 1) for line in text.splitlines() if ": " in line and not line.startswith(" "))
        is_minimal = fields.get("Essential") == "yes" or fields.get("Priority") in ("required", "important")
        if "Package" in fields and not is_minimal:
            count += 1
            total += int(fields.get("Installed-Size", "0")) * 1024
    return Weight(count, total / 1e6)


def apt_installs(names: Iterable[str]) -> set[str]:
    """Return the packages that apt would install where there is none."""
    words = ("install", "--simulate", "--no-install-recommends", "-o", "Dir::State::status=/dev/null")
    lines = output("apt-get", *words, *names).splitlines()
    return {line.split()[1] for line in lines if line.startswith("Inst ")}


def output(*words: str) -> str:
    return subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True).stdout


if __name__ == "__main__":
    sys.exit(main())
