"""`make release`: wheels, source distribution and Debian packages, and whether a user who has only them can work.

Builds them into build/release, checks what is in them, installs the wheel into an empty virtual environment for each
Python that is found (and the source distribution for the first), and there runs the demo: a robot appears, drives,
and is stopped when the daemon ends. A compiled wheel of this computer's architecture is installed, driven and
uninstalled too; pip must choose it where it fits, and the pure wheel for everyone else. The packages of Debian 12 and
13 for this computer's architecture are unpacked, and their virtual environments run the demo with a Python of that
Debian's version; `make piuparts` and `make arm64` install the packages. Prints a table; ends with status 1 when
something is wrong.
"""

import argparse
import contextlib
import itertools
import json
import math
import platform
import re
import shutil
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from tests.support.process import free_port
from tools import build_deb, compiled
from tools.build_deb import DEBIANS, PLATFORMS, ROOT, interpreter

FOLDER = ROOT / "build" / "release"
PYTHONS = ("3.11", "3.12", "3.13")
MAX_WHEEL_BYTES = 2_000_000
MAX_COMPILED_BYTES = 3_000_000
TIMEOUT_S = 60.0
MIN_WAY_M = 0.2  # of a robot that is driven
NEEDED = (
    "hostlink/py.typed",
    "hostlink/components/gateway/web/built/index.html",
    "hostlink/data/hostlink.toml",
    "hostlink/data/hostlink.service",
    "hostlink/core/guardian/process.py",
    "hostlink/workbench/sim/firmware.wasm",
)
UNWANTED = re.compile(r"(^|/)(tests|node_modules|__pycache__|\.git|build)/|\.(ts|pyc|so|toml\.bak)$")
LIBRARY = re.compile(r"(?P<module>[^.]+)\.cpython-[^/]+\.so$")
# Pythons and platforms for which no compiled wheel is built: a newer Python, Alpine, and a Raspberry Pi with 32 bits.
PURE_ONLY = (("3.14", "manylinux2014_x86_64"), ("3.11", "musllinux_1_2_x86_64"), ("3.11", "linux_armv7l"))
OF_SOURCES = ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "Makefile", "firmware/README.md", "docs/api.md")


class Unusable(Exception):
    """An installation does not work."""


class Row(NamedTuple):
    """Result of one installation."""

    python: str
    of: str
    megabytes: float  # with all that it needs
    start_s: float  # from the command to a robot
    problem: str


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", action="append", help="only this version; may be repeated")
    parser.add_argument("--no-deb", action="store_true", help="without the Debian packages")
    parser.add_argument("--no-compiled", action="store_true", help="without the compiled wheels")
    arguments = parser.parse_args()
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir(parents=True)
    print("building ...", flush=True)
    subprocess.run([sys.executable, "-m", "hatchling", "build", "--directory", str(FOLDER)], cwd=ROOT, check=True)
    (wheel,), (sources,) = FOLDER.glob("*.whl"), FOLDER.glob("*.tar.gz")
    problems = [*problems_of_wheel(wheel), *problems_of_sources(sources)]
    found = {version: path for version in arguments.python or PYTHONS if (path := interpreter(version)) is not None}
    missing = [version for version in arguments.python or PYTHONS if version not in found]
    problems += [f"Python {version} is not found: nothing is known of it" for version in missing]
    rows = [tried(version, path, wheel) for version, path in found.items()]
    rows += [tried(version, path, sources) for version, path in list(found.items())[:1]]
    if not arguments.no_compiled:
        done, wrong = try_compiled(found, wheel)
        rows += done
        problems += wrong
    if not arguments.no_deb:
        for debian, arch in itertools.product(DEBIANS, PLATFORMS):
            print(f"building the package for Debian {debian}, {arch} ...", flush=True)
            try:
                deb = Path(shutil.copy(build_deb.build(arch, debian), FOLDER))
            except build_deb.BuildFailed as error:
                problems.append(str(error))
                continue
            print(f"{deb.name}: {deb.stat().st_size / 1e6:.1f} MB")
            problems += [] if build_deb.lintian(deb) else [f"{deb.name}: lintian finds errors"]
            if PLATFORMS[arch] == platform.machine():
                rows.append(tried_deb(deb, debian))
    for row in rows:
        of = row.of.partition(".manylinux_")[0]  # a compiled wheel's name has two tags that mean the same
        what = row.problem or f"{row.megabytes:.0f} MB with what it needs, a robot after {row.start_s:.1f} s"
        print(f"Python {row.python:<6} {of:<48} {'FAILED' if row.problem else 'works':<7} {what}")
    print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.2f} MB; {sources.name}: {sources.stat().st_size / 1e6:.2f} MB")
    print(*problems, sep="\n", end="\n" if problems else "")
    return 1 if problems or any(row.problem for row in rows) else 0


