"""Participants of a hub, of every kind, and the scene in which they meet robots and a neighbour."""

import asyncio
import contextlib
import itertools
import json
import struct
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

from structlog.testing import capture_logs

from hostlink.components.gateway.clients import ClientQueue, Outgoing
from hostlink.components.gateway.foxglove import FoxgloveClient, FoxgloveDirectory
from hostlink.components.gateway.rest import Owners
from hostlink.components.gateway.rosbridge import RosbridgeClient
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.message import PROGRAM_PRIORITY, Message
from hostlink.core.hub.node import Role
from hostlink.core.hub.participant import Participant
from hostlink.core.hub.queue import Queue
from hostlink.core.hub.robots import Robots
from hostlink.core.hub.subscription import Subscription
from hostlink.core.messages.message_type import ServiceType
from hostlink.core.protocol.endpoint import DeviceEndpoint
from hostlink.core.robot.velocity import PlanarVelocity, Twist
from hostlink.errors import BadRequest, CommandRefused, HostlinkError, NoRole, RefusalKind, Refused
from tests.support.fake_device import CATALOG, robot_topics
from tests.support.hosts import host_in
from tests.support.memory_hub import running
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import run_virtual

Answer = Callable[[Mapping[str, object]], Awaitable[Mapping[str, object]]]

POSE = struct.Struct("<3d")
VELOCITY_ID, ODOMETRY_ID = 100, 125
SERVICE, SERVICE_TYPE = "/switch", "std_srvs/SetBool"
TEXT, TEXT_TYPE = "/chat", "std_msgs/String"
ROBOT, NEIGHBOUR = "robot_0", "robot_1"


_sources: WeakKeyDictionary[Robots, dict[str, Participant]] = (
    WeakKeyDictionary()
)  # a compiled Hub has no weak reference


def source_of(hub: Hub, name: str) -> Participant:
    """The participant as which `publish` sends by this name."""
    sources = _sources.setdefault(hub.robots, {})
    if name not in sources or sources[name].has_left:
        sources[name] = hub.join(name)
    return sources[name]


def publish(
    hub: Hub,
    topic: str,
    message: Mapping[str, object] | bytes,
    *,
    source: str = "test",
    type_name: str = "",
    priority: int = PROGRAM_PRIORITY,
    epoch: int | None = None,
) -> None:
    """Publish once, as one participant for all that is sent by this name."""
    participant = source_of(hub, source)
    type_ = participant.message_type(topic, type_name)
    payload = message if isinstance(message, bytes) else type_.encode(message)
    participant.publish(topic, payload, priority=priority, epoch=epoch)


def subscribe(hub: Hub, topic: str, receive: Callable[[Message], None], *, name: str = "test") -> Subscription:
    """Subscribe as a participant of this name."""
    return hub.join(name).subscribe(topic, receive)


def text(data: str) -> bytes:
    type_ = CATALOG.message(TEXT_TYPE)
    assert type_ is not None
    return type_.encode({"data": data})


class Defect(Exception):
    """Failure of a callback."""


def _provide(program: "Program | FoxgloveProgram", answer: Answer) -> None:
    async def serving(request: Mapping[str, object]) -> Mapping[str, object]:
        if program.is_failing:
            raise Defect
        return await answer(request)

    program.participant.provide(SERVICE, SERVICE_TYPE, serving)


@dataclass
class Program:
    """A participant of any kind that uses the seam itself; its queue holds what it was sent."""

    participant: Participant
    queue: Queue[Message] = field(init=False)
    is_failing: bool = False

    def __post_init__(self) -> None:
        self.queue = Queue(lambda message: len(message.payload), asyncio.get_running_loop().time)

    def publish(self, topic: str, type_name: str, payload: bytes) -> None:
        self.participant.advertise(topic, type_name)
        self.participant.publish(topic, payload)

    def subscribe(self, topic: str, *, interval_s: float = 0.0, queue_length: int = 0) -> None:
        def receive(message: Message) -> None:
            if self.is_failing:
                raise Defect
            self.queue.put_message(topic, message)

        self.participant.subscribe(topic, receive, interval_s=interval_s, queue_length=queue_length)

    def received(self) -> list[bytes]:
        return [waiting.item.payload for waiting in iter(self.queue.pop, None)]

    def serve(self, answer: Answer) -> None:
        _provide(self, answer)

    async def call(self, service: str, request: Mapping[str, object]) -> Mapping[str, object]:
        return await self.participant.call(service, request)

    def drive(self, robot: str, speed_m_s: float, hub: Hub) -> None:
        self.participant.drive(hub.robots.find(robot), PlanarVelocity(speed_m_s))

    def settle(self) -> None:
        self.participant.flush(asyncio.get_running_loop().time())


