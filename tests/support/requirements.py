"""Requirements of tests beyond the Python packages of the extra `test`. A test whose requirement is missing is not run.

A requirement is found by a program, a file or a Python module, so that it does not depend on the distribution.
`make test` runs the tests without requirements. `make test-all` installs what the others need, where it may;
`tests/conftest.py` skips the tests of what is still missing.
"""

import fnmatch
import importlib.util
import shutil
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
REASON = "needs "  # a skip whose reason begins so is one of a missing requirement


@dataclass(frozen=True, slots=True)
class Requirement:
    """Programs, files or modules (`import NAME`), who provides them, and the tests that use them.

    `tests` are patterns of paths or of whole names of tests, `fixtures` are names. A file that cannot be collected
    without a module is named by its path.
    """

    needs: tuple[str, ...]
    source: str
    tests: tuple[str, ...]
    fixtures: tuple[str, ...] = ()

    @property
    def reason(self) -> str:
        """Reason for which a test is skipped."""
        return f"{REASON}{self.source}"


def _apt(needs: str, packages: str, *tests: str, fixtures: tuple[str, ...] = ()) -> Requirement:
    return Requirement(tuple(needs.split()), f"apt-get install {packages}", tests, fixtures)


def _pip(modules: str, *tests: str) -> Requirement:
    return Requirement(tuple(f"import {each}" for each in modules.split()), "pip install -e '.[dev]'", tests)


_COMPILED = (
    "tests/firmware/*",
    "tests/property/test_board_headers.py",
    "tests/system/test_chain.py",
)
_CLIENTS = ("tests/system/test_clients.py", "tests/system/test_client_memory.py")
REQUIREMENTS = (
    _apt("cmake g++", "cmake g++", *_COMPILED),
    _apt("clang++ clang-format clang-tidy cppcheck", "clang clang-format clang-tidy cppcheck", *_COMPILED),
    _apt("arm-none-eabi-g++ qemu-system-arm", "gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm", *_COMPILED),
    _apt("avr-g++ /usr/share/arduino/hardware/arduino/avr", "gcc-avr avr-libc arduino-core-avr", "tests/firmware/*"),
    _apt("/usr/include/simavr", "libsimavr-dev", "tests/firmware/test_rosserial_uno.py"),
    _apt("wasm-ld /usr/include/wasm32-wasi", "lld wasi-libc libclang-rt-14-dev-wasm32",
         "tests/firmware/test_world_module.py"),
    _apt("chromium-headless-shell", "chromium-headless-shell", fixtures=("browser",)),
    _apt("firefox-esr", "firefox-esr", "tests/system/test_page_firefox.py"),
    _apt("mosquitto mosquitto_passwd", "mosquitto mosquitto-clients", "tests/system/test_mqtt.py",
         "tests/integration/test_micro_ros_components.py::test_broker*"),
    _apt("openssl", "openssl", "tests/system/test_mqtt.py::test_tls*",
         "tests/integration/test_access.py", "tests/integration/test_api_port.py",
         "tests/integration/zenoh/*", "tests/system/zenoh/*"),
    _apt("roscore rostopic /usr/lib/python3/dist-packages/rospy", "python3-rospy python3-roslaunch python3-rostopic",
         "tests/system/ros1/*"),
    _apt("systemd-analyze", "systemd", "tests/system/test_service.py"),
    _apt("tmux ps", "tmux procps", *(
        f"tests/system/{name}.py" for name in (
            "test_first_hour", "test_program_ends", "test_setup", "test_step", "test_teleop",
            "test_top", "test_topic_commands", "zenoh/test_fleet_views",
        )
    )),
    Requirement(("node", "tests/clients/node_modules/.package-lock.json"), "apt-get install nodejs npm", _CLIENTS),
    Requirement(("build/ros2-venv/.installed",), "make ros2-venv", ("tests/system/ros2/*",)),
    Requirement(("build/promtool/usr/bin/promtool",), "make build/promtool/usr/bin/promtool", (), ("promtool",)),
    Requirement(("build/ros-mcp-venv/.installed",), "make ros-mcp-venv", ("tests/system/test_ros_mcp.py",)),
    _pip("uvloop", "tests/unit/cli/test_loop_choice.py", "tests/integration/test_uvloop_transport.py"),
    _pip("importlinter", "tests/unit/tools/test_import_rows.py"),
    _pip("roslibpy", "tests/integration/test_diagnostics.py"),
    _pip("zenoh_ros2_sdk", "tests/integration/test_rmw_zenoh.py",
         "tests/integration/test_micro_ros_components.py::test_node_of_ros_2*"),
    _pip("wpimath", "tests/property/test_kinematics_wpimath.py"),
    _pip("schemathesis", "tests/integration/test_openapi.py"),
    _pip(
        "matplotlib",
        "tests/unit/cli/test_new_file.py::test_plot_export*", "tests/unit/cli/test_step.py::test_a_picture*",
        "tests/unit/cli/test_lab.py::test_a_picture_that*",
        "tests/unit/components/recorder/test_export.py::test_pictures*",
    ),
)  # fmt: skip


def is_present(needed: str) -> bool:
    """Return whether a module can be imported, a file exists, or a program is in the PATH."""
    if needed.startswith("import "):
        return importlib.util.find_spec(needed.removeprefix("import ")) is not None
    return (ROOT / needed).exists() if "/" in needed else shutil.which(needed) is not None


def missing(is_present: Callable[[str], bool] = is_present) -> list[Requirement]:
    """Return the requirements of which something is missing."""
    return [each for each in REQUIREMENTS if not all(map(is_present, each.needs))]


def reasons(name: str, fixtures: Collection[str], absent: Collection[Requirement]) -> Iterator[str]:
    """Yield why a test or a file cannot run; `name` begins with the path relative to the repository."""
    path = name.partition("::")[0]
    for each in absent:
        if any(fnmatch.fnmatchcase(tested, pattern) for pattern in each.tests for tested in (path, name)) or set(
            each.fixtures
        ) & set(fixtures):
            yield each.reason
