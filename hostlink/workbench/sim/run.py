"""Simulated robots in real time, connected to a host over TCP, UDP or a pair of streams.

Over UDP, a datagram has the bytes that left the UART together, as a passthrough sends them.
"""

import asyncio
import contextlib
import functools
import itertools
import socket
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any

from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.runtime.cancellation import meanwhile
from hostlink.errors import system_text
from hostlink.workbench.sim.board import SimulatedBoard
from hostlink.workbench.sim.firmware_module import WorldParameters
from hostlink.workbench.sim.firmware_world import RobotKind
from hostlink.workbench.sim.kinematic_robot import DRIVES, KinematicRobot
from hostlink.workbench.sim.robot import HEALTHY, Fault, FaultyLine, SimulatedRobot

SocketAddress = tuple[Any, ...]  # host and port, and for IPv6 two more

READ_BYTES = 4096
RECONNECT_S = 0.5
LINE_POLL_S = 0.004  # interval at which bytes from the UART are sent, as in an ESP8266's loop
SEND_BYTES = 1 << 16  # that may wait for a host; further bytes are lost
CHECK_S = 0.05
TIME_REQUEST = encode(Id.TIME, bytes(8))
GREETING_S = 1.0  # interval of the first datagrams: a host over UDP does not know a silent device
UNANSWERED = 2  # datagrams without an answer, after which the user is told
USER_TIMEOUT_MS = 5000  # the host is gone when sent data stays unacknowledged for longer


async def run_fleet(
    host: str,
    port: int,
    *,
    robots: int = 1,
    first: int = 0,
    is_udp: bool = False,
    fault: Fault = HEALTHY,
    world: WorldParameters | None = None,
    kind: RobotKind = RobotKind.PAPER,
    kinematics: str | None = None,
    log: Callable[[str], None] = lambda _: None,
    on_connected: Callable[[str, SocketAddress], None] = lambda _name, _address: None,
) -> None:
    """Run robot_0, robot_1, ... until cancelled. Each robot reconnects when its connection ends.

    With `kinematics` they have that drive in a world of kinematics, else the firmware in its world.

    Over TCP, `on_connected` is called with the robot's name and its own end of each new connection.
    """
    waiting = (
        f"no answer from {host}:{port} over UDP for {UNANSWERED * GREETING_S:g} s, waiting; "
        f"`hostlink serve --udp {port}` starts a host with UDP"
    )
    say_waiting = functools.cache(functools.partial(log, waiting))  # once for all robots
    async with asyncio.TaskGroup() as tasks:
        for number in range(first, first + robots):
            name = f"robot_{number}"
            robot: SimulatedBoard
            if kinematics is None:
                robot = SimulatedRobot(name, world=world_of(number, world), kind=kind, clock_rate=fault.clock_rate)
            else:
                robot = KinematicRobot(name, DRIVES[kinematics], clock_rate=fault.clock_rate)
            if is_udp:
                running = run_over_udp(robot, host, port, fault=fault, log=log, on_unanswered=say_waiting)
            else:
                running = run_over_tcp(robot, host, port, fault=fault, log=log, on_connected=on_connected)
            tasks.create_task(running, name=robot.name)


def world_of(number: int, world: WorldParameters | None) -> WorldParameters:
    """Return the world of robot `number`, with its own random numbers."""
    parameters = WorldParameters() if world is None else world
    return parameters.changed({"seed": (parameters["seed"] + number) % 2**32})


async def run_over_tcp(
    robot: SimulatedBoard,
    host: str,
    port: int,
    *,
    fault: Fault = HEALTHY,
    local_host: str | None = None,
    log: Callable[[str], None] = lambda _: None,
    on_connected: Callable[[str, SocketAddress], None] = lambda _name, _address: None,
) -> None:
    """Keep the robot connected (from `local_host`) until cancelled. The firmware runs meanwhile."""
    local = None if local_host is None else (local_host, 0)
    last_error = ""
    async with _switched_on(robot, fault) as board:
        while True:
            try:
                reader, writer = await asyncio.open_connection(host, port, local_addr=local)
            except OSError as error:
                if last_error != str(error):
                    last_error = str(error)
                    log(f"{robot.name}: waiting for a host at {host}:{port}: {system_text(error)}")
            else:
                last_error = ""
                _give_up_soon(writer)
                on_connected(robot.name, writer.get_extra_info("sockname"))
                log(f"{robot.name}: connected to {host}:{port}; `hostlink robots` shows its name there")
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(fault.runs_s):
                        await _talk(board, reader, writer)
                    log(f"{robot.name}: the host closed the connection")
                if fault.runs_s is not None:
                    robot.reboot()
            await asyncio.sleep(RECONNECT_S)