def try_compiled(pythons: dict[str, Path], pure: Path) -> tuple[list[Row], list[str]]:
    """Build and check the compiled wheels, try those for this computer, and check that pip chooses the right one."""
    rows: list[Row] = []
    problems: list[str] = []
    wheels: dict[tuple[str, str], Path] = {}
    for version, arch in compiled.wanted(pythons):
        print(f"compiling the wheel for Python {version}, {arch} ...", flush=True)
        try:
            wheel = compiled.build(FOLDER, version, arch)
        except build_deb.BuildFailed as error:
            problems.append(str(error))
            continue
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.2f} MB", flush=True)
        problems += problems_of_compiled(wheel)
        wheels[version, f"manylinux2014_{PLATFORMS[arch]}"] = wheel
        if PLATFORMS[arch] == platform.machine():
            rows.append(tried(version, pythons[version], wheel, is_compiled=True))
    for version, where in (*wheels, *PURE_ONLY):
        wanted, found = wheels.get((version, where), pure).name, choice(FOLDER, version, where)
        problems += [] if found == wanted else [f"Python {version}, {where}: pip chooses {found}, not {wanted}"]
    return rows, problems


# -- what is in them --------------------------------------------------------------------------------------------------


def problems_of_wheel(wheel: Path) -> list[str]:
    """Return missing and unwanted files of a wheel, and an excessive size."""
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    size = wheel.stat().st_size
    too_large = [f"the wheel has {size} bytes, more than {MAX_WHEEL_BYTES}"] if size > MAX_WHEEL_BYTES else []
    return [*_missing(NEEDED, names, "the wheel"), *_unwanted(names, "the wheel"), *too_large]


def problems_of_compiled(wheel: Path) -> list[str]:
    """Return missing files and modules of a compiled wheel, and an excessive size. It has the sources too."""
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    libraries = {found["module"] for name in names if (found := LIBRARY.fullmatch(name))}
    modules = {str(path.relative_to(ROOT).with_suffix("")) for path in compiled.modules()}
    size = wheel.stat().st_size
    return [
        *_missing(NEEDED, names, wheel.name),
        *(f"{name} is not compiled in {wheel.name}" for name in sorted(modules - libraries)),
        *_unwanted((name for name in names if not name.endswith(".so")), wheel.name),
        *([f"{wheel.name} has {size} bytes, more than {MAX_COMPILED_BYTES}"] if size > MAX_COMPILED_BYTES else []),
    ]


def problems_of_sources(sources: Path) -> list[str]:
    """Return missing and superfluous files of the source distribution, which has the tests."""
    with tarfile.open(sources) as archive:
        names = [name.partition("/")[2] for name in archive.getnames()]
    wanted = (*OF_SOURCES, *NEEDED, "tests/conftest.py")
    return [*_missing(wanted, names, "the source distribution"), *_copies(names)]


def _missing(wanted: Iterable[str], names: list[str], where: str) -> list[str]:
    return [f"{name} is not in {where}" for name in wanted if name not in names]


def _unwanted(names: Iterable[str], where: str) -> list[str]:
    return [f"{name} is in {where}" for name in names if UNWANTED.search(name)]


def _copies(names: Iterable[str]) -> list[str]:
    return [f"{name} is in the source distribution" for name in names if "node_modules/" in name or ".venv/" in name]


# -- what a user does with them ---------------------------------------------------------------------------------------


def tried(version: str, python: Path, package: Path, *, is_compiled: bool = False) -> Row:
    """Install it into an empty environment, and run the demo there."""
    print(f"Python {version}: {package.name} ...", flush=True)
    venv = FOLDER / f"venv-{version}-{'compiled' if is_compiled else package.suffix.strip('.')}"
    try:
        subprocess.run([python, "-m", "venv", "--clear", venv], check=True, capture_output=True)
        install = [
            venv / "bin" / "python",
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            f"{package}[sim]",
        ]
        subprocess.run(install, check=True, capture_output=True)
        start_s, megabytes = demonstrated(venv / "bin" / "hostlink", cwd=venv), size_mb(venv)
        if is_compiled:
            check_compiled(venv, package)
    except subprocess.CalledProcessError as error:
        said = (error.stderr or error.stdout).decode()
        return Row(version, package.name, 0.0, 0.0, said.strip().rpartition("\n")[2])
    except (OSError, Unusable, subprocess.TimeoutExpired) as error:
        return Row(version, package.name, 0.0, 0.0, str(error) or type(error).__name__)
    return Row(version, package.name, megabytes, start_s, "")


