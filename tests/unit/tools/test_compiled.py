"""Rules of the modules that `make compiled` compiles: the wheel works with the sources that are not compiled."""

import ast
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tools import compiled
from tools.build_deb import ROOT, BuildFailed

SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())
HOOK = SETTINGS["tool"]["hatch"]["build"]["targets"]["wheel"]["hooks"]["mypyc"]
COMPILED = compiled.modules()


def classes() -> Iterator[tuple[Path, ast.ClassDef]]:
    for path in (ROOT / "hostlink").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                yield path, node


def base_names(node: ast.ClassDef) -> set[str]:
    """Return the names of its bases; of `Queue[Outgoing]` it is Queue."""
    found = (base.value if isinstance(base, ast.Subscript) else base for base in node.bases)
    return {base.id for base in found if isinstance(base, ast.Name)}


def test_each_pattern_names_modules_that_exist() -> None:
    assert [each for each in HOOK["include"] if not list(ROOT.glob(each.removeprefix("/")))] == []


@pytest.mark.slow
def test_classes_that_interpreted_ones_inherit_permit_it() -> None:
    """mypyc raises TypeError when the interpreted class is created: every WebSocket was refused with status 500."""
    found = list(classes())
    inherited = {name for path, node in found if path not in COMPILED for name in base_names(node)}
    for path, node in found:
        if path in COMPILED and node.name in inherited:
            decorators = [ast.unparse(each) for each in node.decorator_list]
            assert "mypyc_attr(allow_interpreted_subclasses=True)" in decorators, f"{path}: {node.name}"


def test_no_compiled_coroutine_waits_while_it_handles_an_exception() -> None:
    """mypyc leaves that exception to all other coroutines: after one cancelled link, every other ended as cancelled."""
    waits = (ast.Await, ast.Yield, ast.YieldFrom)
    for path in COMPILED:
        for node in ast.walk(ast.parse(path.read_text())):
            handling: list[ast.AST] = [*node.handlers, *node.finalbody] if isinstance(node, ast.Try) else []
            found = [each for part in handling for each in ast.walk(part) if isinstance(each, waits)]
            assert not found, f"{path}:{found[0].lineno}"
            assert not isinstance(node, ast.AsyncWith | ast.TryStar), f"{path}:{node.lineno}"


@pytest.mark.slow
def test_no_compiled_function_names_one_within_it() -> None:
    """mypyc keeps both in a reference cycle, so that a link that has ended was freed by the garbage collector only."""
    functions = (ast.FunctionDef, ast.AsyncFunctionDef)
    for path in COMPILED:
        for node in ast.walk(ast.parse(path.read_text())):
            inner = [each for each in ast.walk(node) if isinstance(each, functions) and each is not node]
            assert not (isinstance(node, functions) and inner), f"{path}:{inner[0].lineno}"


@pytest.mark.long
@pytest.mark.timeout(900)
def test_mypyc_translates_every_module(tmp_path: Path) -> None:
    """mypyc refuses some of what mypy accepts. A value of a class that is not written out is missing in its objects."""
    program = "import sys; from mypyc.build import mypycify; mypycify(sys.argv[2:], target_dir=sys.argv[1])"
    names = sorted(str(path.relative_to(ROOT)) for path in COMPILED)
    words = (sys.executable, "-c", program, str(tmp_path), *HOOK["mypy-args"], *names)
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    lines = (done.stdout + done.stderr).splitlines()
    assert [each for each in lines if "error:" in each or "Unsupported default" in each] == []
    assert done.returncode == 0, lines[-20:]


def test_cross_compiling_without_headers_is_refused() -> None:
    with pytest.raises(BuildFailed, match=r"^no Debian has Python 3\.12, so its headers for arm64 are missing$"):
        compiled.headers("3.12", "arm64")


def test_each_python_with_a_wheel_for_arm64_is_one_of_a_debian() -> None:
    assert {version for version, arch in compiled.WHEELS if arch == "arm64"} == set(compiled.SUITES)


def test_wheels_are_chosen_by_version_and_architecture() -> None:
    assert list(compiled.wanted()) == list(compiled.WHEELS)
    assert list(compiled.wanted(["3.11"], ["arm64"])) == [("3.11", "arm64")]
