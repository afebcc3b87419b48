"""Programs that drive, stop, lock, publish and listen over connections, and the component that serves them.

`Programs` is the component: all that it knows of the daemon is its `Host`. A program sends one JSON object a line.
"""

import asyncio
import json
import random
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from hostlink.core.host import Component, EventKind, Host, Message, Participant, PlanarVelocity, Queue, RobotEvent
from hostlink.errors import CommandRefused, HostlinkError
from tests.support.simulation.board import NUMBER
from tests.support.simulation.clock import WorldLoop
from tests.support.simulation.journal import Answered, Appeared, Counted, Given, Interrupted, Journal, Left
from tests.support.simulation.wire import Connection, HostEnd

PIECE_BYTES = 4096
STEPS = 8000  # of x, before yaw counts one more
STEP_M_S, STEP_RAD_S = 0.0001, 0.001


def velocity_of(number: int) -> PlanarVelocity:
    """Return the velocity that only the command of this number has; 0 is a zero."""
    if not number:
        return PlanarVelocity(0.0)
    turns, step = divmod(number - 1, STEPS)
    return PlanarVelocity((step + 1) * STEP_M_S, yaw_rad_s=turns * STEP_RAD_S)


def number_of(linear_m_s: float, angular_rad_s: float) -> int:
    """Return the number of a velocity; 0 is a zero."""
    return round(linear_m_s / STEP_M_S) + STEPS * round(angular_rad_s / STEP_RAD_S)


# -- inside the daemon ------------------------------------------------------------------------------------------------


class Entrance:
    """Place where programs connect. The component that runs accepts them."""

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self.accept: Callable[[HostEnd], None] | None = None
        self.fail: Callable[[], None] = lambda: None  # ends the run of the component, as a lost broker does


class Programs(Component[Entrance]):
    """Serves the programs of the simulated world."""

    name = "programs"
    settings_type = Entrance
    log_events: ClassVar = {}

    async def run(self, host: Host) -> None:
        """Serve until the entrance fails."""
        entrance, clients = self.settings, dict[int, Client]()
        is_failed = asyncio.Event()

        def accept(end: HostEnd) -> None:
            number = end.connection.number
            clients[number] = Client(host, entrance.journal, end, lambda: clients.pop(number, None))

        entrance.accept, entrance.fail = accept, is_failed.set
        host.observe(self._note)
        try:
            await is_failed.wait()
            raise ConnectionError("the entrance has failed")
        finally:
            entrance.accept = None
            for client in list(clients.values()):  # their participants end with this run
                client.abandon()

    def _note(self, event: RobotEvent) -> None:
        if event.kind is EventKind.APPEARED:
            self.settings.journal.add(Appeared(event.at_s, event.robot))
        what = f"event {event.kind.value} {event.robot}"
        self.settings.journal.say(event.at_s, what, stamp_ns=event.stamp_ns, **event.facts)