def check_compiled(venv: Path, wheel: Path) -> None:
    """Check that the compiled modules are what runs, drive a robot over REST, and uninstall every file of the wheel."""
    python, tools = venv / "bin" / "python", ROOT / "tools"
    steps: tuple[tuple[str | Path, ...], ...] = (
        (tools / "try_compiled.py",),
        (tools / "try_drive.py", python.with_name("hostlink")),
        ("-m", "pip", "uninstall", "--yes", "--quiet", "hostlink"),
    )
    for words in steps:
        command: list[str | Path] = [python, "-I", *words]
        subprocess.run(command, cwd=venv, check=True, capture_output=True)
    (packages,) = venv.glob("lib/python*/site-packages")
    with zipfile.ZipFile(wheel) as archive:
        left = [name for name in archive.namelist() if (packages / name).exists()]
    if left:
        raise Unusable(f"pip uninstall leaves {', '.join(left)}")


def choice(folder: Path, version: str, where: str) -> str:
    """Return the name of the file that pip chooses of a folder, for a version of Python and a platform."""
    pip = (sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check")
    only = ("--only-binary=:all:", "--python-version", version, "--platform", where)
    with tempfile.TemporaryDirectory() as into:
        build_deb.run(*pip, *only, "--no-deps", "--no-index", "--find-links", folder, "--dest", into, "hostlink")
        return next(Path(into).iterdir()).name


def tried_deb(deb: Path, debian: str) -> Row:
    """Unpack a Debian package, and run the demo of its virtual environment with a Python of that Debian's version."""
    print(f"{deb.name} ...", flush=True)
    folder, python = FOLDER / f"unpacked-{debian}", interpreter(DEBIANS[debian])
    if python is None:
        return Row(DEBIANS[debian], deb.name, 0.0, 0.0, f"Python {DEBIANS[debian]} is not found")
    try:
        build_deb.run("dpkg-deb", "--extract", deb, folder)
        program = folder / build_deb.HOME / "bin" / "here"  # the program, with the interpreter of this folder
        program.with_name("python").unlink()  # points into this folder
        program.with_name("python").symlink_to(python)
        program.write_text(f"#!{program.with_name('python')} -I\nfrom hostlink.cli.start import main\n\nmain()\n")
        program.chmod(0o755)
        start_s = demonstrated(program, cwd=folder)
    except (OSError, Unusable, build_deb.BuildFailed, subprocess.TimeoutExpired) as error:
        return Row(DEBIANS[debian], deb.name, 0.0, 0.0, str(error) or type(error).__name__)
    return Row(DEBIANS[debian], deb.name, size_mb(folder), start_s, "")


def size_mb(folder: Path) -> float:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file() and not file.is_symlink()) / 1e6


def demonstrated(hostlink: Path, *, cwd: Path) -> float:
    """A robot appears, drives, and the daemon ends in order; returns how long the first took."""
    url = f"http://127.0.0.1:{free_port()}"
    words = [hostlink, "demo", "--listen", "127.0.0.1:0", "--api", url.removeprefix("http://")]
    with _running(words, cwd=cwd) as demo:
        began_s = time.monotonic()
        robot = _until(lambda: _with_pose(_json(hostlink, "robots", "--json", "--url", url, cwd=cwd)))
        start_s = time.monotonic() - began_s
        words = [hostlink, "pub", robot["velocity_topic"], '{"linear": {"x": 0.2}}', "--rate", "10", "--url", url]
        with _running(words, cwd=cwd):
            _until(lambda: _way_m(robot, hostlink, url, cwd=cwd) > MIN_WAY_M or None)
        demo.send_signal(signal.SIGINT)
        status = demo.wait(TIMEOUT_S)
        if status != 0:
            raise Unusable(f"the demo ended with status {status}")
    return start_s


def _with_pose(robots: list[dict[str, Any]] | None) -> dict[str, Any] | None:
    return next((robot for robot in robots or [] if robot["odometry"] is not None), None)


def _way_m(before: dict[str, Any], hostlink: Path, url: str, *, cwd: Path) -> float:
    (now,) = _json(hostlink, "robots", "--json", "--url", url, cwd=cwd)
    here, there = before["odometry"]["pose"], now["odometry"]["pose"]
    return math.dist((here["x_m"], here["y_m"]), (there["x_m"], there["y_m"]))


@contextlib.contextmanager
def _running(words: list[Any], *, cwd: Path) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(words, cwd=cwd, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def _until(find: Any) -> Any:
    deadline_s = time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline_s:
        found = find()
        if found is not None:
            return found
        time.sleep(0.1)
    raise Unusable(f"no robot that moves within {TIMEOUT_S:g} s")


def _json(*words: Any, cwd: Path) -> Any:
    done = subprocess.run(words, cwd=cwd, capture_output=True, timeout=TIMEOUT_S, check=False)
    return json.loads(done.stdout) if done.returncode == 0 else None


if __name__ == "__main__":
    sys.exit(main())
