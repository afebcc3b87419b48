"""The honest robot and the honest program that drives it, as a process of their own: they share a clock and no load.

    python -m tests.support.chaos.honest SEED TCP_PORT API_PORT UDP_PORT HANDSHAKE_S

Writes events for DriveRecord, a JSON list a line. Drives by a rosbridge topic, by the operation `drive` or by REST;
its drives end at random moments in every way. On a line of standard input ("last") it drives until the daemon ends it.
"""

import asyncio
import contextlib
import json
import random
import struct
import sys
import time

from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from tests.support.chaos import frames
from tests.support.chaos.connection import Connection, DatagramConnection
from tests.support.chaos.devices import quietly
from tests.support.chaos.drive_record import HONEST_RAD_S, NUMBERS, STEP_M_S
from tests.support.chaos.names import HONEST, HONEST_ADDRESS, HONEST_PROGRAM_ADDRESS, HONEST_VELOCITY
from tests.support.chaos.requests import HANDSHAKE, http, operation
from tests.support.device_codec import encode_parameter_request

PRIORITY = 90
POSE_S, TIME_S, PARAMETER_S = 0.1, 2.5, 1.0
TICK_S = 0.005
LATE_S = 0.003  # by which a tick is worth a line
DRIVE_S = (0.5, 4.0)
LEASE_S = 0.65
REST_S = (0.75, 1.0)  # longer than any zero may need
WAYS = ("topic", "topic", "drive", "rest")
ENDS = ("lease", "lease", "drop", "drop", "reset", "stop", "link")
TWIST = struct.Struct("<6d")
RECONNECT_S = 0.5
UDP_SHARE = 0.4  # of the honest robot's connections


def event(kind: str, *facts: object) -> None:
    """One event, as it happens."""
    sys.stdout.write(json.dumps([kind, time.monotonic(), *facts]) + "\n")
    sys.stdout.flush()


class Robot:
    """The honest device: it answers, keeps time, sends poses, and dials again when its connection ends.

    Over TCP or UDP, drawn each time. Over UDP it has no connection but its own socket: what it sends begins a session.
    """

    def __init__(self, tcp: tuple[str, int], udp: tuple[str, int] | None, dice: random.Random) -> None:
        self._tcp, self._udp, self._dice = tcp, udp, dice
        self._connection: Connection | None = None
        self._is_cut = False
        self.is_served = asyncio.Event()

    async def run(self) -> None:
        while True:
            with contextlib.suppress(OSError):
                self._connection = await self._dial()
                event("opened")
                try:
                    await self._live(self._connection)
                finally:
                    self.is_served.clear()
                    event("closed", self._is_cut)
                    self._is_cut = False
                    self._connection.close("reset")
            await asyncio.sleep(RECONNECT_S)

    async def _dial(self) -> Connection:
        if self._udp is not None and self._dice.random() < UDP_SHARE:
            return await DatagramConnection.dial(self._udp, HONEST_ADDRESS, "honest")
        return await Connection.dial(self._tcp, HONEST_ADDRESS, "honest")

    def cut(self) -> None:
        """The robot's radio is gone for a moment."""
        if self._connection is not None:
            self._is_cut = True
            self._connection.cut()

    async def _live(self, connection: Connection) -> None:
        async with asyncio.TaskGroup() as tasks:
            chores = [
                tasks.create_task(self._repeat(connection, encode(125, bytes(24)), POSE_S, "")),
                tasks.create_task(self._repeat(connection, frames.TIME, TIME_S, "time request")),
                tasks.create_task(self._repeat(connection, GAIN, PARAMETER_S, "parameter request")),
            ]
            try:
                await self._listen(connection)
            finally:
                for chore in chores:
                    chore.cancel()

    async def _listen(self, connection: Connection) -> None:
        stream = FrameStream()
        with contextlib.suppress(OSError):
            while data := await connection.receive():
                for item in stream.feed(data):
                    if isinstance(item, Frame):
                        await self._receive(connection, item)

    async def _receive(self, connection: Connection, frame: Frame) -> None:
        if frame.topic_id == 100:
            twist = TWIST.unpack(frame.payload)
            event("velocity", twist[0], twist[5])
            self.is_served.set()
        elif frame.topic_id == Id.PUBLISHER:
            await connection.send(frames.honest_introduction())
        elif frame.topic_id == Id.TIME:
            event("answered", "time request")
        elif frame.topic_id == Id.PARAMETER:
            event("answered", "parameter request")

    async def _repeat(self, connection: Connection, frame: bytes, interval_s: float, question: str) -> None:
        with contextlib.suppress(OSError):
            while True:
                await asyncio.sleep(interval_s)
                if question and self.is_served.is_set():
                    event("requested", question)
                await connection.send(frame)


