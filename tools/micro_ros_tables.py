"""Counts of a micro-ROS board over bad links, with slow loops, with noise and through restarts, in simulated time.

    python tools/micro_ros_tables.py            # print the tables
    python tools/micro_ros_tables.py --write    # write them into docs/micro-ros.md
    python tools/micro_ros_tables.py --seed 7   # with other faults

The board publishes an Odometry and an Imu at 50 Hz reliably for 12 s, and each publish blocks until it is acknowledged.
The host commands it, and stops it at the end. A seed gives the same tables on each machine.
"""

import argparse
import asyncio
import statistics
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostlink.core.protocol.xrce.protocol import MICRO_ROS_SERIAL, MICRO_ROS_TCP
from hostlink.core.robot.velocity import PlanarVelocity
from tests.support import xrce_board as board
from tests.support.background import meanwhile
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.waiting import expect
from tests.support.xrce_device import stock
from tests.support.xrce_drive import CATALOG, Drive
from tests.support.xrce_radio import RadioBoard

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "micro-ros.md"
BEGIN, END = "<!-- tools/micro_ros_tables.py -->", "<!-- end of the tables -->"
SEED = 1
DRIVE_S = 12.0
STAND_S = 4.0  # after the stop
NOISE_S = 0.005
POINTS = 40  # of restarts, in the board's first POINTS * STEP_S
STEP_S = 0.05
AWAY_S = 0.5
WITHIN_S = 25.0
SLOW_S = 0.1


@dataclass(frozen=True)
class Figures:
    """Counts of one drive. Times are in seconds; an empty list of ages has no figures."""

    published: int
    failed: int
    longest_s: float
    resent: int  # messages that the board sent again
    commanded: int
    taken: int  # of these commands
    ages_s: list[float]  # of the commands when the board took them, sorted
    zeros: int  # that the board took after the stop
    stood_s: float  # after the stop

    @property
    def median_s(self) -> float:
        """Median age of a command."""
        return statistics.median(self.ages_s)

    @property
    def p99_s(self) -> float:
        """99th percentile of the age of a command."""
        return self.ages_s[int(len(self.ages_s) * 0.99)]

    @property
    def cells(self) -> list[str]:
        """Cells of a row."""
        ages = f"{ms(self.median_s)}, {ms(self.p99_s)}" if self.ages_s else "-"
        zeros = f"{self.zeros}, {ms(self.stood_s)}" if self.zeros else "0, -"
        return [
            str(self.published),
            str(self.failed),
            ms(self.longest_s),
            str(self.resent),
            f"{self.commanded - self.taken} of {self.commanded}",
            ages,
            zeros,
        ]


HEAD = ["published", "failed", "longest, ms", "sent again", "commands not taken", "age median, p99, ms", "zeros, ms"]


def drive(seed: int, *, prepare: Callable[[Drive], None] | None = None, **given: Any) -> Figures:
    """Play one drive, and stop the board at its end. Options are those of `Drive` and of `xrce_board.Link`."""
    faults = {each: given.pop(each) for each in ("loss", "doubles", "overtakes") if each in given}
    played = Drive(board.Link(Random(seed), **faults), **given)  # noqa: S311 - a measurement that can be repeated
    played.stop_at(DRIVE_S)
    if prepare is not None:
        prepare(played)
    played.world.run(DRIVE_S + STAND_S)
    if played.board.failed_at:
        raise AssertionError(played.board.failed_at)
    published = [each for each in played.published() if each.at_s < DRIVE_S]
    moving = [(at_s, commanded_s) for at_s, commanded_s in played.board.taken if commanded_s]
    return Figures(
        published=len(published),
        failed=sum(not each.is_done for each in published),
        longest_s=max(each.took_s for each in published),
        resent=played.client.resent,
        commanded=len(played.commanded_s),
        taken=len({commanded_s for _, commanded_s in moving}),
        ages_s=sorted(at_s - commanded_s for at_s, commanded_s in moving),
        zeros=sum(not speed for _, speed in played.board.taken),
        stood_s=played.stood_s if played.board.taken else float("inf"),
    )


# -- loss and rate ----------------------------------------------------------------------------------------------------

LOSSES = (0.0, 0.05, 0.2)
RATES_HZ = (5, 20, 50)


