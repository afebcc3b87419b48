"""Definitions whose names, sizes and types are unusual, as headers for an AVR with Arduino's genuine core."""

from pathlib import Path

import pytest

from hostlink.board.headers import identifier
from hostlink.board.library import headers, select
from hostlink.core.messages.catalog import Catalog
from tests.firmware.due import ROSSERIAL
from tests.firmware.families import AVR_CORE
from tests.support.compilers import CORE, SKETCH, run
from tools.board_macros import CHIPS, NAMES, of_chip

LONG = "AVeryLongNameOfAMessageThatSomebodyHasGeneratedOutOfAModelWithManyLevelsOfItsOwn"
FUNCTIONS = ("min", "max", "abs", "round", "sq", "bit", "word", "F", "constrain", "lowByte", "radians", "sei", "isnan")
OTHERS = ("LED", "E", "A0", "SCK", "setup", "loop", "Serial", "String", "boolean", "out", "in", "text", "ros", "std")
METHODS = ("serialize", "deserialize", "getType", "getMD5", "getSize", "data_length")
KEYWORDS = ("new", "class", "union", "delete", "nullptr", "template", "operator")
GLOBALS = (
    "time",
    "map",
    "random",
    "delay",
    "tone",
    "log",
    "remove",
    "setup",
    "loop",
    "byte",
    "String",
    "Serial",
    "Wire",
)
DEFINITIONS = {
    "odd_msgs/msg/Macros.msg": "".join(f"uint8 {name}=1\n" for name in NAMES.read_text().split()),
    "odd_msgs/msg/Fields.msg": "".join(
        f"{type_} {name}\n"
        for type_, names in (
            ("uint8", ["B1", "B00000001", "PI", "SREG", "SP", "PB1", "UDR0", "HIGH", "Fields", *KEYWORDS]),
            ("float32", FUNCTIONS),
            ("int32", (*OTHERS, *METHODS)),
            ("uint8[]", ["data"]),
        )
        for name in names
    ),
    "odd_msgs/msg/Empty.msg": "",
    "odd_msgs/msg/OnlyConstants.msg": (
        'string GREETING=hello "world" \\ # no comment\nfloat32 HALF=0.5\nfloat64 TINY=1e-300\nfloat64 HUGE=1e300\n'
        "bool YES=True\nint64 LEAST=-9223372036854775808\nuint64 MOST=18446744073709551615\nbyte B=-3\nchar C=65\n"
    ),
    "odd_msgs/BoolArrays.msg": (
        "bool[8] switches\nbool[] more\ntime[2] stamps\nduration[] waits\nstring[3] names\nstring[] texts\n"
        "Empty[2] nothing\nEmpty[] many\nOnlyConstants constants\n"
    ),
    f"odd_msgs/msg/{LONG}.msg": f"float64 {LONG.lower()}\nfloat64[] {'a_' * 60}name\n",
    "odd_msgs/srv/Switch.srv": "uint8 ON=1\nbool[4] switch\n---\nuint8 OK=0\nstring default\n",
    "odd_msgs/srv/Nothing.srv": "---\n",
    "deep_msgs/msg/A.msg": "B[2] b\nodd_msgs/BoolArrays inner\n",
    "deep_msgs/msg/B.msg": "C c\nHeader header\n",
    "deep_msgs/msg/C.msg": "class/Delete[] delete\ngeometry_msgs/Pose2D pose\n",
    "class/msg/Delete.msg": "uint8 new\n",
    "odd_msgs/msg/Esp.msg": "uint8 LOCAL=1\nuint8 SPECIAL=2\nuint8 BIT0\nuint8 ROS_IN_FLASH\n",
    **{f"odd_msgs/msg/{name}.msg": "uint8 x\n" for name in METHODS},
    **{f"odd_msgs/srv/{name}.srv": f"uint8 {name}\n---\n" for name in ("Request", "Response", "getTypes")},
    "odd_msgs/msg/OfMethods.msg": "getType a\ngetSize[] b\n",
    **{f"{name}/msg/Mine.msg": "uint8 x\n" for name in GLOBALS},
    "odd_msgs/msg/OfGlobals.msg": "".join(f"{name}/Mine[] {name.lower()}_\n" for name in GLOBALS),
    "avr/msg/PI.msg": "time stamp\nduration[3] waits\n",
}


@pytest.fixture(scope="module")
def included(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the headers; all.h includes them."""
    folder = tmp_path_factory.mktemp("odd")
    for name, text in DEFINITIONS.items():
        path = folder / "mine" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    made = headers(select(Catalog([folder / "mine"]), ["odd_msgs", "deep_msgs", "class", "avr", *GLOBALS]))
    for name, text in made.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (folder / "all.h").write_text("".join(f"#include <{name}>\n" for name in made))
    return folder


@pytest.mark.parametrize("chip", ["atmega328p", "atmega2560", "atmega32u4"])
def test_unusual_definitions_compile_behind_the_core_of_an_avr(included: Path, tmp_path: Path, chip: str) -> None:
    own = ("-DF_CPU=16000000L", "-DARDUINO=10819", "-DARDUINO_ARCH_AVR", "-DUSB_VID=1", "-DUSB_PID=1", "-include")
    folders = (AVR_CORE / "cores" / "arduino", AVR_CORE / "variants" / CHIPS[chip], ROSSERIAL, included)
    compiler = ["avr-g++", f"-mmcu={chip}", "-Os", *SKETCH, *(f"-I{folder}" for folder in folders)]
    run([*compiler, *own, "Arduino.h", "-x", "c++", "-c", included / "all.h", "-o", tmp_path / "x.o"])


def test_unusual_definitions_compile_with_every_warning(included: Path, tmp_path: Path) -> None:
    folders = [f"-I{ROSSERIAL}", f"-I{included}"]
    run(["clang++", *CORE, *folders, "-Wno-pragma-once-outside-header", "-x", "c++", "-c", included / "all.h",
         "-o", tmp_path / "x.o"])  # fmt: skip


@pytest.mark.parametrize("standard", ["c++11", "c++17"])
def test_constants_can_be_referred_to_without_optimization(included: Path, tmp_path: Path, standard: str) -> None:
    """Like std::max and a conditional expression; in two files of one program."""
    program = tmp_path / "x.cpp"
    program.write_text(
        "#include <odd_msgs/OnlyConstants.h>\ntypedef odd_msgs::OnlyConstants C;\n"
        "const float& same(const float& x);\nconst float& same(const float& x) { return x; }\n"
        "const char* const& text(const char* const& x);\nconst char* const& text(const char* const& x) { return x; }\n"
        "#ifdef MAIN\nint main() { return same(C::HALF) > 0 && text(C::GREETING)[0] == 'h' ? 0 : 1; }\n#endif\n"
    )
    compiler = ["g++", f"-std={standard}", "-O0", "-Wall", "-Wextra", f"-I{ROSSERIAL}", f"-I{included}"]
    run([*compiler, "-c", program, "-Dsame=other", "-Dtext=another", "-o", tmp_path / "other.o"])
    sources = (program, tmp_path / "other.o", ROSSERIAL / "ros" / "wire.cpp")
    run([*compiler, "-DMAIN", *sources, "-o", tmp_path / "program"])
    run([tmp_path / "program"])


@pytest.mark.parametrize("chip", ["atmega328p", "atmega2560", "atmega32u4"])
def test_every_macro_of_a_core_is_avoided(chip: str) -> None:
    """`tools/board_macros.py --write` adds the macros of a newer core."""
    assert {name for name in of_chip(chip) if identifier(name) == name} == set()
