"""Names that a board's headers define as macros: hostlink/board/macros.txt, which the headers of messages avoid.

    python tools/board_macros.py [--write]

They are read out of Arduino's genuine core for AVRs and of the C libraries of the compilers of `make firmware`. Without
--write it prints what the file has not.
"""

import argparse
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.firmware.families import AVR_CORE  # noqa: E402 - the tests are in a sibling folder

NAMES = ROOT / "hostlink" / "board" / "macros.txt"
CHIPS = {
    "atmega328p": "standard",
    "atmega168": "standard",
    "atmega2560": "mega",
    "atmega32u4": "leonardo",
    "atmega1284p": "standard",
}
LIBRARIES = ("EEPROM", "Wire", "SPI", "SoftwareSerial")
OF_ARDUINO = ("Arduino", *LIBRARIES, "errno", "limits", "stdio", "assert")
OF_C = ("math", "stdint", "stdio", "stdlib", "string", "stddef", "limits", "errno")
C_LIBRARIES = (("arm-none-eabi-g++", "-mcpu=cortex-m3", "-mthumb"), ("xtensa-lx106-elf-g++",))
_PLAIN = re.compile(r"^#define ([A-Za-z]\w*) ", re.MULTILINE)


def macros(compiler: tuple[str, ...], headers: tuple[str, ...]) -> set[str]:
    """Return the macros without arguments, whose names no field or constant may have."""
    source = "".join(f"#include <{header}.h>\n" for header in headers)
    command = [*compiler, "-x", "c++", "-std=gnu++11", "-dM", "-E", "-"]
    done = subprocess.run(command, input=source, capture_output=True, text=True, check=True)
    return set(_PLAIN.findall(done.stdout))


def of_chip(chip: str) -> set[str]:
    """Return the macros of a sketch for an AVR."""
    folders = ("cores/arduino", f"variants/{CHIPS[chip]}", *(f"libraries/{name}/src" for name in LIBRARIES))
    own = ("-DF_CPU=16000000L", "-DARDUINO=10819", "-DARDUINO_ARCH_AVR", "-DUSB_VID=1", "-DUSB_PID=1")
    return macros(("avr-g++", f"-mmcu={chip}", *own, *(f"-I{AVR_CORE / folder}" for folder in folders)), OF_ARDUINO)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help=f"into {NAMES.relative_to(ROOT)}")
    arguments = parser.parse_args()
    found = set[str]().union(*map(of_chip, CHIPS), *(macros(compiler, OF_C) for compiler in C_LIBRARIES))
    known = set(NAMES.read_text().split()) if NAMES.exists() else set[str]()
    if arguments.write:
        NAMES.write_text("".join(f"{name}\n" for name in sorted(known | found)))
    else:
        print("\n".join(sorted(found - known)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
