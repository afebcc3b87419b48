"""Changes one place of the code at a time and runs its package's unit tests: a change that no test notices survives.

cosmic-ray knows the changes; a seed draws some places of each package, and one change at each. Prints the score and
what survived. With paths of packages or modules: only these; --together draws one sample from all of them.
"""

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from difflib import unified_diff
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import MutationVisitor
from cosmic_ray.operators.operator import Operator
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).resolve().parent.parent
COPIED = ("hostlink", "tests", "tools", "docs", "firmware", "pyproject.toml")
TIMEOUT_S = 300.0  # an endless loop is noticed
QUICK = "not quiet and not alone and not long"  # the tests of `make quick`
NO_TESTS_SELECTED = 5  # pytest's exit code, where each test of a file has one of these marks
MORE_TESTS = {  # in addition to a package's unit tests
    "hostlink/core/messages": ("tests/property/test_codec.py",),
    "hostlink/core/protocol": (
        "tests/property/test_replay.py",
        "tests/property/test_stream.py",
        "tests/property/test_session.py",
        "tests/property/test_outbox.py",
    ),
    "hostlink/core/robot": (
        "tests/property/test_velocity_gate.py",
        "tests/property/test_kinematics.py",
        "tests/property/test_admission.py",
    ),
    "hostlink/core/mirror": (),
    "hostlink/core/hub": (),
    "hostlink/components/gateway": (),
    "hostlink/components/graphs": (),
    "hostlink/components/recorder": (),
}


def tests_of(module: str) -> tuple[str, ...]:
    """The tests that judge a change of the module: the unit tests of its package, and what MORE_TESTS adds.

    The test file of the module's name is run first, because it notices most.
    """
    package = _package(module)
    unit = package.replace("hostlink", "tests/unit", 1)
    named = sorted(str(path.relative_to(ROOT)) for path in (ROOT / unit).rglob(f"test_{Path(module).stem}.py"))
    return (*named, unit, *MORE_TESTS.get(package, ()))


def _package(module: str) -> str:
    return next((each for each in MORE_TESTS if module.startswith(f"{each}/")), module.rpartition("/")[0])


@dataclass(frozen=True)
class Mutant:
    """One change of one module."""

    module: str
    operator: str
    occurrence: int  # of the operator in the module

    def source(self) -> str:
        """The module with the change."""
        made: str = MutationVisitor.mutate_code(self._original(), _operator(self.operator), self.occurrence)
        return made

    @property
    def is_possible(self) -> bool:
        """Whether cosmic-ray can make the change. It cannot replace an exception with a dotted name."""
        try:
            self.source()
        except AttributeError:
            return False
        return True

    def describe(self) -> str:
        """Return the place of the change, and its lines before and after."""
        before, after = self._original().splitlines(), self.source().splitlines()
        _, _, where, *lines = unified_diff(before, after, n=0, lineterm="")
        return "\n  ".join([f"{self.module}:{where.split(',')[0].split()[1][1:]}", *lines])

    def _original(self) -> str:
        return (ROOT / self.module).read_text()


def _operator(name: str) -> Operator:
    made: Operator = get_operator(name)()
    return made


def drawn(where: str, count: int, seed: int) -> list[Mutant]:
    """So many places of the packages or modules, and one change at each; the same for the same seed.

    Args:
        where: path of a package or module, or several separated by spaces: each gets a share by its number of places.
    """
    dice = random.Random(f"{seed} {where}")  # noqa: S311 - to be repeated
    paths = [ROOT / each for each in where.split()]
    modules = [module for path in paths for module in ([path] if path.is_file() else sorted(path.rglob("*.py")))]
    places = defaultdict(list)
    for module in (str(each.relative_to(ROOT)) for each in modules):
        for place, mutant in _mutants(module):
            places[module, place].append(mutant)
    chosen = dice.sample(sorted(places), min(count, len(places)))
    return [mutant for mutant in (dice.choice(places[place]) for place in sorted(chosen)) if mutant.is_possible]


