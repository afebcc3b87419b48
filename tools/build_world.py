"""Builds hostlink/workbench/sim/firmware.wasm, the Due's firmware in its world, for `make world`.

The same sources give the same bytes with the same clang: Debian 12's packages, see PACKAGES. `--output FILE` writes the
module to another place, without a digest.
"""

import argparse
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODULE = ROOT / "hostlink" / "workbench" / "sim" / "firmware.wasm"
PACKAGES = "clang lld wasi-libc libclang-rt-14-dev-wasm32"  # of Debian 12; the Makefile has them too
CLANG = "14"  # another one makes other bytes
FIRMWARE = ROOT / "firmware"
_HOST = (
    *("firmware_module", "robot_in_world", "world_script", "world", "world_parameters"),
    *("drive_train", "caster", "random_numbers", "uart_ring", "uart_out"),
)
_FLAGS = [
    "--target=wasm32-wasi",
    "-mexec-model=reactor",  # a library: no main()
    "-nostdlib++",  # nothing of C++'s library is used
    "-std=c++11",
    "-pedantic-errors",
    "-O2",
    "-ffp-contract=off",  # the digits of the other builds
    "-fno-exceptions",
    "-fno-rtti",
    "-fno-threadsafe-statics",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Wshadow",
    "-Werror",
    "-Wl,--strip-all",
    "-Wl,-z,stack-size=65536",
]


def sources() -> list[Path]:
    """Return the compiled sources."""
    return [
        *(FIRMWARE / "host" / f"{name}.cpp" for name in _HOST),
        *sorted((FIRMWARE / "due" / "src").glob("*.cpp")),
        *sorted((FIRMWARE / "rosserial" / "src" / "ros").glob("*.cpp")),
    ]


def build(output: Path) -> None:
    """Compile and link.

    Raises:
        CalledProcessError: the compiler has written why.
        FileNotFoundError: there is no clang++.
    """
    exported = re.findall(r"^EXPORT .*?(\w+)\(", sources()[0].read_text(encoding="utf-8"), re.MULTILINE)
    exports = [f"-Wl,--export={name}" for name in exported]
    names = [str(source.relative_to(ROOT)) for source in sources()]  # no path of this machine
    command = ["clang++", *_FLAGS, *exports, "-Ifirmware/rosserial/src", *names, "-o", str(output.resolve())]
    subprocess.run(command, check=True, cwd=ROOT)


def main() -> int:
    """Build, and note of what."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=MODULE)
    output: Path = parser.parse_args().output
    try:
        build(output)
    except FileNotFoundError:
        sys.stderr.write(f"there is no clang++: on Debian 12 run  sudo apt-get install {PACKAGES}\n")
        return 1
    except subprocess.CalledProcessError as error:
        return int(error.returncode)
    output.chmod(0o644)  # it is data
    return 0


if __name__ == "__main__":
    sys.exit(main())
