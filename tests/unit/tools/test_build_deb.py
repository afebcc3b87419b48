"""Files of the Debian package outside its Python packages: man pages, completion, unit, control files."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hostlink.cli.main import COMMANDS
from tools import build_deb, man_pages
from tools.docs_reference import parser

needs_man = pytest.mark.skipif(shutil.which("man") is None, reason="needs man-db")


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    return man_pages.pages()


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files that a package installs, without the wheels."""
    folder = tmp_path_factory.mktemp("deb") / "tree"
    build_deb.lay_out(folder, python="3.11")
    return folder


@pytest.mark.slow
def test_each_command_has_a_man_page(pages: dict[str, str]) -> None:
    assert set(pages) == {"hostlink.1", *(f"hostlink-{name}.1" for name in COMMANDS)}


def test_each_option_of_a_command_is_on_its_page(pages: dict[str, str]) -> None:
    for name in ("serve", "params", "record"):
        found = parser(name)
        for command in (found, *getattr(found, "commands", {}).values()):
            for option in filter(man_pages.is_shown_option, command.params):
                assert rf"\fB{man_pages.escaped(option.opts[0])}\fR" in pages[f"hostlink-{name}.1"]


@pytest.mark.slow
def test_each_page_names_the_version_of_the_project(pages: dict[str, str]) -> None:
    assert all(f'"hostlink {man_pages.version()}"' in text for text in pages.values())


def test_page_is_dated_by_source_date_epoch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    assert man_pages.date() == "1970-01-01"


@pytest.mark.slow
@needs_man
def test_man_formats_each_page_without_a_warning(pages: dict[str, str], tmp_path: Path) -> None:
    for name, text in pages.items():
        (tmp_path / name).write_text(text)
    words = ["man", "--warnings", "--encoding=UTF-8", "--local-file", "-Tutf8", "-Z", *sorted(tmp_path.iterdir())]
    environment = os.environ | {"LC_ALL": "C.UTF-8", "MANWIDTH": "80"}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
def test_package_has_each_needed_file(tree: Path) -> None:
    present = {str(path.relative_to(tree)) for path in tree.rglob("*")}
    present |= {f"{name}.gz" for name in present if name.startswith("usr/share/man/")}  # debhelper compresses them
    assert set(build_deb.NEEDED_FILES) <= present
    assert all(f"usr/share/man/man1/hostlink-{name}.1.gz" in present for name in COMMANDS)


@pytest.mark.slow
def test_package_has_nothing_outside_of_the_folders_of_debian(tree: Path) -> None:
    assert {path.name for path in tree.iterdir()} == {"etc", "usr"}
    assert str((tree / "usr/bin/hostlink").readlink()) == "../lib/hostlink/bin/hostlink"
    assert (tree / "usr/lib/hostlink/bin/hostlink").stat().st_mode & 0o777 == 0o755


def test_unit_starts_the_program_of_the_package() -> None:
    assert "ExecStart=/usr/bin/hostlink serve --config /etc/hostlink/hostlink.toml" in build_deb.unit().splitlines()
    assert "/opt/" not in build_deb.unit()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shell", "words"),
    [
        ("bash", ["bash", "--norc", "-c", 'source "$0" && complete -p hostlink']),
        (
            "zsh",
            ["zsh", "-f", "-c", "fpath=(${0:h} $fpath); autoload -U compinit; compinit -D; print $_comps[hostlink]"],
        ),
    ],
)
def test_shell_loads_the_completion(tree: Path, shell: str, words: list[str]) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"needs {shell}")
    (file,) = [tree / name for name in build_deb.NEEDED_FILES if shell in name]
    done = subprocess.run([*words, file], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "_hostlink" in done.stdout


@pytest.mark.slow
def test_bash_completes_commands(tree: Path) -> None:
    program = Path(sys.executable).parent
    script = (
        'source "$0"; COMP_WORDS=(hostlink rob); COMP_CWORD=1; _hostlink_completion hostlink; echo "${COMPREPLY[*]}"'
    )
    file = tree / "usr/share/bash-completion/completions/hostlink"
    environment = os.environ | {"PATH": f"{program}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "--norc", "-c", script, file], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["robots"]


@pytest.mark.parametrize(
    ("version", "of_deb"),
    [("1.0.0", "1.0.0+deb12"), ("1.1.0rc1", "1.1.0~rc1+deb12"), ("1.1.0.dev2", "1.1.0~dev2+deb12")],
)
def test_version_is_sorted_by_debian_as_by_python(monkeypatch: pytest.MonkeyPatch, version: str, of_deb: str) -> None:
    monkeypatch.setattr(man_pages, "version", lambda: version)
    assert build_deb.deb_version("12") == of_deb


def test_control_names_a_library_package_for_each_library(tmp_path: Path) -> None:
    with pytest.raises(build_deb.BuildFailed, match=r"libcurl\.so\.4"):
        build_deb.package_of("libcurl.so.4", tmp_path / "x.so")
    assert build_deb.package_of("ld-linux-aarch64.so.1", tmp_path / "x.so") == "libc6"


def test_extras_for_developers_are_left_out() -> None:
    assert {"sim", "mdns", "zenoh"} <= set(build_deb.extras())
    assert not set(build_deb.extras()) & {"dev", "docs", "fuzz", "mutants"}


def test_maintainer_scripts_are_valid_shell() -> None:
    for name in ("postinst", "prerm", "postrm"):
        script = build_deb.CONTROL / name
        assert re.search(r"^#DEBHELPER#$", script.read_text(), re.MULTILINE)
        subprocess.run(["sh", "-n", script], check=True)


def test_package_has_the_extras_for_users_and_no_tools_of_developers() -> None:
    assert build_deb.extras() == ["export", "mdns", "mqtt", "ros2", "sim", "uvloop", "zenoh"]
