"""Flash and RAM of the firmware against what they may take, and no heap: run after each build for the Cortex-M3."""

import subprocess
import sys

FLASH_BYTES = 64 * 1024  # of the Due's 512 K
RAM_BYTES = 16 * 1024  # static, of its 96 K
FORBIDDEN = ("malloc", "free", "_Znwj", "_Znaj", "_ZdlPv")


def main(elf: str) -> int:
    size = subprocess.run(["arm-none-eabi-size", elf], capture_output=True, text=True, check=True).stdout
    text, data, bss = (int(number) for number in size.splitlines()[1].split()[:3])
    symbols = subprocess.run(["arm-none-eabi-nm", elf], capture_output=True, text=True, check=True).stdout
    heap = [line.split()[-1] for line in symbols.splitlines() if line.split()[-1] in FORBIDDEN]
    return 1 if text + data > FLASH_BYTES or data + bss > RAM_BYTES or heap else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