class Driver:
    """The honest program."""

    def __init__(self, api: tuple[str, int], robot: Robot, dice: random.Random, handshake_s: float) -> None:
        self._api, self._robot, self._dice, self._handshake_s = api, robot, dice, handshake_s
        self._number = 0
        self._is_disarmed = False
        self.is_last = False

    async def run(self) -> None:
        while True:
            await self._robot.is_served.wait()
            await quietly(self._drive, self._dice.choice(WAYS), "last" if self.is_last else self._dice.choice(ENDS))
            await asyncio.sleep(0.1 if self.is_last else self._dice.uniform(*REST_S))

    async def _drive(self, way: str, end: str) -> None:
        try:
            connection = await Connection.dial(self._api, HONEST_PROGRAM_ADDRESS, "honest")
        except OSError as error:
            event("refused", str(error) or type(error).__name__)
            return
        try:
            if way != "rest":
                await connection.send(HANDSHAKE + b"\r\n")
                heard = await connection.receive_until(b"\r\n\r\n", self._handshake_s)
                if b" 101 " not in heard:
                    event("refused", heard[:80].decode(errors="replace") or "no answer to its handshake")
                    return
            await self._drive_over(connection, way, end)
        finally:
            connection.close()

    async def _drive_over(self, connection: Connection, way: str, end: str) -> None:
        async with asyncio.TaskGroup() as tasks:
            self._is_disarmed = False
            reader = tasks.create_task(connection.read_away(self._hear))
            try:
                await self._command(connection, way, end)
            finally:
                reader.cancel()
        if end in ("drop", "reset") and way != "rest":
            event("ended", end)
            connection.close("reset" if end == "reset" else "fin")
        elif end == "stop":
            event("ended", end)
            await self._stop()
        else:
            event("ended", "lease")
            await asyncio.sleep(LEASE_S)  # the connection stays, and sends nothing

    async def _command(self, connection: Connection, way: str, end: str) -> None:
        """Commands at 20 to 50 Hz, for as long as this drive lasts."""
        interval_s = 1 / self._dice.uniform(20, 50)
        seconds = 3600.0 if end == "last" else self._dice.uniform(*DRIVE_S)
        event("began", way)
        try:
            began_s = next_s = time.monotonic()
            while next_s < began_s + seconds and (end == "last" or not self.is_last):
                if end == "link" and next_s > began_s + seconds / 2:
                    end = ""
                    self._robot.cut()
                if self._is_disarmed:  # a stop, a pause or a new link has interrupted it: it lets go, and drives on
                    self._is_disarmed = False
                    event("released")
                    await connection.send(command(way, 0, 0.0))
                self._number = self._number % NUMBERS + 1
                event("sent", self._number)
                await connection.send(command(way, self._number))
                next_s += interval_s
                await asyncio.sleep(max(0.0, next_s - time.monotonic()))
        except OSError:
            event("ended", "the daemon's closing of the connection")
            event("refused", "its connection was closed while it drove")
            raise

    def _hear(self, data: bytes) -> None:
        self._is_disarmed |= b'"disarmed"' in data

    async def _stop(self) -> None:
        connection = await Connection.dial(self._api, HONEST_PROGRAM_ADDRESS, "honest")
        await connection.send(http("POST", f"/api/robots/{HONEST}/stop"))
        await connection.receive_until(b"\r\n\r\n", 1.0)
        connection.close()


def command(way: str, number: int, angular_rad_s: float = HONEST_RAD_S) -> bytes:
    """A command that is known by its speed."""
    speed = number * STEP_M_S
    if way == "topic":
        twist = {"linear": {"x": speed}, "angular": {"z": angular_rad_s}}
        return operation(op="publish", topic=HONEST_VELOCITY, type="geometry_msgs/Twist", msg=twist, priority=PRIORITY)
    if way == "drive":
        return operation(op="drive", robot=HONEST, linear=speed, angular=angular_rad_s, priority=PRIORITY, id=number)
    body = json.dumps({"linear": speed, "angular": angular_rad_s, "priority": PRIORITY})
    return http("PUT", f"/api/robots/{HONEST}/velocity", body.encode())


GAIN = encode(Id.PARAMETER, encode_parameter_request("gain"))


async def tick() -> None:
    """Measure how late this process wakes, which is not the daemon's fault."""
    due_s = time.monotonic()
    while True:
        due_s = max(due_s + TICK_S, time.monotonic())
        await asyncio.sleep(max(0.0, due_s - time.monotonic()))
        late_s = time.monotonic() - due_s
        if late_s > LATE_S:
            event("lag", late_s)


async def run(
    seed: int, tcp: tuple[str, int], api: tuple[str, int], udp: tuple[str, int] | None, handshake_s: float
) -> None:
    """Until the standard input ends."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    robot = Robot(tcp, udp, random.Random(f"{seed} honest robot"))
    driver = Driver(api, robot, random.Random(f"{seed} honest"), handshake_s)
    async with asyncio.TaskGroup() as tasks:
        running = [tasks.create_task(each) for each in (robot.run(), driver.run(), tick())]
        while await reader.readline():
            driver.is_last = True
        for task in running:
            task.cancel()


if __name__ == "__main__":
    *numbers, patience_s = map(float, sys.argv[1:])
    seed_of_run, *ports = map(int, numbers)
    own_tcp, own_api, own_udp = (("127.0.0.1", port) for port in ports)
    asyncio.run(run(seed_of_run, own_tcp, own_api, own_udp if own_udp[1] else None, patience_s))
