"""Runs simulated robots in real time against a host: over TCP, as their ESP8266 would, UDP, or any pair of streams."""

import asyncio
import contextlib
import os
import socket
from collections.abc import AsyncIterator, Callable

from hostlink.cancellation import raise_if_cancelled
from hostlink.messages.catalog import Catalog
from hostlink.sim.controller import LOOP_S, RobotKind
from hostlink.sim.device import SimulatedDevice
from hostlink.sim.faults import HEALTHY, Fault, FaultyLine
from hostlink.sim.robot import SimulatedRobot
from hostlink.sim.udp import LINE_POLL_S, RETRY_S, talk_over_udp
from hostlink.sim.world_parameters import WorldParameters
from hostlink.sim.worlds import AnyWorld, open_world

READ_BYTES = 4096
RECONNECT_S = 0.5
USER_TIMEOUT_MS = 5000  # sent and not acknowledged: the host is gone


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
    log: Callable[[str], None] = lambda _: None,
) -> None:
    """Run robot_0, robot_1, ... until cancelled; each connects again when its connection ends."""
    catalog = Catalog()
    async with asyncio.TaskGroup() as tasks:
        for number in range(first, first + robots):
            device = SimulatedDevice(clock_rate=fault.clock_rate)
            robot = SimulatedRobot(
                f"robot_{number}", catalog, device=device, world=world_of(number, world), temper=kind.temper
            )
            run = run_over_udp if is_udp else run_over_tcp
            tasks.create_task(run(robot, host, port, fault=fault, log=log), name=robot.name)


def world_of(number: int, world: WorldParameters | None) -> AnyWorld:
    """Each robot has its own random numbers."""
    parameters = WorldParameters() if world is None else world
    return open_world(parameters.changed({"seed": (parameters.seed + number) % 2**32}))


async def run_over_tcp(
    robot: SimulatedRobot,
    host: str,
    port: int,
    *,
    fault: Fault = HEALTHY,
    local_host: str | None = None,
    log: Callable[[str], None] = lambda _: None,
) -> None:
    """Connect (from `local_host`), talk, connect again, until cancelled; the robot's own loop never stops."""
    local = None if local_host is None else (local_host, 0)
    last_error = ""
    fault.break_wheel(robot.wheels[0])
    async with _alive(robot):
        while True:
            try:
                reader, writer = await asyncio.open_connection(host, port, local_addr=local)
            except OSError as error:
                if last_error != str(error):
                    last_error = str(error)
                    why = os.strerror(error.errno) if error.errno else error
                    log(f"{robot.name}: waiting for a host at {host}:{port}: {why}")
            else:
                last_error = ""
                _give_up_soon(writer)
                log(f"{robot.name}: connected to {host}:{port}")
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(fault.runs_s):
                        await _talk(robot, reader, writer, fault)
                    log(f"{robot.name}: the host closed the connection")
                if fault.runs_s is not None:
                    robot.reboot()
            await asyncio.sleep(RECONNECT_S)


async def run_over_udp(
    robot: SimulatedRobot,
    host: str,
    port: int,
    *,
    fault: Fault = HEALTHY,
    local_host: str | None = None,
    log: Callable[[str], None] = lambda _: None,
) -> None:
    """Send to the host (from `local_host`), whether it is there or not, until cancelled."""
    last_error = ""
    fault.break_wheel(robot.wheels[0])
    async with _alive(robot):
        while True:
            try:
                async with asyncio.timeout(fault.runs_s):
                    await talk_over_udp(robot, host, port, fault=fault, local_host=local_host, log=log)
            except TimeoutError:
                robot.reboot()
            except OSError as error:  # no such address, or no way there
                if last_error != str(error):
                    last_error = str(error)
                    log(f"{robot.name}: cannot send to {host}:{port}: {error.strerror or error}")
            await asyncio.sleep(RETRY_S)


def _give_up_soon(writer: asyncio.StreamWriter) -> None:
    """A robot whose network has changed under it finds out; Linux alone would try for a quarter of an hour."""
    option = getattr(socket, "TCP_USER_TIMEOUT", None)  # not every system has it
    if option is not None:
        writer.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, option, USER_TIMEOUT_MS)


async def run_over_streams(
    robot: SimulatedRobot, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, fault: Fault = HEALTHY
) -> None:
    """Run the robot on an open connection until that ends."""
    fault.break_wheel(robot.wheels[0])
    async with _alive(robot):
        await _talk(robot, reader, writer, fault)


@contextlib.asynccontextmanager
async def _alive(robot: SimulatedRobot) -> AsyncIterator[None]:
    """The robot's loop turns for the length of the block."""
    async with asyncio.TaskGroup() as tasks:
        loop = tasks.create_task(_turn(robot), name=f"{robot.name} loop")
        try:
            yield
        finally:
            loop.cancel()


async def _talk(
    robot: SimulatedRobot, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, fault: Fault
) -> None:
    """Carry bytes between the robot's UART and the connection, until one of them ends it."""
    now_s = asyncio.get_running_loop().time
    try:
        async with asyncio.TaskGroup() as tasks:
            passing = tasks.create_task(_pass_on(robot, writer, fault), name=f"{robot.name} UART")
            try:
                while data := await reader.read(READ_BYTES):
                    robot.device.from_host.send(data, now_s())
            finally:
                passing.cancel()
    except* OSError:
        pass  # the host is gone; the caller decides what next
    finally:
        robot.device.from_host.cut()
        robot.device.to_host.cut()
        writer.close()
        with contextlib.suppress(OSError):  # it would hide a cancellation
            await writer.wait_closed()
    raise_if_cancelled()


async def _pass_on(robot: SimulatedRobot, writer: asyncio.StreamWriter, fault: Fault) -> None:
    now_s = asyncio.get_running_loop().time
    line = FaultyLine(fault)
    while True:
        data = line.pass_on(robot.device.to_host.pop(now_s()))
        if data:
            writer.write(data)
            await writer.drain()
        await asyncio.sleep(LINE_POLL_S)


async def _turn(robot: SimulatedRobot) -> None:
    """Thirty turns a second; within one the retry clause may wait, and the turn goes on after that."""
    now_s = asyncio.get_running_loop().time
    next_s = now_s()
    while True:
        wait_s = robot.turn(now_s())
        if wait_s is None:
            next_s = max(next_s + LOOP_S, now_s())
            wait_s = next_s - now_s()
        await asyncio.sleep(wait_s)