class Client:
    """The daemon's side of one program."""

    def __init__(self, host: Host, journal: Journal, end: HostEnd, on_closed: Callable[[], object]) -> None:
        self._host, self._journal, self._end, self._on_closed = host, journal, end, on_closed
        self.source = end.connection.number
        self._participant: Participant | None = None
        self._turns = host.turns()
        self._reader = self._turns.reader(end, self._read, self.close)
        self._outgoing: Queue[bytes] = Queue(len, lambda: host.now_s, host.share("queues"))
        self._outgoing.on_news = self._write
        self._rest = b""
        self._is_draining = self._is_closed = False
        end.start(self._reader.receive)

    def close(self) -> None:
        """End the program: its robots stop."""
        if not self._is_closed:
            self.abandon()
            self._on_closed()
            if self._participant is not None:
                self._participant.leave()

    def abandon(self) -> None:
        """Close the connection. Who calls this ends the participant."""
        self._is_closed = True
        self._journal.add(Left(self._host.now_s, self.source))
        self._reader.stop()
        self._outgoing.release()
        self._end.close()

    # -- from the program ---------------------------------------------------------------------------------------------

    def _read(self) -> None:
        began_s = self._host.now_s
        try:
            data = self._end.read(PIECE_BYTES)
        except OSError:
            self.close()
            return
        *lines, self._rest = (self._rest + data).split(b"\n")
        left_bytes = sum(len(line) + 1 for line in lines) + len(self._rest)
        for line in lines:
            left_bytes -= len(line) + 1
            self._do(json.loads(line), self._end.arrived_s(self._end.read_bytes - left_bytes))
            if self._is_closed:
                return
        self._turns.end(began_s)

    def _do(self, request: dict[str, Any], arrived_s: float) -> None:
        if self._participant is None:
            self._participant = self._host.join(
                f"program {request['name']}", priority=request["priority"], on_end=self.close
            )
            return
        match request["op"]:
            case "drive" | "publish":
                self._drive(self._participant, request, arrived_s)
            case "epoch":
                self._answer_epoch(request["robot"])
            case "listen":
                self._listen(self._participant, request["robot"])
            case "text":
                self._tell(self._participant, request)
            case _:
                self._host.spawn(self._interrupt(request, arrived_s), name=request["op"])

    def _drive(self, participant: Participant, request: dict[str, Any], arrived_s: float) -> None:
        robot, number, epoch, refused = request["robot"], request["number"], request.get("epoch"), ""
        velocity, came_s, sent_s = velocity_of(number), self._reader.came_s, request["sent_s"]
        tells_sent = request["op"] == "drive" and request["tells_sent"]
        learned_s = request.get("learned_s")
        self._journal.add(Given(self._host.now_s, arrived_s, self.source, robot, number, sent_s, tells_sent, learned_s))
        try:
            if request["op"] == "publish":
                participant.publish(f"/{robot}/velocity_commands", velocity.encode(), at_s=came_s, epoch=epoch)
            else:
                self._host.drive(
                    participant,
                    robot,
                    velocity,
                    received_s=came_s,
                    sent_s=1000.0 + sent_s if tells_sent else None,
                    epoch=epoch,
                    take_over=request["takes_over"],
                )
        except CommandRefused as error:
            refused = error.kind.value
        except HostlinkError as error:
            refused = type(error).__name__
        if refused:
            self._journal.say(self._host.now_s, "refused", number=number, kind=refused)
            self._answer({"refused": refused, "robot": robot})

    def _answer_epoch(self, robot: str) -> None:
        try:
            epoch = self._host.robot(robot).epoch
        except HostlinkError:
            return
        self._journal.say(self._host.now_s, "epoch told", robot=robot, epoch=epoch)
        self._answer({"epoch": epoch, "robot": robot, "learned_s": self._host.now_s})

    def _listen(self, participant: Participant, robot: str) -> None:
        def receive(message: Message) -> None:
            (number,) = NUMBER.unpack(message.payload)
            self._journal.add(Counted(self._host.now_s, self.source, f"hub {robot}", number))
            self._outgoing.put_message(robot, json.dumps({"count": number, "robot": robot}).encode() + b"\n")

        participant.subscribe(f"/{robot}/count", receive)

    def _tell(self, participant: Participant, request: dict[str, Any]) -> None:
        try:
            participant.publish(f"/{request['robot']}/text", NUMBER.pack(request["number"]))
        except HostlinkError as error:
            self._journal.say(self._host.now_s, "text refused", number=request["number"], reason=type(error).__name__)
        else:
            self._journal.add(
                Counted(self._host.now_s, self.source, f"text given {request['robot']}", request["number"])
            )

    async def _interrupt(self, request: dict[str, Any], arrived_s: float) -> None:
        robot, by, began_s = request["robot"], f"program {self.source}", self._host.now_s
        try:
            if robot:
                self._host.robot(robot)
            self._journal.add(Interrupted(began_s, arrived_s, robot, request["op"], self.source))
            match request["op"]:
                case "stop":
                    stopped = await self._host.stop(robot or None, by=by)
                    for name, found in stopped.robots.items():
                        self._journal.add(Answered(self._host.now_s, began_s, name, found.state.value))
                case "lock":
                    await self._host.lock(robot or None, reason="a test", by=by)
                case "unlock":
                    await self._host.unlock(robot or None, by=by)
        except HostlinkError as error:
            self._journal.say(self._host.now_s, f"{request['op']} failed", reason=type(error).__name__, robot=robot)

    # -- to the program -----------------------------------------------------------------------------------------------

    def _answer(self, answer: dict[str, Any]) -> None:
        self._outgoing.put_result(json.dumps(answer).encode() + b"\n")

    def _write(self) -> None:
        if self._outgoing.is_too_slow:
            self.close()
        while not self._is_draining and not self._is_closed and (waiting := self._outgoing.pop()) is not None:
            if not self._end.write(waiting.item):
                self._is_draining = True
                self._host.spawn(self._drain(), name="drain")

    async def _drain(self) -> None:
        try:
            await self._end.drain()
        except OSError:
            self.close()
        self._is_draining = False
        self._write()


