"""Build the Debian packages: hostlink_VERSION+deb12_amd64.deb, and the same for arm64, into build/deb.

python -m tools.build_deb [--arch amd64] [--arch arm64] [--debian 12] [--no-lintian]

A package has the wheels of hostlink and of all that it needs, in a virtual environment in /usr/lib/hostlink that runs
Debian's own python3. pip takes wheels for the architecture, and compiles nothing: any computer builds both packages.
tools/debian has the control files; the version, the changelog, the unit, the settings, the completion and the man
pages are made from what the repository has for other ways to install.
"""

import argparse
import datetime
import email
import email.utils
import os
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path

from hostlink.cli.serve_command import read_example
from tools import man_pages

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "build" / "deb"
CONTROL = ROOT / "tools" / "debian"
DEBIANS = {"12": "3.11", "13": "3.13"}  # the version of Python of each Debian
PLATFORMS = {"amd64": "x86_64", "arm64": "aarch64"}
GLIBCS = ("2_17", "2_24", "2_26", "2_27", "2_28", "2_31", "2_34")  # of wheels; Debian 12 has 2.36
HOME = "usr/lib/hostlink"
LEFT_OUT = ("lab", "pictures", "plot")  # of the extras for users: matplotlib is as large as all the rest (100 MB)
SYSTEM_LIBRARIES = {  # what the libraries of the wheels may need of Debian, and the packages that have it
    "libgcc-s1": ("libgcc_s.so.1",),
    "libstdc++6": ("libstdc++.so.6",),
    "zlib1g": ("libz.so.1",),
    "libc6": ("libc.so", "libm.so", "libdl.so", "librt.so", "libpthread.so", "libutil.so", "ld-linux"),
}
NEEDED = re.compile(r"\(NEEDED\).*\[(.+)\]")
GLIBC = re.compile(r"\bGLIBC_(\d+)\.(\d+)")
PRUNED = (
    "**/tests",
    "numpy/_core/include",
    "numpy/_core/lib",
    "numpy/random/lib",
    "bin",
    "apsw/sqlite_extra_binaries",
    "**/__pycache__",
)
NEEDED_FILES = (
    "usr/bin/hostlink",
    f"{HOME}/bin/hostlink",
    f"{HOME}/bin/python",
    f"{HOME}/pyvenv.cfg",
    "etc/hostlink/hostlink.toml",
    "usr/share/bash-completion/completions/hostlink",
    "usr/share/zsh/vendor-completions/_hostlink",
    "usr/share/man/man1/hostlink.1.gz",
    "usr/share/man/man1/hostlink-serve.1.gz",
)
NEEDED_OF_DEB = (
    *NEEDED_FILES,
    "lib/systemd/system/hostlink.service",
    "lib/udev/rules.d/70-hostlink.rules",
    "usr/share/doc/hostlink/copyright",
    "usr/share/doc/hostlink/changelog.gz",
)


class BuildFailed(Exception):
    """The package cannot be built, or would not work."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arch", action="append", choices=PLATFORMS, help="only this one; may be repeated")
    parser.add_argument("--debian", default="12", choices=DEBIANS, help="for this version of Debian")
    parser.add_argument("--no-lintian", action="store_true", help="do not check the packages")
    chosen = parser.parse_args()
    is_clean = True
    try:
        for arch in chosen.arch or PLATFORMS:
            deb = build(arch, chosen.debian)
            print(f"{deb.relative_to(ROOT)}: {deb.stat().st_size / 1e6:.1f} MB", flush=True)
            is_clean &= chosen.no_lintian or lintian(deb)
    except BuildFailed as error:
        print(f"build_deb: {error}", file=sys.stderr)
        return 1
    return 0 if is_clean else 1


def build(arch: str, debian: str = "12") -> Path:
    """Build the package of one architecture and return its file.

    Raises:
        BuildFailed: a dependency has no wheel, or the package would lack a file or a library.
    """
    work = FOLDER / f"{arch}-{debian}" / "hostlink"
    shutil.rmtree(work.parent, ignore_errors=True)
    tree, packages = work / "tree", work / "tree" / HOME / "lib" / f"python{DEBIANS[debian]}" / "site-packages"
    install_wheels(packages, arch=arch, python=DEBIANS[debian])
    lay_out(tree, python=DEBIANS[debian])
    write_control(work, debian=debian, packages=packages, tree=tree)
    run("dpkg-buildpackage", "--build=binary", f"--host-arch={arch}", "--no-check-builddeps", "-us", "-uc", cwd=work)
    (deb,) = work.parent.glob("*.deb")
    lacking = sorted(set(NEEDED_OF_DEB) - set(names_in(deb)))
    if lacking:
        raise BuildFailed(f"{deb.name} lacks {', '.join(lacking)}")
    return deb.rename(FOLDER / deb.name)


def run(*words: str | Path, cwd: Path = ROOT, environment: dict[str, str] | None = None) -> str:
    """Run a program and return its output.

    Raises:
        BuildFailed: the program failed; with the last lines that it wrote.
    """
    done = subprocess.run(
        words,
        cwd=cwd,
        env=os.environ | {"LC_ALL": "C.UTF-8"} | (environment or {}),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise BuildFailed(f"{words[0]} ended with status {done.returncode}:\n{done.stdout[-4000:]}")
    return done.stdout


def interpreter(version: str) -> Path | None:
    """A Python of this version: on the path, of pyenv, of uv."""
    on_path = shutil.which(f"python{version}")
    places = (
        Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions",
        Path.home() / ".local" / "share" / "uv" / "python",
    )
    others = (path for place in places for path in sorted(place.glob(f"*{version}.*/bin/python3"), reverse=True))
    for path in (*([Path(on_path)] if on_path else []), *others):
        asked = subprocess.run(
            [path, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"], capture_output=True, check=False
        )
        if asked.stdout.decode().strip() == version:
            return path
    return None


# -- the files of the package -----------------------------------------------------------------------------------------


def extras() -> list[str]:
    """Return the extras that the package has: those of `all`, which names the extras for users."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (of_users,) = project["optional-dependencies"]["all"]
    names = of_users.removeprefix("hostlink[").removesuffix("]").split(",")
    return sorted(set(names) - set(LEFT_OUT))


