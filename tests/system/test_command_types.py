"""A board of each type of command, at a daemon that is a process: what it receives when a source, or the daemon, ends.

`pytest -s -k rests` prints the row of each type in the table of docs/reliability.md.
"""

import asyncio
import contextlib
import os
import signal
import socket
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.robot.velocity_gate import ZEROS
from tests.support.background import meanwhile
from tests.support.command_boards import BOARDS, Board
from tests.support.participants import ROBOT
from tests.support.process import Process, serve
from tests.support.ros_lib_reader import RosLibReader
from tests.support.waiting import TIMEOUT_S, expect, is_true_within

HERE = "127.0.0.1"
FASTEST = 1.0  # m/s or rad/s: the usual limit, and the end of an axis
COMMAND_INTERVAL_S = 0.05
LET_GO_S = 1.5 * LEASE_S
TRY_S = 2.0  # a busy machine delays a command: it is refused, and the program must let go

WHEELS = f'[robots.{ROBOT}.wheels]\nunit = "m_s"\n'
#: The settings that make a robot of each board of BOARDS that is none by itself.
SETTINGS = {
    "wheels by topics": f'{WHEELS}topics = ["/left", "/right"]',
    "wheels by an array": f'{WHEELS}topics = ["/{ROBOT}/cmd"]',
    "wheels by a JointState": f'{WHEELS}topics = ["/{ROBOT}/cmd"]\njoints = ["l", "r"]',
    "Joy": f'[robots.{ROBOT}.joy]\ntopic = "/{ROBOT}/cmd"',
    "throttle and steering": f'[robots.{ROBOT}.throttle]\ntopics = ["/throttle", "/steering"]',
    "Vector3": f'[robots.{ROBOT}.vector]\ntopic = "/{ROBOT}/cmd"',
    "words": f'[robots.{ROBOT}.words]\ntopic = "/{ROBOT}/cmd"\n'
    'forward = "F"\nbackward = "B"\nleft = "L"\nright = "R"\nstop = "S"',
}
TWIST = {"linear": {"x": 50.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
ACKERMANN = {"steering_angle": 3.0, "speed": 50.0}
LAYOUT: dict[str, Any] = {"dim": [], "data_offset": 0}
#: 50 m/s as a program publishes it in the board's own type.
TOO_FAST: dict[str, dict[str, Any]] = {
    "geometry_msgs/Twist": TWIST,
    "geometry_msgs/TwistStamped": {"twist": TWIST},
    "ackermann_msgs/AckermannDrive": ACKERMANN,
    "ackermann_msgs/AckermannDriveStamped": {"drive": ACKERMANN},
    "std_msgs/Float32": {"data": 50.0},
    "std_msgs/Float32MultiArray": {"layout": LAYOUT, "data": [50.0, 50.0]},
    "sensor_msgs/JointState": {"name": ["l", "r"], "velocity": [50.0, 50.0]},
    "sensor_msgs/Joy": {"axes": [50.0] * 8, "buttons": [1] * 11},
    "geometry_msgs/Vector3": {"x": 50.0, "y": 0.0, "z": 0.0},
    "std_msgs/String": {"data": "faster"},
}


@dataclass
class Heard:
    """Messages of a board's topics, by the number of the topic, and whether each commands no motion."""

    board: Board
    messages: list[tuple[float, int, bytes]] = field(default_factory=list)  # with time.monotonic
    ends: list[float] = field(default_factory=list)  # when id 11 came
    is_off: bool = False  # it does nothing more, and its connection stays

    def since(self, mark: int) -> list[tuple[int, bool]]:
        """Return the topic of each message from this one on, and whether it commands no motion."""
        return [(topic, self.board.is_at_rest(topic, payload)) for _, topic, payload in self.messages[mark:]]

    def zeros(self, mark: int) -> int:
        """Return how many zeros each topic has heard at least after the last motion, from this message on."""
        counts = Counter[int]()
        for topic, is_at_rest in self.since(mark):
            counts[topic] = counts[topic] + 1 if is_at_rest else 0
        return min(counts[topic] for topic in range(len(self.board.types)))

    def rest_s(self, since_s: float) -> float:
        """Return the time until the zero after which no topic heard a motion."""
        moved = [at for at, (_, _, _) in enumerate(self.messages) if not self.since(at)[0][1]]
        rest = [at_s for at_s, _, _ in self.messages[moved[-1] + 1 if moved else 0 :]]
        return max(rest[0] - since_s, 0.0)

    @property
    def is_moving(self) -> bool:
        """Whether the newest message of any topic commands a motion."""
        newest = {topic: payload for _, topic, payload in self.messages}
        return any(not self.board.is_at_rest(topic, payload) for topic, payload in newest.items())

    @property
    def largest(self) -> float:
        """The largest number that any topic has heard."""
        return max(self.board.largest(topic, payload) for _, topic, payload in self.messages)


@contextlib.asynccontextmanager
async def connected(address: tuple[str, int], board: Board) -> AsyncIterator[Heard]:
    """A board on TCP without a watchdog, which reads as ros_lib does; until the end of the block."""
    loop, heard = asyncio.get_running_loop(), Heard(board)

    def receive(topic_id: int, payload: bytes) -> None:
        if heard.is_off:
            return
        if topic_id == Id.PUBLISHER:
            infos = b"".join(encode(info.kind, encode_topic_info(info)) for info in board.infos)
            connection.send(encode(Id.TIME, bytes(8)) + infos + encode(Id.TIME, bytes(8)))
        elif topic_id == Id.STOP:
            heard.ends.append(time.monotonic())
        elif topic_id >= 100:
            heard.messages.append((time.monotonic(), topic_id - 100, payload))

    async def read() -> None:
        reader = RosLibReader(receive, gives_up=False)
        with contextlib.suppress(ConnectionError):
            while data := await loop.sock_recv(connection, 65536):
                reader.turn(data, time.monotonic())

    with socket.create_connection(address) as connection:
        connection.setblocking(False)
        async with meanwhile(read()):
            yield heard


@dataclass
class Program:
    """A program on the WebSocket that commands full speed forwards while it drives."""

    socket: aiohttp.ClientWebSocketResponse
    is_let_go: bool = False

    async def command(self) -> None:
        """Command until cancelled."""
        with contextlib.suppress(ConnectionError):
            while True:
                if not self.is_let_go:
                    await self.socket.send_json({"op": "drive", "robot": ROBOT, "linear": 50.0, "angular": 0.0})
                await asyncio.sleep(COMMAND_INTERVAL_S)

    async def let_go(self) -> None:
        """Command nothing for longer than a lease."""
        self.is_let_go = True
        await asyncio.sleep(LET_GO_S)
        self.is_let_go = False

    async def moves(self, heard: Heard) -> None:
        """Wait until the board moves."""
        async with asyncio.timeout(TIMEOUT_S):
            while not await is_true_within(lambda: heard.is_moving, TRY_S):
                await self.let_go()


@contextlib.asynccontextmanager
async def program(daemon: Process) -> AsyncIterator[Program]:
    """A program that drives; at the end of the block its connection is cut."""
    async with aiohttp.ClientSession() as session:
        connection = await session.ws_connect(daemon.url)
        driving = Program(connection)
        async with meanwhile(driving.command()):
            yield driving
        connection._response.close()  # without the closing handshake


Rest = Callable[[Process, Program, Heard], Awaitable[None]]


async def end_of_lease(_: Process, driver: Program, heard: Heard) -> None:
    driver.is_let_go = True
    await expect(lambda: not heard.is_moving)


async def stop(daemon: Process, driver: Program, heard: Heard) -> None:
    await daemon.post(f"/api/robots/{ROBOT}/stop?wait_s=0")
    await stays_at_rest(heard)
    await driver.let_go()


async def lock(daemon: Process, driver: Program, heard: Heard) -> None:
    await daemon.post(f"/api/robots/{ROBOT}/lock?wait_s=0", {"reason": "smoke"})
    await stays_at_rest(heard)
    await driver.let_go()
    await stays_at_rest(heard)
    await daemon.post(f"/api/robots/{ROBOT}/unlock")


async def stays_at_rest(heard: Heard) -> None:
    """Check that only zeros come while the program commands on: what was sent before has come."""
    await asyncio.sleep(0.1)
    mark = len(heard.messages)
    await asyncio.sleep(LEASE_S)
    assert all(is_at_rest for _, is_at_rest in heard.since(mark))


@pytest.mark.long
@pytest.mark.parametrize("name", BOARDS)
async def test_a_board_of_each_command_type_rests_when_its_source_ends(name: str, tmp_path: Path) -> None:
    board = BOARDS[name]
    settings = tmp_path / "hostlink.toml"
    settings.write_text(f'[robots.{ROBOT}]\naddress = "{HERE}"\n{SETTINGS.get(name, "")}\n')
    row: dict[str, str] = {}
    async with serve("--config", str(settings)) as daemon, connected(daemon.tcp, board) as heard:
        assert (await daemon.logged("robot.appeared"))["robot"] == ROBOT
        await expect(lambda: heard.zeros(0) >= ZEROS)  # the first that a board hears
        async with program(daemon) as driver:
            for cause in (end_of_lease, stop, lock):
                driver.is_let_go = False
                await driver.moves(heard)
                mark, began_s = len(heard.messages), time.monotonic()
                await cause(daemon, driver, heard)
                await expect(lambda mark=mark: heard.zeros(mark) >= ZEROS)
                row[cause.__name__] = f"{heard.rest_s(began_s):.2f} s"
            await driver.let_go()
            await publishes_too_fast(driver, heard)
            row["limit"] = f"{heard.largest:g}"
            assert heard.largest <= FASTEST
            await driver.moves(heard)
            mark, began_s = len(heard.messages), time.monotonic()
        await expect(lambda: heard.zeros(mark) >= ZEROS)  # the end of the source
        row["end of the source"] = f"{heard.rest_s(began_s):.2f} s"
        async with program(daemon) as driver:
            await driver.moves(heard)
            heard.is_off = True  # the board has restarted: its earlier connection looks alive
            async with connected(daemon.tcp, board) as again:
                await expect(lambda: again.zeros(0) >= ZEROS)
                await stays_at_rest(again)
                assert all(is_at_rest for _, is_at_rest in again.since(0))
                row["reboot"] = "zeros only"
                await driver.let_go()
                await driver.moves(again)
                began_s = time.monotonic()
                os.kill(daemon.pid, signal.SIGKILL)
                await expect(lambda: again.ends)
                assert again.zeros(0) >= ZEROS
                assert not again.is_moving
                row["kill -9"] = f"{again.rest_s(began_s):.2f} s"
    print(name, row)  # noqa: T201 - the table


async def publishes_too_fast(driver: Program, heard: Heard) -> None:
    """Publish 50 m/s in the board's own types, and hear that a command within the limits follows, or nothing."""
    board = heard.board
    driver.is_let_go = True
    for topic, type_name in zip(board.names, board.types, strict=True):
        await driver.socket.send_json({"op": "advertise", "topic": topic, "type": type_name})
        for _ in range(5):
            await driver.socket.send_json({"op": "publish", "topic": topic, "msg": TOO_FAST[type_name]})
            await asyncio.sleep(COMMAND_INTERVAL_S)
    mark = len(heard.messages)
    await expect(lambda: not heard.is_moving)
    await driver.let_go()
    await expect(lambda: heard.zeros(mark) >= ZEROS or not heard.since(mark))