class RosbridgeProgram:
    """A program at the other end of a WebSocket, with JSON in both directions."""

    def __init__(self, hub: Hub, name: str, tasks: asyncio.TaskGroup, role: Role) -> None:
        self.is_failing = False
        self.queue: ClientQueue = ClientQueue()
        self.queue._size_of = self._size_of
        self._numbers = itertools.count()
        self._client = RosbridgeClient(name, host_in(hub), self.queue, spawn=tasks.create_task, role=role)
        self._served: Answer | None = None
        self._answers: dict[str, asyncio.Future[Mapping[str, Any]]] = {}
        self._tasks = tasks
        self._received: list[bytes] = []
        self.send(op="set_level", level="error")

    @property
    def participant(self) -> Participant:
        return self._client.participant

    def publish(self, topic: str, type_name: str, payload: bytes) -> None:
        type_ = CATALOG.message(type_name)
        assert type_ is not None
        self.send(op="publish", topic=topic, type=type_name, msg=type_.decode(payload))
        self.settle()

    def subscribe(self, topic: str, *, interval_s: float = 0.0, queue_length: int = 0) -> None:
        self.send(op="subscribe", topic=topic, throttle_rate=interval_s * 1000, queue_length=queue_length)

    def received(self) -> list[bytes]:
        self.settle()
        received, self._received = self._received, []
        return received

    def serve(self, answer: Answer) -> None:
        self._served = answer
        self.send(op="advertise_service", service=SERVICE, type=SERVICE_TYPE)
        self.settle()

    async def call(self, service: str, request: Mapping[str, object]) -> Mapping[str, object]:
        key = str(next(self._numbers))
        self._answers[key] = asyncio.get_running_loop().create_future()
        self.send(op="call_service", id=key, service=service, args=request)
        while not self._answers[key].done():
            await asyncio.sleep(0.01)
            self.settle()
        answer = self._answers[key].result()
        if not answer["result"]:
            raise HostlinkError(answer["values"])
        return answer["values"]  # type: ignore[no-any-return]

    def drive(self, robot: str, speed_m_s: float, hub: Hub) -> None:  # noqa: ARG002 - as the other kinds have it
        self.send(op="drive", id="drive", robot=robot, linear=speed_m_s, angular=0.0)
        self.settle()

    def settle(self) -> None:
        """Read all that waits, and answer what is called."""
        self.participant.flush(asyncio.get_running_loop().time())
        for waiting in iter(self.queue.pop, None):
            self._receive(json.loads(waiting.item.data))

    def _receive(self, operation: dict[str, Any]) -> None:
        if operation["op"] == "publish":
            type_ = CATALOG.message(TEXT_TYPE if operation["topic"] == TEXT else "geometry_msgs/Pose2D")
            assert type_ is not None
            self._received.append(type_.encode(operation["msg"]))
        elif operation["op"] == "call_service":
            self._tasks.create_task(self._answer(operation))
        elif operation["op"] == "service_response":
            self._answers[operation["id"]].set_result(operation)
        elif operation["op"] == "drive_result" and not operation["result"]:
            raise _error(operation["kind"], operation["reason"])
        elif operation["op"] == "status":
            raise _error(operation["kind"], operation["msg"])

    async def _answer(self, operation: dict[str, Any]) -> None:
        assert self._served is not None
        values = await self._served(operation["args"])
        self.send(op="service_response", id=operation["id"], service=SERVICE, values=values, result=True)

    def _size_of(self, outgoing: Outgoing) -> int:
        if self.is_failing:
            raise Defect
        return len(outgoing.data)

    def send(self, **request: Any) -> None:
        self._client.receive(json.dumps(request))