def _mutants(module: str) -> Iterator[tuple[object, Mutant]]:
    nodes = list(ast_nodes(get_ast((ROOT / module).read_text())))
    for name in operator_names():
        if get_operator(name).arguments():
            continue
        operator = _operator(name)
        places = [(node, place) for node in nodes for place in operator.mutation_positions(node)]
        for occurrence, (node, place) in enumerate(places):
            if not _is_declaration(node):
                yield place, Mutant(module, name, occurrence)


def _is_declaration(node: Any) -> bool:
    """Whether it is part of an annotation or a mark between parameters: no test can notice a change of it."""
    child = node
    while (parent := child.parent) is not None and parent.type not in ("suite", "file_input"):
        if parent.type == "annassign":
            return child is parent.children[1]
        if parent.type == "tfpdef" or (child is node and parent.type == "parameters"):
            return True
        if parent.type == "funcdef" and child is parent.annotation:
            return True
        child = parent
    return False


def survives(mutant: Mutant, folder: Path) -> bool:
    """Whether the module's tests pass in the copy with the change."""
    path = folder / mutant.module
    path.write_text(mutant.source())
    try:
        return passes(mutant.module, folder)
    finally:
        shutil.copy(ROOT / mutant.module, path)


def passes(module: str, folder: Path) -> bool:
    """Whether the module's tests pass in the copy; tests that do not end in time do not pass."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", QUICK]
    environment = {**os.environ, "HYPOTHESIS_PROFILE": "ci", "PYTHONDONTWRITEBYTECODE": "1"}
    for tests in tests_of(module):
        try:
            ended = subprocess.run(
                [*command, tests], cwd=folder, env=environment, capture_output=True, timeout=TIMEOUT_S, check=False
            )
        except subprocess.TimeoutExpired:
            return False
        if ended.returncode not in (0, NO_TESTS_SELECTED):
            return False
    return True


def main() -> None:
    """Draw, test and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("places", metavar="PATH", nargs="*", default=list(MORE_TESTS))
    parser.add_argument("--count", type=int, default=8, help="places in each package or module")
    parser.add_argument("--together", action="store_true", help="draw --count places from all paths together")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    wanted = parser.parse_args()
    folders: SimpleQueue[Path] = SimpleQueue()
    with tempfile.TemporaryDirectory() as root, ThreadPoolExecutor(wanted.workers) as pool:
        for number in range(wanted.workers):
            folders.put(_copy(Path(root) / str(number)))

        def test(mutant: Mutant) -> bool:
            folder = folders.get()
            try:
                return survives(mutant, folder)
            finally:
                folders.put(folder)

        print(f"seed {wanted.seed}")
        for where in [" ".join(wanted.places)] if wanted.together else wanted.places:
            mutants = drawn(where, wanted.count, wanted.seed)
            for package, first in {_package(mutant.module): mutant for mutant in mutants}.items():
                if not passes(first.module, Path(root) / "0"):
                    sys.exit(f"{package}: its tests fail without a change; nothing can be learned from the changes")
            survivors = []
            for mutant, lives in zip(mutants, pool.map(test, mutants), strict=True):
                if lives:
                    survivors.append(mutant)
                    print(mutant.describe(), flush=True)
            for package, count in Counter(_package(mutant.module) for mutant in mutants).items():
                left = sum(_package(mutant.module) == package for mutant in survivors)
                print(f"{package}: {count - left} of {count} noticed", flush=True)


def _copy(folder: Path) -> Path:
    folder.mkdir()
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            ignored = shutil.ignore_patterns("node_modules")  # __pycache__ saves compiling hostlink for each change
            shutil.copytree(source, folder / name, ignore=ignored)
        else:
            shutil.copy(source, folder / name)
    return folder


if __name__ == "__main__":
    main()
