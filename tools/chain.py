"""The paper's chain on one PC, until Ctrl-C: hostlink <- TCP <- ESP8266 sketch <- UART 38400 <- Due firmware.

The Due is a Cortex-M3 that QEMU emulates, or a process of this PC (--native). `hostlink teleop` and the page drive it.
"""

import argparse
import contextlib
import json
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FIRMWARE = ROOT / "firmware"
BUILD = ROOT / "build" / "firmware"
END_S = 3.0
READ_CHARS = 4096


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--native", action="store_true", help="the Due's firmware as a process instead of on QEMU")
    parser.add_argument("--listen", default="127.0.0.1:11411", help="where devices connect")
    parser.add_argument("--api", default="127.0.0.1:9090", help="where programs connect")
    parser.add_argument("--world", type=Path, help="a file of lines name=value: the numbers of the robot's world")
    arguments = parser.parse_args()
    build("native", "due_native", "esp8266_native")
    if not arguments.native:
        build("cortex-m3", "due_m3.elf")
    with contextlib.ExitStack() as parts, contextlib.suppress(KeyboardInterrupt):
        hostlink = Path(sys.executable).parent / "hostlink"
        serve = parts.enter_context(
            running(hostlink, "serve", "--listen", arguments.listen, "--api", arguments.api, "--log-level", "warning")
        )
        esp = parts.enter_context(
            running(BUILD / "native" / "esp8266" / "esp8266_native", "--server", arguments.listen, "--wait-for-device")
        )
        port = uart_port(esp)
        due = parts.enter_context(running(*due_command(port, arguments.world, is_native=arguments.native)))
        where = "this PC" if arguments.native else "an emulated Cortex-M3"
        print(f"hostlink <- TCP {arguments.listen} <- ESP8266 sketch <- UART 38400 <- Due firmware on {where}")
        print(f"page: http://{arguments.api}   drive: hostlink teleop --url http://{arguments.api}   Ctrl-C ends it")
        return watch({"hostlink serve": serve, "the ESP8266 sketch": esp, "the Due firmware": due})
    print("\nended")
    return 0


def build(preset: str, *targets: str) -> None:
    """Compile what has changed."""
    print(f"building {', '.join(targets)} ...")
    for command in (["cmake", "--preset", preset], ["cmake", "--build", "--preset", preset, "--target", *targets]):
        done = subprocess.run(command, cwd=FIRMWARE, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(done.stdout + done.stderr)


def due_command(port: int, world: Path | None, *, is_native: bool) -> list[str | Path]:
    if is_native:
        return [BUILD / "native" / "due_native", "127.0.0.1", str(port), *(["38400", world] if world else [])]
    line = f"tcp:127.0.0.1:{port},nodelay=on"
    machine = ["qemu-system-arm", "-M", "mps2-an385", "-display", "none", "-monitor", "none"]
    # Text in a memory that is zero: the last line needs no end of its own.
    loader = ["-device", f"loader,force-raw=on,addr=0x21000000,file={world}"] if world else []
    return [*machine, *loader, "-kernel", BUILD / "cortex-m3" / "due_m3.elf", "-serial", line, "-serial", "null"]


class Part:
    """A running part of the chain. What it prints is read all the time: a full pipe would stop it."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self._lines: queue.Queue[str] = queue.Queue(maxsize=1)  # the first
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def line(self, within_s: float = END_S) -> str:
        """The first line that it printed; empty when it ended without one."""
        with contextlib.suppress(queue.Empty):
            return self._lines.get(timeout=within_s)
        return ""

    def join(self) -> None:
        """Wait until all was read of a part that has ended."""
        self._reader.join(END_S)

    def _read(self) -> None:
        pipe = self.process.stdout
        if pipe is None:
            return
        self._lines.put(pipe.readline())
        while pipe.read(READ_CHARS):
            pass


@contextlib.contextmanager
def running(*command: str | Path) -> Iterator[Part]:
    """A part of the chain; it ends with the block."""
    pipe = subprocess.PIPE
    with subprocess.Popen([str(word) for word in command], stdin=pipe, stdout=pipe, text=True) as process:
        part = Part(process)
        try:
            yield part
        finally:
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(END_S)
            process.kill()
            part.join()


def uart_port(esp: Part) -> int:
    """The sketch prints the port of its UART."""
    line = esp.line()
    if not line:
        sys.exit("the ESP8266 sketch ended at once: is something else on its ports?")
    return int(json.loads(line)["port"])


def watch(parts: dict[str, Part]) -> int:
    """Wait until a part ends, which none should."""
    while True:
        for name, part in parts.items():
            with contextlib.suppress(subprocess.TimeoutExpired):
                print(f"{name} ended with status {part.process.wait(0.3)}", file=sys.stderr)
                return 1


if __name__ == "__main__":
    sys.exit(main())