class FoxgloveProgram:
    """A program at the other end of a WebSocket with Foxglove's protocol.

    The protocol has neither services of clients nor a pace of subscriptions: for these it uses its participant itself.
    """

    def __init__(self, scene: "Scene", name: str, role: Role) -> None:
        self.is_failing = False
        self.queue: ClientQueue = ClientQueue()
        self.queue._size_of = self._size_of
        self._numbers = itertools.count(1)
        host = host_in(scene.hub)
        directory = FoxgloveDirectory(host)
        self._client = FoxgloveClient(name, host, directory, self.queue, spawn=scene.tasks.create_task, role=role)
        self._channels: dict[str, int] = {}
        self._services: dict[str, int] = {}
        self._types: dict[str, ServiceType] = {}
        self._received: list[bytes] = []
        self._answers: dict[int, asyncio.Future[bytes]] = {}
        self.settle()

    @property
    def participant(self) -> Participant:
        return self._client.participant

    def publish(self, topic: str, type_name: str, payload: bytes) -> None:
        number = next(self._numbers)
        channel = {"id": number, "topic": topic, "encoding": "ros1", "schemaName": type_name}
        self.send(op="advertise", channels=[channel])
        self.settle()
        self._client.receive(struct.pack("<BI", 1, number) + payload)
        self.settle()

    def subscribe(self, topic: str, *, interval_s: float = 0.0, queue_length: int = 0) -> None:
        if interval_s:
            self.participant.subscribe(
                topic, lambda message: self.queue.put_message(topic, Outgoing(message.payload)),
                interval_s=interval_s, queue_length=queue_length,
            )  # fmt: skip
            return
        subscription = {"id": next(self._numbers), "channelId": self._channels[topic]}
        self.send(op="subscribe", subscriptions=[subscription])

    def received(self) -> list[bytes]:
        self.settle()
        received, self._received = self._received, []
        return received

    def serve(self, answer: Answer) -> None:
        _provide(self, answer)

    async def call(self, service: str, request: Mapping[str, object]) -> Mapping[str, object]:
        while service not in self._services:
            await asyncio.sleep(0.01)
            self.settle()
        number, type_ = next(self._numbers), self._types[service]
        self._answers[number] = asyncio.get_running_loop().create_future()
        head = struct.pack("<BIII", 2, self._services[service], number, 4) + b"ros1"
        self._client.receive(head + type_.request.encode(request))
        while not self._answers[number].done():
            await asyncio.sleep(0.01)
            self.settle()
        return type_.response.decode(self._answers[number].result())

    def drive(self, robot: str, speed_m_s: float, hub: Hub) -> None:
        topic = hub.robots.find_here(robot).shown.velocity
        self.publish(topic, "geometry_msgs/Twist", PlanarVelocity(speed_m_s).encode())

    def settle(self) -> None:
        """Read all that waits."""
        if not self.participant.has_left:
            self._client.flush(asyncio.get_running_loop().time())
        for waiting in iter(self.queue.pop, None):
            self._receive(waiting.item)

    def _receive(self, outgoing: Outgoing) -> None:
        data = outgoing.data
        if not outgoing.is_binary:
            if data[:1] == b"{":
                self._receive_json(json.loads(data))
            else:
                self._received.append(data)
        elif data[0] == 1:
            self._received.append(data[13:])
        elif data[0] == 3:
            self._answers[struct.unpack_from("<I", data, 5)[0]].set_result(data[17:])

    def _receive_json(self, operation: dict[str, Any]) -> None:
        match operation["op"]:
            case "advertise":
                self._channels |= {each["topic"]: each["id"] for each in operation["channels"]}
            case "advertiseServices":
                for each in operation["services"]:
                    self._services[each["name"]] = each["id"]
                    type_ = CATALOG.service(each["type"])
                    assert type_ is not None
                    self._types[each["name"]] = type_
            case "serviceCallFailure":
                self._answers[operation["callId"]].set_exception(HostlinkError(operation["message"]))
            case "status":
                message = operation["message"]
                if "higher priority" in message:
                    raise CommandRefused("robot", RefusalKind.HELD, message)
                raise BadRequest(message)

    def _size_of(self, outgoing: Outgoing) -> int:
        if self.is_failing:
            raise Defect
        return len(outgoing.data)

    def send(self, **request: Any) -> None:
        self._client.receive(json.dumps(request))


def _error(kind: str, reason: str) -> HostlinkError:
    """Return the error as it was raised at the other end."""
    if kind in set(RefusalKind):
        return CommandRefused("robot", RefusalKind(kind), reason)
    of_kind = {each.kind: each for each in (BadRequest, NoRole)}.get(kind)
    return Refused(kind, reason) if of_kind is None else of_kind(reason)


Make = Callable[["Scene", Role], Any]


def plain(scene: "Scene", role: Role) -> Program:
    return Program(scene.hub.join("program", role=role))


def rest(scene: "Scene", role: Role) -> Program:
    return Program(Owners(host_in(scene.hub)).of("127.0.0.1", role))


def rosbridge(scene: "Scene", role: Role) -> RosbridgeProgram:
    return RosbridgeProgram(scene.hub, "client 1", scene.tasks, role)


