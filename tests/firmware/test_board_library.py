"""The library that `hostlink arduino-library` writes, on the compilers of the boards."""

import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from platformio.package.manager.library import LibraryPackageManager
from platformio.package.manifest.parser import ManifestParserFactory
from platformio.package.manifest.schema import ManifestSchema
from platformio.package.meta import PackageSpec

from hostlink.board.library import select
from hostlink.cli.board import arduino_library as command
from hostlink.core.messages.catalog import Catalog
from tests.support.board_codec import FIRMWARE, SOURCES, write_headers
from tests.support.compilers import CORE, SKETCH, SKETCH_WARNINGS, run
from tests.support.once import compiled

COMPILERS = {
    "pc": ["g++", "-O1"],
    "clang": ["clang++", "-O1"],
    "uno": ["avr-g++", "-mmcu=atmega328p", "-Os", "-fno-exceptions", "-fno-threadsafe-statics"],
    "m0": [
        "arm-none-eabi-g++",
        "-mcpu=cortex-m0",
        "-mthumb",
        "-Os",
        "-ffreestanding",
        "-nostdinc++",
        "-fno-exceptions",
    ],
    "m4": [
        "arm-none-eabi-g++",
        "-mcpu=cortex-m4",
        "-mthumb",
        "-Os",
        "-ffreestanding",
        "-nostdinc++",
        "-fno-exceptions",
    ],
}


@pytest.fixture(scope="module")
def headers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Headers of all types."""
    folder = tmp_path_factory.mktemp("headers")
    write_headers(select(Catalog(), None), folder)
    return folder


@pytest.mark.long
@pytest.mark.parametrize("board", COMPILERS)
def test_every_header_compiles_without_a_warning(headers: Path, tmp_path: Path, board: str) -> None:
    for source in (FIRMWARE / "tests" / "message_headers.cpp", SOURCES / "ros" / "wire.cpp"):
        made = tmp_path / f"{source.stem}.o"
        compiled([*COMPILERS[board], *CORE, f"-I{SOURCES}", f"-I{headers}", "-c", source, "-o", made], made, headers)


DEFINITION = """\
uint8 HIGH=7
Header header
float64 width
float32[] forces
string[] names
uint8 class
"""
LIST = "CMakeLists.txt"


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the library from the ZIP."""
    folder = tmp_path_factory.mktemp("library")
    (folder / "mine" / "my_msgs").mkdir(parents=True)
    (folder / "mine" / "my_msgs" / "Gripper.msg").write_text(DEFINITION)
    arguments = ["--messages", folder / "mine", "--only", "my_msgs,std_srvs/SetBool", "-o", folder / "x.zip"]
    subprocess.run([sys.executable, "-m", "hostlink", "arduino-library", *arguments], check=True, capture_output=True)
    shutil.unpack_archive(folder / "x.zip", folder)
    return folder / "hostlink_rosserial"


@pytest.mark.parametrize("file", ["library.json", "library.properties"])
def test_platformio_reads_the_description_of_the_library(unpacked: Path, file: str) -> None:
    facts = ManifestParserFactory.new_from_file(str(unpacked / file)).as_dict()
    facts.pop("license", None)  # its list of licences is on the network
    manifest = ManifestSchema().load_manifest(facts)
    assert (manifest["name"], manifest["version"]) == ("hostlink_rosserial", version("hostlink"))


def test_platformio_installs_the_zip_by_the_line_that_the_command_prints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PLATFORMIO_CORE_DIR", str(tmp_path / "core"))
    command(output=tmp_path / "my library \u00e4.zip", only=["std_msgs/Empty"])
    _, _, line = capsys.readouterr().out.partition("lib_deps = ")
    manager = LibraryPackageManager(str(tmp_path / "libraries"))
    package = manager.install(PackageSpec(line.splitlines()[0]), skip_dependencies=True)
    assert (package.metadata.name, str(package.metadata.version)) == ("hostlink_rosserial", version("hostlink"))
    assert (Path(package.path) / "src" / "std_msgs" / "Empty.h").exists()


