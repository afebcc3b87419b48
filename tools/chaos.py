"""A relay between devices and a host that splits, delays, loses, damages, cuts and reboots, by a seeded script.

    hostlink serve & python tools/chaos.py --at 10 cut --every 120 lose 1s --split 1-7 --delay 50±20ms --seed 7
    hostlink sim --connect 127.0.0.1:11412

Each option is a line of the script (tools/fault_script.py has the language); --script FILE reads more of them.
"""

import argparse
import asyncio
import json
import signal
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostlink.cli.addresses import parse_address
from hostlink.errors import ConfigError
from tools.fault_script import BadScript, parse
from tools.faults import Script
from tools.relay import Relay, TcpEnd, connect_tcp, listen_tcp

LINES = {
    "at": "TIME FAULT [NUMBER] [to-device|from-device]: once",
    "every": "TIME FAULT [NUMBER] [to-device|from-device]: again and again",
    "split": "BYTES: into pieces of so many",
    "merge": "TIME: what comes within it arrives as one",
    "delay": "TIME: all arrives later",
    "rate": "BYTES a second, at most",
    "for": "TIME: then the relay ends",
    "seed": "NUMBER: the same faults again",
}


def main() -> int:
    arguments = command_line().parse_args()
    lines = arguments.script.read_text().splitlines() if arguments.script else []
    for name in LINES:
        lines += [f"{name} {' '.join(words)}" for words in getattr(arguments, f"line_{name}") or []]
    try:
        script = parse(lines)
        listen = parse_address("--listen", arguments.listen, "127.0.0.1")
        to = parse_address("--to", arguments.to, "127.0.0.1")
        asyncio.run(relay(script, listen, to, EventPrinter(is_json=arguments.json)))
    except (BadScript, ConfigError, OSError) as error:
        print(f"chaos: {error}", file=sys.stderr)
        return 2
    return 0


def command_line() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--listen", default="127.0.0.1:11412", help="where devices connect (%(default)s)")
    parser.add_argument("--to", default="127.0.0.1:11411", help="where the host listens (%(default)s)")
    parser.add_argument("--script", type=Path, help="a file of such lines, without the --")
    parser.add_argument("--json", action="store_true", help="a JSON object a line")
    for name, text in LINES.items():
        parser.add_argument(f"--{name}", dest=f"line_{name}", action="append", nargs="+", metavar="WORD", help=text)
    return parser


class EventPrinter:
    """Prints what the relay did."""

    def __init__(self, *, is_json: bool) -> None:
        self._is_json = is_json
        self._began_s: float | None = None

    def log(self, what: str, facts: dict[str, Any]) -> None:
        """One line, with the time since the first."""
        now_s = asyncio.get_running_loop().time()
        self._began_s = now_s if self._began_s is None else self._began_s
        at_s = round(now_s - self._began_s, 3)
        if self._is_json:
            print(json.dumps({"at_s": at_s, "what": what, **facts}), flush=True)
        else:
            print(
                f"{at_s:9.3f} s  {what:<10} " + "  ".join(f"{name} {value}" for name, value in facts.items()),
                flush=True,
            )


async def relay(script: Script, listen: tuple[str, int], to: tuple[str, int], lines: EventPrinter) -> None:
    """Until the script ends, or Ctrl-C."""
    running = asyncio.current_task()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, running.cancel)  # type: ignore[union-attr]

    async def connect() -> TcpEnd:
        return await connect_tcp(*to)

    made = Relay(script, connect, lines.log)
    try:
        async with asyncio.TaskGroup() as tasks:

            def accept(device: TcpEnd) -> None:
                passages.append(tasks.create_task(made.serve(device)))
                passages[:] = [task for task in passages if not task.done()]

            passages: list[asyncio.Task[None]] = []
            async with await listen_tcp(accept, *listen) as server:
                where = "{}:{}".format(*server.sockets[0].getsockname()[:2])
                lines.log("listening", {"at": where, "to": "{}:{}".format(*to), "seed": script.seed})
                await made.run()
            for task in passages:
                task.cancel()
    except asyncio.CancelledError:  # Ctrl-C: what was done is still printed
        pass
    finally:
        lines.log("done", dict(sorted(made.counts.items())))


if __name__ == "__main__":
    sys.exit(main())