def by_loss(seed: int) -> Iterator[list[str]]:
    """Yield a row for each loss and each rate of commands."""
    yield ["loss each way", "commands", *HEAD]
    for loss in LOSSES:
        for rate_hz in RATES_HZ:
            found = drive(seed, loss=loss, command_s=1 / rate_hz)
            yield [percent(loss), f"{rate_hz} Hz", *found.cells]


# -- boards and links -------------------------------------------------------------------------------------------------


class Deaf(board.Stock):
    """A board that reads nothing after it has begun, and publishes best effort."""

    def once(self) -> board.Program:
        """Create everything, and publish without ever reading."""
        client = self.client
        yield from client.connect()
        for id_, content, parent in self.objects():
            yield from client.create(id_, content, parent)
        client.read_data(self.COMMAND)
        self.is_running = True
        while True:
            client.publish_best_effort(self.IMU, self.imu)
            self.published.append(board.Published(client.now_s, 0.0, is_done=True))
            yield from self.pause(self.period_s)


def noise(played: Drive) -> None:
    """Send random bytes from the address of the board, 200 times a second."""
    dice = Random(2)  # noqa: S311 - a measurement that can be repeated

    def send() -> None:
        data = dice.randbytes(dice.choice((3, 40, 500)))
        if data[0] not in {0x81, 0x80}:  # else it is a message of the board's session
            played.world.send_to_host(data)
        played.world.at(played.world.now_s + NOISE_S, send)

    played.world.at(0.0, send)


def by_board(seed: int) -> Iterator[list[str]]:
    """Yield a row for each kind of board and link. Commands have 20 Hz."""
    rows: dict[str, dict[str, Any]] = {
        "UDP": {},
        "TCP": {"session": MICRO_ROS_TCP.session(CATALOG), "transport": board.Lengths()},
        "serial port": {"session": MICRO_ROS_SERIAL.session(CATALOG), "transport": board.Serial()},
        "serial port, 5 % of the frames damaged": {
            "session": MICRO_ROS_SERIAL.session(CATALOG),
            "transport": board.Serial(),
            "damage": 0.05,
        },
        "5 % overtaken, 5 % doubled": {"overtakes": 0.05, "doubles": 0.05},
        "5 % overtaken, 5 % doubled, 5 % lost": {"overtakes": 0.05, "doubles": 0.05, "loss": 0.05},
        "slow loop, 100 ms a turn": {"turn_s": SLOW_S, "period_s": SLOW_S},
        "slow loop, 5 % lost": {"turn_s": SLOW_S, "period_s": SLOW_S, "loss": 0.05},
        "reads nothing, publishes best effort": {"kind": Deaf},
        "random bytes from its address, 200 a second": {"prepare": noise},
    }
    yield ["board and link", *HEAD]
    for name, given in rows.items():
        yield [name, *drive(seed, **given).cells]
    driven, other = equal_boards(seed)
    yield ["two boards with one client key: the driven one", *driven.cells]
    yield ["the other one, without commands", *other.cells]


def equal_boards(seed: int) -> tuple[Figures, Figures]:
    """Drive one of two equal boards with equal keys behind a whole hub."""
    found: list[Figures] = []

    async def play(made: MemoryHub) -> None:
        dice = [Random(seed + each) for each in range(2)]  # noqa: S311 - a measurement that can be repeated
        first, second = (
            RadioBoard(made.hub, board.Link(each), f"10.0.0.{number}", stock(keeps=4))
            for number, each in enumerate(dice, 1)
        )
        async with meanwhile(first.run()), meanwhile(second.run()):
            loop, driver = asyncio.get_running_loop(), made.hub.join("driver")
            await expect(lambda: len(made.hub.robots.here()) == len((first, second)))
            await expect(lambda: first.stock.published and second.stock.published)
            robot = next(each for each in made.hub.robots.here() if each.link is first.link)
            commanded_s: list[float] = []
            while loop.time() < DRIVE_S:
                driver.drive(robot, PlanarVelocity(0.2, 0.0, 0.0))
                commanded_s.append(loop.time())
                await asyncio.sleep(0.05)
            robot.stop()
            stopped_s = loop.time()
            await asyncio.sleep(STAND_S)
        for each, sent_s in ((first, commanded_s), (second, [])):
            zeros = [at_s for at_s, speed in each.taken if not speed and at_s > stopped_s]
            published = [one for one in each.stock.published if one.at_s < DRIVE_S]
            found.append(
                Figures(
                    published=len(published),
                    failed=sum(not one.is_done for one in published),
                    longest_s=max(one.took_s for one in published),
                    resent=each.stock.client.resent,
                    commanded=len(sent_s),
                    taken=sum(speed > 0.0 for _, speed in each.taken),
                    ages_s=[],
                    zeros=len(zeros),
                    stood_s=zeros[0] - stopped_s if zeros else float("inf"),
                )
            )

    in_hub(play)
    first, second = found
    return first, second


