"""Quick compilations for each family of boards; tools/board_sizes.py has every example on each."""

from pathlib import Path

import pytest

from tests.firmware.examples import EXAMPLES, compile_sketch
from tests.firmware.families import BOARDS, HOST, NEED_WIFI, Family, compiled
from tests.firmware.sketches import MOVED

OF_THE_SAME_KIND = ("Mega", "Cortex-M4")  # as the Uno and the Cortex-M3
NEED_NO_PACKAGE = [family for family in BOARDS if not family.has_wifi]


def sketch(name: str) -> Path:
    return EXAMPLES / name / f"{name}.ino"


@pytest.mark.parametrize(
    "family",
    [
        pytest.param(family, marks=pytest.mark.long) if family.name in OF_THE_SAME_KIND else family
        for family in NEED_NO_PACKAGE
    ],
    ids=lambda family: family.name,
)
def test_an_example_compiles_without_a_warning(family: Family) -> None:
    compiled(family, sketch("motors_l298"))


@pytest.mark.parametrize(
    ("name", "chip"),
    [
        pytest.param(name, chip, marks=pytest.mark.long) if chip == "ESP8266" and name != "wifi" else (name, chip)
        for name in [*sorted(NEED_WIFI), "ros_lib"]
        for chip in ("ESP8266", "ESP32")
    ],
)
def test_a_sketch_for_wifi_compiles_with_the_names_of_the_core(tmp_path: Path, name: str, chip: str) -> None:
    """With the PC's compiler; only `make firmware` uses the chip's own."""
    path = MOVED / "tcp_hello_world.ino" if name == "ros_lib" else sketch(name)
    compiler = ["g++", "-O0", f"-D{chip}", f"-I{HOST}/esp", f"-I{HOST}/any_board"]
    compile_sketch(path, tmp_path / "x.o", compiler)
