"""The Due's firmware as a process or on an emulated Cortex-M3, alone or behind the ESP8266's sketch, on a daemon."""

import asyncio
import contextlib
import json
import re
import subprocess
from collections.abc import AsyncIterator
from functools import cache, partial
from pathlib import Path

import aiohttp

from tests.firmware import esp8266
from tests.support.driving import put_velocity
from tests.support.once import once
from tests.support.precedence import GOES_FIRST
from tests.support.process import Process, serve

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
BUILD = FIRMWARE.parent / "build" / "firmware"


def _build(preset: str, *targets: str) -> Path:
    once(f"firmware_{preset}", partial(_compile, preset, *targets), BUILD / preset)
    return BUILD / preset


def _compile(preset: str, *targets: str) -> None:
    for command in (["cmake", "--preset", preset], ["cmake", "--build", "--preset", preset, "--target", *targets]):
        done = subprocess.run(command, cwd=FIRMWARE, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


@cache
def build_native() -> Path:
    """The folder with due_native and the programs that test themselves."""
    return _build("native", "due_native", "due_test", "rosserial_test", "links_test")


@cache
def build_m3() -> Path:
    """The folder with due_m3.elf, built within its budgets, and due_script_m3.elf."""
    return _build("cortex-m3", "due_m3.elf", "due_script_m3.elf")


DRIVE_S = 20.0
TEXT_AT = 0x21000000  # where the emulated board reads a text: firmware/qemu/mps2.h
FACT = re.compile(r"(\w+) (-?[\d.]+)")


class Board:
    """A running firmware. `facts` is its last report: messages received and sent, and the true motion of its wheels."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.facts: dict[str, float] = {"left": 0.0, "right": 0.0}

    @property
    def speeds_ticks_s(self) -> tuple[float, float]:
        return self.facts["left"], self.facts["right"]

    async def listen(self) -> None:
        assert self.process.stdout is not None
        while line := await self.process.stdout.readline():
            found = {name: float(value) for name, value in FACT.findall(line.decode(errors="replace"))}
            if "rolled_mm" in found:  # one whole line
                self.facts = found

    async def expect_speed(self, least: float, most: float, within_s: float) -> None:
        async with asyncio.timeout(within_s):
            while True:
                if all(least <= speed <= most for speed in self.speeds_ticks_s):
                    return
                await asyncio.sleep(0.05)


def command(kind: str, port: int, world: Path | None = None) -> list[str | Path]:
    """`world`: a file of lines name=value; the emulated board reads it from a memory that is zero after it."""
    if kind == "native":
        return [build_native() / "due_native", "127.0.0.1", str(port), *(["38400", world] if world else [])]
    line = f"socket,id=line,host=127.0.0.1,port={port},nodelay=on,reconnect=1"  # to a restarted passthrough
    machine = ["qemu-system-arm", "-M", "mps2-an385", "-display", "none", "-monitor", "none"]
    serials = ["-chardev", line, "-serial", "chardev:line", "-serial", "stdio"]
    loader = ["-device", f"loader,force-raw=on,addr={TEXT_AT:#x},file={world}"] if world else []
    return [*machine, *loader, "-kernel", build_m3() / "due_m3.elf", *serials]


@contextlib.asynccontextmanager
async def board(kind: str, port: int, world: Path | None = None) -> AsyncIterator[Board]:
    process = await asyncio.create_subprocess_exec(
        *GOES_FIRST, *command(kind, port, world), stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE
    )
    made = Board(process)
    try:
        async with asyncio.TaskGroup() as tasks:
            listening = tasks.create_task(made.listen())
            yield made
            listening.cancel()
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()


async def drive(daemon: Process, made: Board, linear: float, *, until_ticks_s: float) -> None:
    """Command ten times a second until both wheels have reached this speed."""
    url = f"{daemon.url}/api/robots/robot_0"
    async with aiohttp.ClientSession() as session, asyncio.timeout(DRIVE_S):
        while min(made.speeds_ticks_s) < until_ticks_s:
            async with session.get(url) as response:
                epoch = (await response.json())["epoch"]
            velocity = {"linear": linear, "angular": 0.0, "epoch": epoch}
            await put_velocity(session, url, json.dumps(velocity).encode())
            await asyncio.sleep(0.1)


@contextlib.asynccontextmanager
async def chain(
    kind: str, *arguments: str, with_esp: bool, world: Path | None = None
) -> AsyncIterator[tuple[Process, Board]]:
    command(kind, 0)  # built before the daemon's timers start
    async with serve(*arguments) as daemon:
        if with_esp:
            with esp8266.running("esp8266_native", daemon.tcp[1]) as sketch:
                async with board(kind, sketch.uart_port, world) as made:
                    yield daemon, made
        else:
            async with board(kind, daemon.tcp[1], world) as made:
                yield daemon, made