# -- restarts ---------------------------------------------------------------------------------------------------------


def by_restart(seed: int) -> Iterator[list[str]]:
    """Yield a row for each side that restarts, at POINTS points of the board's first seconds and loss."""
    restarts: dict[str, Callable[[Drive, float], None]] = {
        "the board": lambda played, at_s: played.restart_board(at_s, AWAY_S),
        "the daemon, with its file": lambda played, at_s: played.restart_host(at_s, AWAY_S, has_state=True),
        "the daemon, without its file": lambda played, at_s: played.restart_host(at_s, AWAY_S, has_state=False),
    }
    yield ["what restarts", "loss each way", "points", "usable again", "median, s", "longest, s"]
    for name, restart in restarts.items():
        for loss in LOSSES[:2]:
            found = [restarted(seed, restart, number * STEP_S, loss, has_reconnect=True) for number in range(POINTS)]
            yield row_of_restart(f"{name}; the board has code to reconnect", loss, found)
    for loss in LOSSES[:2]:
        found = [
            restarted(seed, restarts["the daemon, with its file"], number * STEP_S, loss, has_reconnect=False)
            for number in range(POINTS)
        ]
        yield row_of_restart(
            "the daemon, with its file; the board has no code to reconnect, and is at work", loss, found
        )


def restarted(
    seed: int, restart: Callable[[Drive, float], None], at_s: float, loss: float, *, has_reconnect: bool
) -> float:
    """Restart one side at that time. A board without code to reconnect is at work before.

    Return the seconds from the return of that side until the board publishes and is driven.
    """
    played = Drive(board.Link(Random(seed), loss), has_reconnect=has_reconnect)  # noqa: S311 - as above
    while not (has_reconnect or played.board.published):
        played.world.run(played.world.now_s + STEP_S)
    at_s += played.world.now_s
    restart(played, at_s)
    played.world.run(at_s + AWAY_S)
    return played.run_until_usable(WITHIN_S)


def row_of_restart(name: str, loss: float, found: Sequence[float]) -> list[str]:
    """Return the cells of a row."""
    return [
        name,
        percent(loss),
        str(POINTS),
        str(len(found)),
        f"{statistics.median(found):.2f}",
        f"{max(found):.2f}",
    ]


# -- text -------------------------------------------------------------------------------------------------------------


def ms(seconds: float) -> str:
    """Return milliseconds as a whole number."""
    return "never" if seconds == float("inf") else f"{1000 * seconds:.0f}"


def percent(share: float) -> str:
    """Return a share in percent, as a whole number."""
    return f"{100 * share:.0f} %"


def table(rows: Iterable[Sequence[str]]) -> str:
    """Return the rows as a table of Markdown; the first one is its head."""
    head, *rest = rows
    lines = [head, ["---"] * len(head), *rest]
    return "\n".join(f"| {' | '.join(each)} |" for each in lines)


def text(seed: int = SEED) -> str:
    """Return all tables."""
    return "\n\n".join(table(rows(seed)) for rows in (by_loss, by_board, by_restart))


def written(document: str, tables: str) -> str:
    """Return the document with these tables between their marks."""
    before, _, rest = document.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n{tables}\n\n{END}{after}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=SEED, help="of what the link loses, doubles and delays")
    parser.add_argument("--write", action="store_true", help="write the tables into docs/micro-ros.md")
    wanted = parser.parse_args()
    tables = text(wanted.seed)
    print(tables)
    if wanted.write:
        DOCUMENT.write_text(written(DOCUMENT.read_text(), tables))


if __name__ == "__main__":
    main()
