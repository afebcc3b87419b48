"""tools/run_tests.py: each group runs once, and the table names what failed and what could not run."""

from pathlib import Path

import pytest

from tests import conftest
from tests.support import requirements
from tools import run_tests
from tools.run_tests import Result

NEEDS_TMUX = "needs apt-get install tmux"
REPORT = f"""<testsuites><testsuite>
<testcase classname="tests.some" name="test_good"/>
<testcase classname="tests.some" name="test_bad"><failure/></testcase>
<testcase classname="tests.some" name="test_broken"><error/></testcase>
<testcase classname="tests.some" name="test_screen"><skipped message="{NEEDS_TMUX}"/></testcase>
<testcase classname="tests.some" name="test_group"><skipped message="no control group"/></testcase>
</testsuite></testsuites>"""

ROOT = Path(__file__).parents[3]


@pytest.fixture
def in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run_tests.REPORTS.mkdir(parents=True)


@pytest.mark.usefixtures("in_a_folder")
def test_group_with_failed_tests_runs_once_and_names_them() -> None:
    commands = []

    def run(command: list[str]) -> int:
        commands.append(command)
        Path(command[-1].partition("=")[2]).write_text(REPORT)
        return 1

    result = run_tests.run_group("some", ["-m", "pytest"], ["--workers", "6"], run)
    assert commands == [["-m", "pytest", "--workers", "6", "--junit-xml=build/tests/some.xml"]]
    assert (result.code, result.passed, result.skipped.total()) == (1, 1, 2)
    lines = run_tests.table([result]).splitlines()
    assert lines[1].split() == ["some", "1", "2", "2", "0"]
    assert lines[2:] == [
        "failed: tests.some::test_bad",
        "failed: tests.some::test_broken",
        f"not run: 1 ({NEEDS_TMUX})",
        "not run: 1 (no control group)",
    ]


@pytest.mark.usefixtures("in_a_folder")
def test_group_that_was_killed_without_a_report_is_shown_as_failed() -> None:
    (run_tests.REPORTS / "some.xml").write_text(REPORT)  # of an earlier run
    result = run_tests.run_group("some", ["-m", "pytest"], [], lambda _: 137)
    assert run_tests.table([result]).splitlines()[1].split() == ["some", "0", "yes", "0", "0"]


def test_missing_requirement_fails_the_run_in_ci_alone() -> None:
    skipped, missing, failed = Result("a", 0), Result("b", 0), Result("c", 1)
    skipped.skipped["no control group"] += 1
    missing.skipped[NEEDS_TMUX] += 1
    assert [run_tests.exit_code([skipped, each], is_ci=False) for each in (skipped, missing, failed)] == [0, 0, 1]
    assert [run_tests.exit_code([skipped, each], is_ci=True) for each in (skipped, missing, failed)] == [0, 1, 1]


def test_groups_of_make_test_all_take_every_test_once() -> None:
    selections = {name: arguments for name, _, arguments in run_tests.all_groups(6, 2)}
    assert list(selections) == ["pure", "others", "programs", "quiet", "alone", "long", "long alone"]
    programs = run_tests.starting_programs()
    for package in run_tests.PURE:
        assert f"tests/unit/{package}" in selections["pure"]
        assert f"--ignore=tests/unit/{package}" in selections["others"]
    for file in programs:
        assert file in selections["programs"]
        assert f"--ignore={file}" in selections["others"]
    assert [selections[name][selections[name].index("-m") + 1] for name in list(selections)[1:]] == [
        "not quiet and not alone and not long",
        "not quiet and not alone and not long",
        "quiet and not alone and not long",
        "alone and not long",
        "long and not alone",
        "long and alone",
    ]
    assert "tests/system/test_chaos.py" in selections["long alone"]


def test_pure_packages_exist_and_have_tests() -> None:
    for each in run_tests.PURE:
        assert list((ROOT / "hostlink" / each).glob("*.py")), each
        assert list((ROOT / "tests" / "unit" / each).glob("test_*.py")), each


def test_tests_that_start_programs_have_no_more_workers_than_cores() -> None:
    workers = {
        name: int(arguments[arguments.index("--workers") + 1]) if "--workers" in arguments else 1
        for name, _, arguments in run_tests.all_groups(8, 2)
    }
    assert workers == {"pure": 8, "others": 8, "programs": 2, "quiet": 2, "alone": 1, "long": 2, "long alone": 1}
    programs = run_tests.starting_programs()
    assert {"tests/integration/test_guardian.py", "tests/unit/tools/test_build_deb.py"} <= set(programs)
    assert "tests/integration/test_admission_contract.py" not in programs


def test_make_test_selects_quick_tests_without_requirements() -> None:
    ((_, _, arguments),) = run_tests.python_groups(8)
    assert "--python-only" in arguments
    assert arguments[-3:] == list(run_tests.PYTHON_TESTS)


@pytest.mark.parametrize("mark", ["quiet", "alone", "long"])
def test_pure_packages_have_no_test_with_a_mark_that_another_group_selects(mark: str) -> None:
    files = run_tests.marked(mark)
    assert [file for file in files if file.startswith(tuple(f"tests/unit/{each}/" for each in run_tests.PURE))] == []


def test_requirement_that_is_missing_is_the_reason_for_its_tests_alone() -> None:
    absent = requirements.missing(lambda needed: needed not in ("tmux", "chromium-headless-shell"))
    assert requirements.REASON == run_tests.MISSING

    def reasons(path: str, *fixtures: str) -> list[str]:
        return list(requirements.reasons(path, fixtures, absent))

    assert reasons("tests/system/test_top.py", "tmp_path") == ["needs apt-get install tmux procps"]
    assert reasons("tests/system/test_page.py", "browser") == ["needs apt-get install chromium-headless-shell"]
    assert reasons("tests/system/test_serve.py") == []


def test_requirement_names_tests_that_exist() -> None:
    patterns = [pattern for each in requirements.REQUIREMENTS for pattern in each.tests]
    files, tests = [each.partition("::")[0] for each in patterns], [each for each in patterns if "::" in each]
    assert [file for file in files if not list(requirements.ROOT.glob(file))] == []
    for test in tests:
        file, _, name = test.partition("::")
        assert f"def {name.rstrip('*')}" in (requirements.ROOT / file).read_text(encoding="utf-8"), test


def test_module_that_is_missing_is_the_reason_for_its_files_and_tests_alone() -> None:
    absent = requirements.missing(lambda needed: needed != "import matplotlib")
    assert list(requirements.reasons("tests/unit/cli/test_step.py::test_a_picture_is_drawn[.svg]", (), absent)) == [
        "needs pip install -e '.[dev]'"
    ]
    assert list(requirements.reasons("tests/unit/cli/test_step.py", (), absent)) == []
    assert requirements.is_present("import json")
    assert not requirements.is_present("import no_module_of_this_name")


def test_file_whose_module_is_missing_is_one_skipped_test(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = Path(__file__)
    name = here.relative_to(requirements.ROOT).as_posix()
    absent = [requirements.Requirement(("import no_module_of_this_name",), "pip install it", (name,))]
    monkeypatch.setattr(requirements, "missing", lambda: absent)
    folder = request.node.parent.parent
    found = conftest.pytest_pycollect_makemodule(here, folder)
    assert found is not None
    (item,) = found.collect()
    assert [mark.kwargs["reason"] for mark in item.iter_markers("skip")] == ["needs pip install it"]
    assert conftest.pytest_pycollect_makemodule(here.parent / "test_release.py", folder) is None