def foxglove(scene: "Scene", role: Role) -> FoxgloveProgram:
    return FoxgloveProgram(scene, "client 1", role)


def daemon(scene: "Scene", role: Role) -> Program:
    """Return a participant of the daemon itself, such as /rosout."""
    assert role is Role.DRIVE
    return Program(scene.hub.join_daemon())


PROGRAMS = [plain, rest, rosbridge, foxglove]
ALL = [*PROGRAMS, daemon]


class Scene:
    """Two robots in virtual time, and a neighbour.

    It drives a robot of its own, subscribes to it and serves, before and after all that happens: its robot, its link
    and itself must be there at the end.
    """

    def __init__(
        self,
        hub: Hub,
        tasks: asyncio.TaskGroup,
        infos: Sequence[DeviceEndpoint] = (),
        make_device: Callable[..., ScriptedDevice] = ScriptedDevice,
    ) -> None:
        """`make_device` makes the robot's device."""
        self.hub, self.tasks, self._make_device = hub, tasks, make_device
        self.infos = list(infos) or robot_topics(ROBOT)  # of the robot
        self.neighbour_heard: list[bytes] = []

    async def begin(self) -> None:
        self.connect()
        self.other = ScriptedDevice(self.hub, robot_topics(NEIGHBOUR), address="10.0.0.2")
        await asyncio.sleep(0.5)
        self.neighbour = self.hub.join("neighbour")
        self.neighbour.subscribe(f"/{NEIGHBOUR}/odometry", lambda message: self.neighbour_heard.append(message.payload))

        async def answer(_: Mapping[str, object]) -> Mapping[str, object]:
            return {"success": True, "message": "here"}

        self.neighbour.provide("/neighbour", "std_srvs/Trigger", answer)
        self.neighbour.advertise(TEXT, TEXT_TYPE)
        await self.neighbour_works()

    def connect(self) -> None:
        """Connect the robot's device, for the first time or again."""
        self.robot = self._make_device(self.hub, self.infos, address="10.0.0.1")

    async def neighbour_works(self) -> None:
        """Check that the neighbour is driven, heard and answered, and that no link has ended."""
        before = len(self.neighbour_heard)
        self.neighbour.drive(self.hub.robots.find(NEIGHBOUR), PlanarVelocity(0.2))
        await self.other.send(ODOMETRY_ID, POSE.pack(0.0, 0.0, 0.0))
        await asyncio.sleep(0.1)
        assert struct.unpack("<6d", self.other.payloads(VELOCITY_ID)[-1])[0] == 0.2
        assert len(self.neighbour_heard) == before + 1
        caller = self.hub.join("asker")
        assert (await caller.call("/neighbour", {}))["message"] == "here"
        caller.leave()
        assert len(self.hub.links.all()) == 2
        assert self.hub.isolation.crashes.keys() <= {"participant"}

    def twists(self) -> list[Twist]:
        """The velocities that the robot received."""
        return [Twist.decode(payload) for payload in self.robot.payloads(VELOCITY_ID)]

    def speeds(self) -> list[float]:
        """Forward speeds of the velocities that the robot received."""
        return [twist.linear_x_m_s for twist in self.twists()]

    def uses_of(self, participant: Participant) -> list[str]:
        """Return everything that the hub keeps of a participant."""
        uses = [topic.name for topic in self.hub.topics.all() if participant in topic.publishers]
        uses += [
            topic.name
            for topic in self.hub.topics.all()
            if participant in [subscriber.key for subscriber in topic.subscribers]
        ]
        uses += [name for name, _ in self.hub.services.all() if self.hub.services.find(name).key is participant]
        return uses + [robot.name for robot in self.hub.robots.here() if robot.gate.owner is participant]


@contextlib.asynccontextmanager
async def scene(
    config: Config | None = None,
    infos: Sequence[DeviceEndpoint] = (),
    make_device: Callable[..., ScriptedDevice] = ScriptedDevice,
) -> AsyncIterator[Scene]:
    with capture_logs():
        hub = Hub(Config() if config is None else config, CATALOG)
        async with running(hub) as tasks:
            made = Scene(hub, tasks, infos, make_device)
            await made.begin()
            yield made
            await made.neighbour_works()


def play(
    test: Callable[[Scene], Awaitable[None]],
    config: Config | None = None,
    infos: Sequence[DeviceEndpoint] = (),
    make_device: Callable[..., ScriptedDevice] = ScriptedDevice,
) -> None:
    async def run() -> None:
        async with scene(config, infos, make_device) as made:
            await test(made)

    run_virtual(run())
