"""What the firmware uses of the Due, against its budgets: printed after each build for the Cortex-M3, or it fails."""

import subprocess
import sys
from pathlib import Path

FLASH_BYTES = 64 * 1024  # of the Due's 512 K
RAM_BYTES = 16 * 1024  # static, of its 96 K
STACK_BYTES = 256  # of one function
HEAP = {"malloc", "free", "_malloc_r", "_sbrk", "_Znwj", "_Znaj", "_ZdlPv", "_ZdlPvj"}  # with operator new and delete


def main(elf: Path) -> int:
    text, data, bss = (int(number) for number in run("arm-none-eabi-size", elf).splitlines()[1].split()[:3])
    heap = sorted(HEAP & {line.split()[-1] for line in run("arm-none-eabi-nm", elf).splitlines()})
    stack_bytes, function = deepest(elf.parent / "CMakeFiles" / f"{elf.name}.dir")
    rows = (
        ("flash", text + data, FLASH_BYTES, ""),
        ("static RAM", data + bss, RAM_BYTES, ""),
        ("stack of a function", stack_bytes, STACK_BYTES, function),
        ("functions of the heap", len(heap), 0, " ".join(heap)),
    )
    for name, used, budget, remark in rows:
        print(f"{name:>21}: {used:6} of {budget:6}  {'OVER THE BUDGET  ' if used > budget else ''}{remark}")
    return 1 if any(used > budget for _, used, budget, _ in rows) else 0


def deepest(objects: Path) -> tuple[int, str]:
    """Bytes and name of the function with the largest frame (-fstack-usage); one without a bound is over the budget."""
    frames = []
    for file in objects.rglob("*.su"):
        for line in file.read_text().splitlines():
            place, number, kind = line.split("\t")
            bounded = int(number) if kind in ("static", "dynamic,bounded") else STACK_BYTES + 1
            frames.append((bounded, place.split(":", 3)[3]))
    return max(frames)


def run(tool: str, elf: Path) -> str:
    return subprocess.run([tool, elf], capture_output=True, text=True, check=True).stdout


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
