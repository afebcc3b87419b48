"""Families of boards: their compilers, stand-ins for what Debian lacks, and the size of a sketch on each.

The compilers, the C libraries and, for the AVRs, Arduino's core are genuine. The cores of the others are stand-ins in
firmware/host: a program that is linked for them has every function of sketch and library, for ARM also of the C
library, but no function of the core.
"""

import os
from pathlib import Path
from typing import NamedTuple

from tests.firmware.due import ROOT, ROSSERIAL
from tests.firmware.examples import BUILD, compile_sketch, sources
from tests.support.compilers import SKETCH, run
from tests.support.once import once

AVR_CORE = Path("/usr/share/arduino/hardware/arduino/avr")
HOST = ROOT / "firmware" / "host"
SMALL = ("-Os", "-ffunction-sections", "-fdata-sections", "-fno-exceptions", "-fno-threadsafe-statics")
FREESTANDING = (*SMALL, "-ffreestanding", "-nostdinc++", "-fno-rtti", "-fno-use-cxa-atexit")
SKETCH_ALONE = "-Wl,--gc-sections,-e,_Z5setupv,-u,_Z4loopv,--unresolved-symbols=ignore-all"
NEED_WIFI = frozenset({"wifi", "udp", "board_settings", "passthrough"})
NEED_LIBRARIES = frozenset({"servo", "ethernet"})  # versions of Arduino's packages, which Debian does not have


class Family(NamedTuple):
    """One family of boards."""

    name: str
    compiler: tuple[str, ...]
    includes: tuple[Path, ...]
    link: tuple[str, ...] = ()  # linker and its options; none: compile only
    libraries: tuple[str, ...] = ("-lm",)
    size: str = "size"
    ram_bytes: int = 0  # of the chip; 0: more than enough
    has_core: bool = False
    has_wifi: bool = False

    @property
    def folder(self) -> Path:
        return BUILD / self.name.lower().replace(" ", "_")

    def fits(self, example: str) -> bool:
        """Whether an example is for a board of this family."""
        return self.has_wifi or example not in NEED_WIFI

    def is_linked(self, example: str) -> bool:
        """Whether everything that an example needs is installed."""
        return bool(self.link) and example not in NEED_LIBRARIES


def _avr(name: str, chip: str, variant: str, board: str, ram_bytes: int) -> Family:
    defines = ("-DF_CPU=16000000L", "-DARDUINO_ARCH_AVR", f"-DARDUINO_AVR_{board}", "-DDECIMAL_DIG=17")
    folders = ("cores/arduino", f"variants/{variant}", "libraries/Wire/src", "libraries/EEPROM/src")
    return Family(
        name=name,
        compiler=("avr-g++", f"-mmcu={chip}", *SMALL, "-flto", *defines),
        includes=(*(AVR_CORE / folder for folder in folders), HOST / "avr_libraries"),
        link=("avr-gcc", f"-mmcu={chip}", "-Os", "-flto", "-Wl,--gc-sections"),
        size="avr-size",
        ram_bytes=ram_bytes,
        has_core=True,
    )


def _arm(chip: str) -> Family:
    processor = (f"-mcpu=cortex-{chip.lower()}", "-mthumb")
    return Family(
        name=f"Cortex-{chip}",
        compiler=("arm-none-eabi-g++", *processor, *FREESTANDING),
        includes=(HOST / "any_board",),
        link=("arm-none-eabi-gcc", *processor, "-specs=nano.specs", "-nostartfiles", SKETCH_ALONE),
        size="arm-none-eabi-size",
    )


def _esp(name: str) -> Family:
    return Family(
        name=name,
        compiler=("xtensa-lx106-elf-g++", "-mlongcalls", f"-D{name}", *FREESTANDING),
        includes=(HOST / "esp", HOST / "any_board"),
        link=("xtensa-lx106-elf-gcc", "-nostdlib", SKETCH_ALONE),
        libraries=(),  # soft floats are in the chip's ROM, and the core brings its own C library
        size="xtensa-lx106-elf-size",
        has_wifi=True,
    )


UNO = _avr("Uno", "atmega328p", "standard", "UNO", 2048)
MEGA = _avr("Mega", "atmega2560", "mega", "MEGA2560", 8192)
BOARDS = (UNO, MEGA, _arm("M0"), _arm("M3"), _arm("M4"), _esp("ESP8266"), _esp("ESP32"))
COMPILERS = (
    Family("g++", ("g++", "-O1"), (HOST / "any_board",), has_wifi=True),
    Family("clang", ("clang++", "-O1"), (HOST / "any_board",), has_wifi=True),
)


def compiled(family: Family, sketch: Path) -> Path:
    """Object file of a sketch.

    Raises:
        AssertionError: the compiler fails or warns.
    """
    family.folder.mkdir(parents=True, exist_ok=True)
    output = family.folder / f"{sketch.parent.name}_{sketch.stem}.o"
    compiler = [*family.compiler, *_includes(family)]
    once(f"object_{family.folder.name}_{output.stem}", lambda: compile_sketch(sketch, output, compiler), output)
    return output


def image(family: Family, sketch: Path) -> Path:
    """Image that is flashed.

    Raises:
        AssertionError: compiler or linker fail or warn.
    """
    object_ = compiled(family, sketch)
    linked = object_.with_suffix(".elf")
    command = [*family.link, object_, *built(family), *family.libraries, "-o", linked]
    once(f"image_{family.folder.name}_{linked.stem}", lambda: run(command), linked)
    return linked


def image_bytes(family: Family, sketch: Path) -> tuple[int, int]:
    """Flash and static RAM of a sketch.

    Raises:
        AssertionError: compiler or linker fail or warn.
    """
    text, data, bss = map(int, run([family.size, image(family, sketch)]).splitlines()[1].split()[:3])
    return text + data, data + bss


def built(family: Family) -> list[Path]:
    """Objects of the library, and of the core.

    Raises:
        AssertionError: the compiler fails or warns.
    """
    once(f"board_{family.folder.name}", lambda: _compile(family), family.folder / "library")
    return [*sorted(family.folder.glob("library/*.o")), *family.folder.glob("core.a")]


def _compile(family: Family) -> None:
    for folder in ("core", "library"):
        (family.folder / folder).mkdir(parents=True, exist_ok=True)
    for source in sources():
        options = [*family.compiler, *SKETCH, f"-I{ROSSERIAL}"]
        run([*options, "-c", source, "-o", family.folder / "library" / f"{source.stem}.o"])
    if family.has_core:
        _compile_core(family)


def _compile_core(family: Family) -> None:
    _, *options = family.compiler
    wire = AVR_CORE / "libraries" / "Wire" / "src"
    for source in [*sorted((AVR_CORE / "cores" / "arduino").glob("*.[cS]*")), *sorted(wire.rglob("*.c*"))]:
        compiler = ["avr-g++", "-std=gnu++11"] if source.suffix == ".cpp" else ["avr-gcc"]
        flags = [word for word in options if source.suffix == ".cpp" or word != "-fno-threadsafe-statics"]
        output = family.folder / "core" / f"{source.name}.o"
        run([*compiler, *flags, *_includes(family), "-DARDUINO=10819", "-w", "-c", source, "-o", output])
    archive = family.folder / "core.a"
    archive.unlink(missing_ok=True)
    run(["avr-gcc-ar", "rcs", archive, *sorted(family.folder.glob("core/*.o"))])


def _includes(family: Family) -> list[str]:
    return [f"-I{os.fspath(folder)}" for folder in family.includes]
