"""Every example of the library for every family of boards, without a warning, and its size: docs/board-sizes.md.

    python tools/board_sizes.py [--write]

It needs the compilers of `make firmware`. A warning of a compiler is an error. With --write the tables of the document
are written again; without they are printed.
"""

import argparse
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.firmware.examples import EXAMPLES, messages  # noqa: E402 - the tests are in a sibling folder
from tests.firmware.families import BOARDS, COMPILERS, MEGA, UNO, Family, built, compiled, image_bytes  # noqa: E402
from tests.firmware.sketches import MOVED  # noqa: E402

DOCUMENT = ROOT / "docs" / "board-sizes.md"
BEGIN, END = "<!-- written by tools/board_sizes.py -->", "<!-- end -->"
TOO_LARGE = "region `data'"  # what avr-ld writes when the RAM is full
STACK_BYTES = 256  # at least


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help=f"into {DOCUMENT.relative_to(ROOT)}")
    arguments = parser.parse_args()
    try:
        text = tables()
    except AssertionError as error:
        print(f"a compiler fails or warns:\n{error}", file=sys.stderr)
        return 1
    if arguments.write:
        document = DOCUMENT.read_text()
        before, _, rest = document.partition(BEGIN)
        _, _, after = rest.partition(END)
        DOCUMENT.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}")
    else:
        print(text)
    return 0


def tables() -> str:
    """Return the tables of the examples, and of the sketches for ros_lib on the AVRs.

    Raises:
        AssertionError: a compiler fails or warns.
    """
    messages()
    examples = [path / f"{path.name}.ino" for path in sorted(EXAMPLES.iterdir())]
    moved = sorted(MOVED.glob("*.ino"))
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(built, BOARDS))
        checked = [pool.submit(partial(_compiled_alone, family, path)) for family in COMPILERS for path in examples]
        own = _rows(pool, BOARDS, examples)
        ported = _rows(pool, (UNO, MEGA), [path for path in moved if path.stem != "tcp_hello_world"])
        for each in checked:
            each.result()
    return f"{_table('example', BOARDS, own)}\n\n{_table('sketch for ros_lib', (UNO, MEGA), ported)}"


def _rows(pool: ThreadPoolExecutor, families: tuple[Family, ...], sketches: list[Path]) -> list[list[str]]:
    cells = [[pool.submit(partial(_cell, family, sketch)) for family in families] for sketch in sketches]
    return [[f"`{sketch.stem}`", *(cell.result() for cell in row)] for sketch, row in zip(sketches, cells, strict=True)]


def _cell(family: Family, sketch: Path) -> str:
    name = sketch.stem
    if not family.fits(name):
        return "no WiFi"
    if not family.is_linked(name):
        compiled(family, sketch)
        return "compiles"
    try:
        flash, ram = image_bytes(family, sketch)
    except AssertionError as error:
        if TOO_LARGE in str(error):
            return "too large"
        raise
    if family.ram_bytes and ram > family.ram_bytes - STACK_BYTES:
        return "too large"
    return f"{flash:,} / {ram:,}"


def _compiled_alone(family: Family, sketch: Path) -> None:
    if family.fits(sketch.stem):
        compiled(family, sketch)


def _table(what: str, families: tuple[Family, ...], rows: list[list[str]]) -> str:
    head = [what, *(family.name for family in families)]
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    sys.exit(main())