async def run_over_udp(
    robot: SimulatedBoard,
    host: str,
    port: int,
    *,
    fault: Fault = HEALTHY,
    log: Callable[[str], None] = lambda _: None,
    on_unanswered: Callable[[], None] = lambda: None,
) -> None:
    """Keep the robot sending to the host until cancelled, also while the host does not answer.

    `on_unanswered` is called after the first UNANSWERED datagrams of a socket without an answer.
    """
    last_error = ""
    async with _switched_on(robot, fault) as board:
        while True:
            try:
                async with asyncio.timeout(fault.runs_s):
                    await _talk_over_udp(board, host, port, log=log, on_unanswered=on_unanswered)
            except TimeoutError:
                robot.reboot()
            except OSError as error:  # the address does not exist, or cannot be reached
                if last_error != str(error):
                    last_error = str(error)
                    log(f"{robot.name}: cannot send to {host}:{port}: {system_text(error)}")
            await asyncio.sleep(RECONNECT_S)


def _give_up_soon(writer: asyncio.StreamWriter) -> None:
    """Detect a changed network early. By default, Linux retries for a quarter of an hour."""
    option = getattr(socket, "TCP_USER_TIMEOUT", None)  # not every system has it
    if option is not None:
        writer.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, option, USER_TIMEOUT_MS)


async def run_over_streams(
    robot: SimulatedBoard, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, fault: Fault = HEALTHY
) -> None:
    """Run the robot on an open connection until the connection ends."""
    async with _switched_on(robot, fault) as board:
        await _talk(board, reader, writer)


class _Board:
    """Switched-on robot whose firmware runs in real time, connected or not."""

    def __init__(self, robot: SimulatedBoard, fault: Fault) -> None:
        self.robot = robot
        self.fault = fault
        self._send: Callable[[bytes], None] | None = None
        self._loop = asyncio.get_running_loop()
        self._failed: asyncio.Future[None] = self._loop.create_future()
        self._timer = self._loop.call_soon(self._poll)

    async def run(self) -> None:
        """Wait until cancelled. Raise the error that ended the firmware."""
        await self._failed

    def switch_off(self) -> None:
        """Stop the firmware."""
        self._timer.cancel()

    def receive(self, data: bytes) -> None:
        """Pass bytes from the host to the robot."""
        self._advance()
        self.robot.send(data)
        self._timer.cancel()
        self._timer = self._loop.call_later(LINE_POLL_S, self._poll)

    @contextlib.contextmanager
    def connected(self, send: Callable[[bytes], None]) -> Iterator[None]:
        """Send the UART's bytes, changed by the fault, within the block. Without a connection they are lost."""
        line = FaultyLine(self.fault)
        self._advance()
        self._send = lambda data: send(line.pass_on(data))
        try:
            yield
        finally:
            self._send = None
            self.robot.cut()

    def _poll(self) -> None:
        try:
            self._advance()
        except Exception as error:  # noqa: BLE001 - raised by `run`
            self._failed.set_exception(error)
        else:
            self._timer = self._loop.call_later(self.robot.quiet_s or LINE_POLL_S, self._poll)

    def _advance(self) -> None:
        data = self.robot.advance(self._loop.time())
        if self._send is not None:
            self._send(data)


@contextlib.asynccontextmanager
async def _switched_on(robot: SimulatedBoard, fault: Fault) -> AsyncIterator[_Board]:
    """Run the robot's firmware within the block."""
    if isinstance(robot, SimulatedRobot):
        fault.break_wheel(robot.world.left)
    board = _Board(robot, fault)
    async with meanwhile((f"{robot.name} board", board.run())):
        try:
            yield board
        finally:
            board.switch_off()


async def _talk(board: _Board, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Carry bytes between the robot's UART and the connection until the connection ends."""

    def send(data: bytes) -> None:
        if data and writer.transport.get_write_buffer_size() < SEND_BYTES:  # otherwise the host does not read
            writer.write(data)

    try:
        with board.connected(send):
            while data := await reader.read(READ_BYTES):
                board.receive(data)
    except OSError:
        pass  # the host is gone; the caller decides whether to reconnect
    finally:
        writer.close()
        with contextlib.suppress(OSError):  # it would hide a cancellation
            await writer.wait_closed()


async def _talk_over_udp(
    board: _Board, host: str, port: int, *, log: Callable[[str], None], on_unanswered: Callable[[], None]
) -> None:
    """Exchange datagrams from an own socket until the robot has lost its host by silence."""
    robot = board.robot
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: _FromHost(board), remote_addr=(host, port)
    )

    def send(data: bytes) -> None:
        if data:
            transport.sendto(data)

    try:
        with board.connected(send):
            for sent in itertools.count():
                if robot.is_configured:
                    break
                if sent == UNANSWERED:
                    on_unanswered()
                send(FaultyLine(board.fault).pass_on(TIME_REQUEST))
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(GREETING_S):
                        await _until(lambda: robot.is_configured)
            log(f"{robot.name}: {host}:{port} has answered; `hostlink robots` shows its name there")
            await _until(lambda: not robot.is_configured)
    finally:
        transport.close()
    log(f"{robot.name}: {host}:{port} no longer answers")


async def _until(is_so: Callable[[], bool]) -> None:
    while not is_so():  # noqa: ASYNC110 - the firmware has no events
        await asyncio.sleep(CHECK_S)


class _FromHost(asyncio.DatagramProtocol):
    """Receiver of datagrams for the robot's UART. ICMP errors are ignored: silence shows the same."""

    def __init__(self, board: _Board) -> None:
        self._board = board

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:  # noqa: ARG002 - asyncio's signature
        self._board.receive(data)
