"""Requirements of tests other than Python packages. A test whose requirement is missing is not run.

A requirement is found by a program or a file, so that it does not depend on the distribution. `make test` installs the
Debian packages where it may; `tests/conftest.py` skips the tests of what is still missing.
"""

import fnmatch
import shutil
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
REASON = "needs "  # a skip whose reason begins so is one of a missing requirement


@dataclass(frozen=True, slots=True)
class Requirement:
    """Programs or files, who provides them, and the tests that use them, as patterns of paths and names of fixtures."""

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
    _apt("openssl", "openssl", "tests/integration/test_access.py", "tests/integration/test_api_port.py",
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
)  # fmt: skip


def is_present(needed: str) -> bool:
    """Return whether a program is in the PATH, or a file exists."""
    return (ROOT / needed).exists() if "/" in needed else shutil.which(needed) is not None


def missing(is_present: Callable[[str], bool] = is_present) -> list[Requirement]:
    """Return the requirements of which something is missing."""
    return [each for each in REQUIREMENTS if not all(map(is_present, each.needs))]


def reasons(path: str, fixtures: Collection[str], absent: Collection[Requirement]) -> Iterator[str]:
    """Yield why a test cannot run: `path` is relative to the repository."""
    for each in absent:
        if any(fnmatch.fnmatch(path, pattern) for pattern in each.tests) or set(each.fixtures) & set(fixtures):
            yield each.reason