# -- outside of it ----------------------------------------------------------------------------------------------------


@dataclass(kw_only=True)
class Ride:
    """One drive of a program."""

    robot: str
    op: str  # "drive" or "publish"
    tells_sent: bool
    epochs: str  # "none", "newest" or "first": which epoch its commands carry
    period_s: float
    left_s: float
    takes_over: bool
    is_stubborn: bool  # continues when it is refused
    end: str
    epoch: tuple[int, float] | None = None  # the first one


class Program:
    """A program that drives now and then, in drawn ways, and ends its drives in drawn ways."""

    def __init__(
        self,
        loop: WorldLoop,
        journal: Journal,
        dial: Callable[["Program"], Connection | None],
        draw_number: Callable[[], int],
        *,
        name: int,
        robots: list[str],
        dice: random.Random,
    ) -> None:
        self.name, self.connection = name, None
        self.connection: Connection | None
        self.is_leaving = self._is_plain = False
        self._loop, self._journal, self._dial, self._draw_number = loop, journal, dial, draw_number
        self._robots, self._dice = robots, dice
        self._priority = dice.choice((50, 50, 50, 60))
        self._epochs: dict[str, tuple[int, float]] = {}
        self._ride: Ride | None = None
        self._texts = 0
        self._life = 0
        self._rest = b""

    def start(self) -> None:
        """Connect, and live."""
        self._loop.after(self._dice.uniform(0.0, 1.0), self._connect)

    def leave(self) -> None:
        """End for good."""
        self.is_leaving, self._ride = True, None
        if self.connection is not None:
            self.connection.close()
            self.connection = None

    def receive(self, data: bytes) -> None:
        """Read answers."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            answer = json.loads(line)
            if "epoch" in answer:
                self._epochs[answer["robot"]] = answer["epoch"], answer["learned_s"]
            elif "count" in answer:
                stream = f"program {self.name} {answer['robot']}"
                number = 0 if self.connection is None else self.connection.number
                self._journal.add(Counted(self._loop.world_s, number, stream, answer["count"]))
            elif self._ride is not None and not self._ride.is_stubborn:
                self._ride = None

    def lose_connection(self) -> None:
        """Connect again."""
        self.connection, self._ride = None, None
        if not self.is_leaving:
            self._loop.after(self._dice.uniform(0.05, 1.0), self._connect)

    # -- its life -----------------------------------------------------------------------------------------------------

    def _connect(self) -> None:
        if self.is_leaving or self.connection is not None:
            return
        self._rest = b""
        self.connection = self._dial(self)
        if self.connection is None:
            self._loop.after(self._dice.uniform(0.05, 1.0), self._connect)
            return
        self._life += 1
        self.send({"name": self.name, "priority": self._priority})
        for number, robot in enumerate(self._robots):
            if number % 2 == self.name % 2:
                self.send({"op": "listen", "robot": robot})
        self._later(0.1, 1.5, self._act)
        if self.name == 0:
            self._later(0.2, 0.5, self._tell)

    def _later(self, least_s: float, most_s: float, act: Callable[[], None]) -> None:
        life = self._life

        def due() -> None:
            if life == self._life and self.connection is not None:
                act()

        self._loop.after(self._dice.uniform(least_s, most_s), due)

    def send(self, request: dict[str, Any]) -> None:
        """Send a request."""
        if self.connection is not None:
            self.connection.send(json.dumps(request).encode() + b"\n")

    def _tell(self) -> None:
        for robot in self._robots:
            self._texts += 1
            self.send({"op": "text", "robot": robot, "number": self._texts})
        self._later(0.2, 0.5, self._tell)

    def _act(self) -> None:
        if self._is_plain:
            return
        dice, robot = self._dice, self._dice.choice(self._robots)
        what = dice.random()
        if what < 0.75:
            self._begin_ride(robot)
            return
        if what < 0.87:
            self.send({"op": "stop", "robot": dice.choice((robot, robot, ""))})
        elif what < 0.93:
            target = dice.choice((robot, robot, ""))
            self.send({"op": "lock", "robot": target})
            self._later(0.1, 2.0, lambda: self.send({"op": "unlock", "robot": target}))
        elif what < 0.97:
            self.send({"op": "epoch", "robot": robot})
        self._later(0.1, 1.5, self._act)

    def ride(self, robot: str, seconds: float) -> None:
        """Drive in the plainest way, end with a zero, and do no more."""
        self._is_plain = True
        self._ride = Ride(
            robot=robot, op="drive", tells_sent=False, epochs="none", period_s=0.1, left_s=seconds, takes_over=True,
            is_stubborn=True, end="zero",
        )  # fmt: skip
        self._command()

    def _begin_ride(self, robot: str) -> None:
        dice = self._dice
        self._ride = Ride(
            robot=robot,
            op=dice.choice(("drive", "drive", "publish")),
            tells_sent=dice.random() < 0.5,
            epochs=dice.choice(("none", "none", "newest", "first")),
            period_s=dice.choice((0.02, 0.05, 0.1, 0.1, 0.2, 0.4)),
            left_s=dice.choice((0.3, 1.0, 3.0, 6.0)) * dice.uniform(0.5, 1.5),
            takes_over=dice.random() < 0.2,
            is_stubborn=dice.random() < 0.7,
            end=dice.choice(("zero", "silence", "silence", "close", "cut", "vanish")),
            epoch=self._epochs.get(robot),
        )
        if self._ride.epochs != "none":
            self.send({"op": "epoch", "robot": robot})
        self._command()

    def _command(self) -> None:
        ride = self._ride
        if ride is None:
            self._later(0.1, 1.5, self._act)
            return
        if ride.left_s <= 0:
            self._end_ride(ride)
            return
        if ride.epochs == "newest" and self._dice.random() < 0.2:
            self.send({"op": "epoch", "robot": ride.robot})
        ride.epoch = ride.epoch or self._epochs.get(ride.robot)
        self._send_command(ride, self._draw_number())
        wait_s = ride.period_s * self._dice.uniform(0.9, 1.1)
        ride.left_s -= wait_s
        self._later(wait_s, wait_s, self._command)

    def _send_command(self, ride: Ride, number: int) -> None:
        epoch = None
        if ride.epochs != "none":
            epoch = self._epochs.get(ride.robot) if ride.epochs == "newest" else ride.epoch
        self.send(
            {
                "op": ride.op,
                "robot": ride.robot,
                "number": number,
                "sent_s": self._loop.world_s,
                "tells_sent": ride.tells_sent,
                "takes_over": ride.takes_over,
                "epoch": None if epoch is None else epoch[0],
                "learned_s": None if epoch is None else epoch[1],
            }
        )

    def _end_ride(self, ride: Ride) -> None:
        self._ride = None
        connection = self.connection
        self._journal.say(self._loop.world_s, "ride ends", program=self.name, how=ride.end)
        if ride.end == "zero":
            self._send_command(ride, 0)
        if connection is None or ride.end in ("zero", "silence"):
            self._later(0.1, 1.5, self._act)
        elif ride.end == "cut":
            connection.cut()
        else:
            connection.close() if ride.end == "close" else connection.vanish()
            self.lose_connection()