def install_wheels(packages: Path, *, arch: str, python: str) -> None:
    """Install hostlink and what it needs, for another architecture, without running anything of it.

    Raises:
        BuildFailed: there is no such Python, or a dependency has no wheel for the architecture.
    """
    program = interpreter(python)
    if program is None:
        raise BuildFailed(f"Python {python} is not found: pip chooses the dependencies by the Python that runs it")
    platforms = [f"manylinux_{glibc}_{PLATFORMS[arch]}" for glibc in reversed(GLIBCS)]
    platforms.append(f"manylinux2014_{PLATFORMS[arch]}")
    with tempfile.TemporaryDirectory() as folder:
        run(sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", folder)
        (wheel,) = Path(folder).glob("*.whl")
        run(
            *(program, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile"),
            *("--target", packages, "--python-version", python, "--implementation", "cp", "--only-binary=:all:"),
            *(word for platform in platforms for word in ("--platform", platform)),
            f"{wheel}[{','.join(extras())}]",
        )
    for pattern in PRUNED:
        for path in list(packages.glob(pattern)):
            shutil.rmtree(path)
    for info in packages.glob("*.dist-info"):  # the paths in them are those of the build
        for name in ("RECORD", "direct_url.json", "REQUESTED"):
            (info / name).unlink(missing_ok=True)
    for path in packages.rglob("*"):
        if path.is_file():
            is_script = path.read_bytes()[:2] == b"#!" and path.suffix == ".py"
            path.chmod(0o644)
            if is_script:  # a module that is not a program
                path.write_text(path.read_text().partition("\n")[2])


def lay_out(tree: Path, *, python: str) -> None:
    """Write the files of the package that are not Python packages."""
    home = tree / HOME
    (home / "bin").mkdir(parents=True)
    (home / "bin" / "python").symlink_to("/usr/bin/python3")
    (home / "pyvenv.cfg").write_text(f"home = /usr/bin\ninclude-system-site-packages = false\nversion = {python}\n")
    program = home / "bin" / "hostlink"
    program.write_text(f"#!/{HOME}/bin/python -I\nfrom hostlink.cli.start import main\n\nmain()\n")
    program.chmod(0o755)
    written = {
        "etc/hostlink/hostlink.toml": read_example("config"),
        "usr/share/bash-completion/completions/hostlink": completion("bash"),
        "usr/share/zsh/vendor-completions/_hostlink": completion("zsh"),
    }
    for name, text in written.items():
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        (tree / name).write_text(text)
    (tree / "usr/bin").mkdir(parents=True)
    (tree / "usr/bin/hostlink").symlink_to(f"../lib/{Path(HOME).name}/bin/hostlink")
    pages = tree / "usr/share/man/man1"
    pages.mkdir(parents=True)
    for name, text in man_pages.pages().items():  # debhelper compresses them
        (pages / name).write_text(text)


def completion(shell: str) -> str:
    """Return the file that a shell loads when Tab is pressed after `hostlink`, as typer writes it.

    zsh reads the first line of such a file, and runs the file as the completion itself.
    """
    words = [sys.executable, "-m", "hostlink"]
    text = run(*words, environment={"_HOSTLINK_COMPLETE": f"source_{shell}"}).strip() + "\n"
    if shell == "zsh":
        text = text.replace("compdef _hostlink_completion hostlink", '_hostlink_completion "$@"')
    return text


def unit() -> str:
    """Return the unit of systemd for the package: the program has another place."""
    return read_example("systemd").replace("/opt/hostlink/bin/hostlink", "/usr/bin/hostlink")


# -- the control files ------------------------------------------------------------------------------------------------


def write_control(work: Path, *, debian: str, packages: Path, tree: Path) -> None:
    """Write the folder `debian` of the source package."""
    folder = work / "debian"
    shutil.copytree(CONTROL, folder)
    (folder / "source").mkdir()
    (folder / "source" / "format").write_text("3.0 (native)\n")
    (folder / "changelog").write_text(changelog(debian))
    (folder / "copyright").write_text(copyright_file(packages))
    (folder / "hostlink.service").write_text(unit())
    (folder / "hostlink.udev").write_text(read_example("udev"))
    major, minor = DEBIANS[debian].split(".")
    depends = [
        f"python3 (>= {major}.{minor})",
        f"python3 (<< {major}.{int(minor) + 1})",
        "procps",
        *system_packages(tree),
    ]
    control = (folder / "control").read_text()
    (folder / "control").write_text(control.replace("${hostlink:Depends}", ", ".join(depends)))


def deb_version(debian: str) -> str:
    """Return the version of pyproject.toml as Debian sorts it: 1.0.0rc1 is 1.0.0~rc1, before 1.0.0."""
    return re.sub(r"\.?(dev|rc|a|b)(?=\d)", r"~\1", man_pages.version()) + f"+deb{debian}"


def changelog(debian: str) -> str:
    """Return a changelog with one entry, of the day of the commit; CHANGELOG.md is for users."""
    asked = subprocess.run(["git", "log", "-1", "--format=%ct"], cwd=ROOT, capture_output=True, text=True, check=False)
    is_known = asked.returncode == 0 and asked.stdout.strip()
    now = datetime.datetime.now(datetime.UTC)
    when = datetime.datetime.fromtimestamp(int(asked.stdout), datetime.UTC) if is_known else now
    (maintainer,) = re.findall(r"^Maintainer: (.+)$", (CONTROL / "control").read_text(), re.MULTILINE)
    return (
        f"hostlink ({deb_version(debian)}) stable; urgency=medium\n\n"
        f"  * Version {man_pages.version()}; CHANGELOG.md of the sources says what is new.\n\n"
        f" -- {maintainer}  {email.utils.format_datetime(when)}\n"
    )


def copyright_file(packages: Path) -> str:
    """Return the licence of hostlink, and the licences that the metadata of the wheels names."""
    licence = (ROOT / "LICENSE").read_text()
    (owner,) = re.findall(r"^Copyright \(c\) (.+)$", licence, re.MULTILINE)
    text = textwrap.indent(licence.partition("\n\n")[2].partition("\n\n")[2].strip(), " ", lambda _: True)
    text = re.sub(r"^ $", " .", text, flags=re.MULTILINE)
    wheels = "\n".join(f"  {line}" for line in sorted(licences(packages)))
    return (
        f"{(CONTROL / 'copyright').read_text().rstrip()}\nCopyright: {owner}\nLicense: Expat\n{text}\n\n"
        f"Files: {HOME}/lib/*\nCopyright: the authors of these packages, in NAME.dist-info\n"
        f"License: various\n The licences, as the packages name them:\n .\n{wheels}\n"
    )


def licences(packages: Path) -> Iterator[str]:
    """Return name, version and licence of each package."""
    for file in packages.glob("*.dist-info/METADATA"):
        fields = email.message_from_string(file.read_text())
        classified = [
            value.rpartition(" :: ")[2] for value in fields.get_all("Classifier", []) if value.startswith("License ::")
        ]
        first_line = (fields.get("License") or "").strip().partition("\n")[0]
        found = fields.get("License-Expression") or ", ".join(classified) or first_line
        yield f"{fields['Name']} {fields['Version']}: {found or 'see its folder'}"


def system_packages(tree: Path) -> list[str]:
    """Return the packages of Debian that have the libraries which the wheels need, and the oldest C library.

    Raises:
        BuildFailed: a library is neither in the tree nor in SYSTEM_LIBRARIES.
    """
    libraries = [path for path in tree.rglob("*.so*") if path.is_file()]
    own = {path.name for path in libraries}
    depends: dict[str, str] = {}
    newest = (2, 17)
    for path in libraries:
        text = run("readelf", "--wide", "--dynamic", "--version-info", path)
        for library in set(NEEDED.findall(text)) - own:
            depends[package_of(library, path)] = ""
        newest = max([newest, *((int(major), int(minor)) for major, minor in GLIBC.findall(text))])
    depends["libc6"] = f" (>= {newest[0]}.{newest[1]})"
    return [f"{name}{version}" for name, version in sorted(depends.items())]


def package_of(library: str, path: Path) -> str:
    for package, prefixes in SYSTEM_LIBRARIES.items():
        if library.startswith(prefixes):
            return package
    raise BuildFailed(f"{path.name} needs {library}, which no package in SYSTEM_LIBRARIES has")


# -- what was built ---------------------------------------------------------------------------------------------------


def names_in(deb: Path) -> Iterable[str]:
    """Return the paths of the files in a package."""
    lines = run("dpkg-deb", "--contents", deb).splitlines()
    return (line.split(maxsplit=5)[5].partition(" -> ")[0].removeprefix("./") for line in lines)


def lintian(deb: Path) -> bool:
    """Return whether lintian finds no error; print what it finds."""
    done = subprocess.run(
        ["lintian", "--fail-on", "error", "--tag-display-limit", "0", deb],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"LC_ALL": "C.UTF-8"},
    )
    print(done.stdout.strip() or "lintian: nothing found", flush=True)
    return done.returncode == 0


if __name__ == "__main__":
    sys.exit(main())