def test_a_program_that_is_built_with_cmake_sends_my_message_as_the_host_reads_it(unpacked: Path) -> None:
    folder = unpacked.parent
    (folder / LIST).write_text(
        "cmake_minimum_required(VERSION 3.12)\nproject(program CXX)\nadd_subdirectory(hostlink_rosserial)\n"
        f"add_executable(program {FIRMWARE}/tests/library_program.cpp)\n"
        "target_link_libraries(program hostlink::rosserial)\n"
    )
    for step in (["-S", folder, "-B", folder / "build"], ["--build", folder / "build"]):
        done = subprocess.run(["cmake", *step], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    sent = subprocess.run([folder / "build" / "program"], capture_output=True, text=True, check=True).stdout
    gripper = Catalog([folder / "mine"]).message("my_msgs/Gripper")
    assert gripper is not None
    name, md5, payload = sent.split()
    assert (name, md5) == ("my_msgs/Gripper", gripper.md5)
    assert gripper.decode(bytes.fromhex(payload)) == {
        "header": {"seq": 0, "stamp": {"secs": 0, "nsecs": 0}, "frame_id": "hand"},
        "width": 0.25, "forces": [0.5, -2.0], "names": ["left", "right"], "class": 7,
    }  # fmt: skip


def test_a_program_with_the_library_fits_an_uno(unpacked: Path, tmp_path: Path) -> None:
    """All sources are compiled, like in the Arduino IDE; the linker drops what the program does not use."""
    flags = "-mmcu=atmega328p -Os -fno-exceptions -fno-threadsafe-statics -ffunction-sections -fdata-sections"
    sources = [FIRMWARE / "tests" / "library_program.cpp", *sorted((unpacked / "src").rglob("*.cpp"))]
    command = ["avr-g++", *flags.split(), "-Wl,--gc-sections", *SKETCH, f"-I{unpacked}/src"]
    compiled([*command, *sources, "-o", tmp_path / "x.elf"], tmp_path / "x.elf", unpacked)
    text, data, bss = map(int, run(["avr-size", tmp_path / "x.elf"]).splitlines()[1].split()[:3])
    assert text + data < 32256
    assert data + bss < 2048


ARDUINO = Path("/usr/share/arduino/hardware/arduino/avr")


@pytest.mark.long
def test_a_zip_of_few_types_has_what_its_examples_include(unpacked: Path, tmp_path: Path) -> None:
    examples = sorted((unpacked / "examples").glob("*/*.ino"))
    assert len(examples) >= 10
    flags = ["-std=gnu++17", *SKETCH_WARNINGS, "-fsyntax-only", "-DARDUINO=10819", "-include", "Arduino.h"]
    command = ["g++", *flags, f"-I{FIRMWARE}/host/any_board", f"-I{unpacked}/src", "-x", "c++", *examples]
    compiled(command, tmp_path / "checked", unpacked)


@pytest.mark.parametrize(
    "example", ["pubsub", *(pytest.param(each, marks=pytest.mark.long) for each in ("service_server", "motors_l298"))]
)
def test_an_example_out_of_the_zip_compiles_with_the_core_of_an_uno(
    unpacked: Path, tmp_path: Path, example: str
) -> None:
    own = (
        f"-I{ARDUINO}/cores/arduino -I{ARDUINO}/variants/standard -DF_CPU=16000000L -DARDUINO=10819 -DARDUINO_ARCH_AVR"
    )
    flags = f"-mmcu=atmega328p -Os -fno-exceptions {own} -include Arduino.h -x c++"
    command = ["avr-g++", *flags.split(), *SKETCH, f"-I{unpacked}/src"]
    run([*command, "-c", unpacked / "examples" / example / f"{example}.ino", "-o", tmp_path / "x.o"])
