"""Changes one place of a module at a time and runs its tests: a change that no test notices survives.

cosmic-ray knows the changes; a seed draws some places of each module, and one change at each. Prints the score and
what survived. With paths: only these modules.
"""

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
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
PROTOCOL = ("tests/unit/protocol", "tests/property/test_replay.py")
TESTS = {  # one run each until one fails, so those that notice most come first
    "hostlink/messages/codec.py": (
        "tests/unit/messages/test_codec.py",
        "tests/unit/messages",
        "tests/property/test_codec.py",
    ),
    "hostlink/protocol/stream.py": (
        "tests/unit/protocol/test_stream.py",
        *PROTOCOL,
        "tests/property/test_stream.py",
    ),
    "hostlink/protocol/session.py": (
        "tests/unit/protocol/test_session.py",
        *PROTOCOL,
        "tests/property/test_session.py",
    ),
    "hostlink/protocol/negotiation.py": (
        "tests/unit/protocol/test_negotiation.py",
        *PROTOCOL,
        "tests/property/test_session.py",
    ),
    "hostlink/protocol/outbox.py": (
        "tests/unit/protocol/test_outbox.py",
        *PROTOCOL,
        "tests/property/test_session.py",
        "tests/property/test_outbox.py",
    ),
    "hostlink/robot/velocity_gate.py": (
        "tests/unit/robot/test_velocity_gate.py",
        "tests/unit/robot",
        "tests/property/test_velocity_gate.py",
    ),
    "hostlink/robot/kinematics.py": ("tests/property/test_kinematics.py", "tests/unit/robot"),
    "hostlink/hub/topic_graph.py": ("tests/unit/hub", "tests/unit/api", "tests/integration/test_rosbridge.py"),
}


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

    def describe(self) -> str:
        """Where it is, and the lines before and after."""
        before, after = self._original().splitlines(), self.source().splitlines()
        _, _, where, *lines = unified_diff(before, after, n=0, lineterm="")
        return "\n  ".join([f"{self.module}:{where.split(',')[0].split()[1][1:]}", *lines])

    def _original(self) -> str:
        return (ROOT / self.module).read_text()


def _operator(name: str) -> Operator:
    made: Operator = get_operator(name)()
    return made


def drawn(module: str, count: int, seed: int) -> list[Mutant]:
    """So many places of the module, and one change at each; the same for the same seed."""
    dice = random.Random(f"{seed} {module}")  # noqa: S311 - to be repeated
    places = defaultdict(list)
    for place, mutant in _mutants(module):
        places[place].append(mutant)
    chosen = dice.sample(sorted(places), min(count, len(places)))
    return [dice.choice(places[place]) for place in sorted(chosen)]


def _mutants(module: str) -> Iterator[tuple[object, Mutant]]:
    nodes = list(ast_nodes(get_ast((ROOT / module).read_text())))
    for name in operator_names():
        if get_operator(name).arguments():
            continue
        places = [(node, place) for node in nodes for place in _operator(name).mutation_positions(node)]
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
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    environment = {**os.environ, "HYPOTHESIS_PROFILE": "ci", "PYTHONDONTWRITEBYTECODE": "1"}
    for tests in TESTS[module]:
        try:
            subprocess.run(
                [*command, tests], cwd=folder, env=environment, capture_output=True, timeout=TIMEOUT_S, check=True
            )
        except subprocess.SubprocessError:
            return False
    return True


def main() -> None:
    """Draw, test and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="*", default=list(TESTS))
    parser.add_argument("--count", type=int, default=8, help="places in each module")
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
        for module in wanted.modules:
            if not passes(module, Path(root) / "0"):
                sys.exit(f"{module}: its tests fail without a change; nothing can be learned from the changes")
            mutants = drawn(module, wanted.count, wanted.seed)
            survivors = [mutant for mutant, lives in zip(mutants, pool.map(test, mutants), strict=True) if lives]
            print(f"{module}: {len(mutants) - len(survivors)} of {len(mutants)} noticed", flush=True)
            for mutant in survivors:
                print(mutant.describe(), flush=True)


def _copy(folder: Path) -> Path:
    folder.mkdir()
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            ignored = shutil.ignore_patterns("node_modules", "__pycache__")
            shutil.copytree(source, folder / name, ignore=ignored)
        else:
            shutil.copy(source, folder / name)
    return folder


if __name__ == "__main__":
    main()
