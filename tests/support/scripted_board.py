"""ScriptedBoard: a micro-ROS board in memory that creates any topics. To a test it is a ScriptedDevice."""

import asyncio
from collections import deque
from collections.abc import Callable, Sequence

from hostlink.core.hub.hub import Hub
from hostlink.core.link.link import Link
from hostlink.core.messages.cdr import cdr_of
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.frame import Frame
from hostlink.core.protocol.xrce.protocol import MICRO_ROS_TCP
from hostlink.core.runtime.loop_time import loop_time_s
from tests.support import xrce_board as board
from tests.support.fake_device import message_type
from tests.support.memory_transport import memory_pair
from tests.support.scripted_device import ScriptedDevice
from tests.support.waiting import expect
from tests.support.xrce_device import Device

KEY = b"\1\2\3\4"


class Program:
    """Program of a board: it creates what it is given, and publishes when it is told to."""

    def __init__(self, infos: list[DeviceEndpoint], client: board.Client) -> None:
        self.client, self.infos = client, infos
        self.outgoing: deque[tuple[int, bytes]] = deque()  # topic ids and payloads to publish
        self.wanted = len(infos)  # of the infos, to be created
        self.heard: list[tuple[float, Frame]] = []  # as a device of rosserial would have them
        self._created = 0

    def run(self) -> board.Program:
        """Connect, and do what there is to do."""
        client = self.client
        client.on_data = self._take
        assert (yield from client.connect())
        for id_, content, parent in (
            (board.object_id(0, board.PARTICIPANT), board.participant("board"), 0),
            (board.object_id(0, board.PUBLISHER), b"\0\0", board.object_id(0, board.PARTICIPANT)),
            (board.object_id(0, board.SUBSCRIBER), b"\0\0", board.object_id(0, board.PARTICIPANT)),
        ):
            assert (yield from client.create(id_, content, parent)) == 0
        while True:
            while self._created < self.wanted:
                yield from self._create(self._created, self.infos[self._created])
                self._created += 1
            while self.outgoing:
                topic_id, payload = self.outgoing.popleft()
                number = [info.id for info in self.infos].index(topic_id)
                content = cdr_of(message_type(self.infos[number].type)).from_ros1(payload)
                yield from client.publish(board.object_id(number, board.WRITER), content)
            yield from client.listen(1.0)

    def _create(self, number: int, info: DeviceEndpoint) -> board.Program:
        client, is_reader = self.client, info.kind is EndpointKind.SUBSCRIBER
        kind, parent = (board.READER, board.SUBSCRIBER) if is_reader else (board.WRITER, board.PUBLISHER)
        package, _, name = info.type.partition("/")
        topic_id, id_ = board.object_id(number, board.TOPIC), board.object_id(number, kind)
        topic = board.topic(f"rt{info.name}", f"{package}::msg::dds_::{name}_")
        assert (yield from client.create(topic_id, topic, board.object_id(0, board.PARTICIPANT))) == 0
        endpoint = board.endpoint(topic_id, is_reader=is_reader)
        assert (yield from client.create(id_, endpoint, board.object_id(0, parent))) == 0
        if is_reader:
            client.read_data(id_)

    def _take(self, object_: int, content: bytes) -> None:
        info = self.infos[object_ >> 4]
        payload = cdr_of(message_type(info.type)).to_ros1(content)
        self.heard.append((loop_time_s(), Frame(info.id, payload)))


class ScriptedBoard(ScriptedDevice):
    """One connection to a hub that runs, in the loop that runs it."""

    def __init__(self, hub: Hub, infos: Sequence[DeviceEndpoint], *, address: str, peer: str | None = None) -> None:
        host_end, self._end = memory_pair(address=address)
        if peer is not None:
            host_end.peer = peer
        self.infos = list(infos)
        self.program = Program(self.infos, board.Client(key=KEY))
        self.heard = self.program.heard
        self.device = Device(self.program, self._end.write, board.Lengths())
        self.link: Link = hub.links.open(host_end, MICRO_ROS_TCP)
        hub.spawn(hub.links.serve(self.link), name=f"link of {address}")
        self.task = asyncio.get_running_loop().create_task(self._live(), name=f"board at {address}")

    async def send(self, topic_id: int, payload: bytes) -> None:
        """Publish a message of rosserial, as ROS 2 has it."""
        self.program.outgoing.append((topic_id, payload))
        self.device.wake()

    async def announce(self) -> None:
        """Create what is new in `infos`, and wait until the host knows it."""
        self.program.wanted = len(self.infos)
        self.device.wake()
        await self.is_announced()

    async def is_announced(self) -> None:
        """Wait until the host knows all topics."""
        names = {info.name for info in self.infos}
        await expect(lambda: {each.name for each in self.link.topics} == names)

    async def aclose(self) -> None:
        """Close the connection."""
        await self._end.aclose()
        await self.task

    async def _live(self) -> None:
        async with asyncio.TaskGroup() as tasks:
            running = tasks.create_task(self.device.run(), name="program of a board")
            try:
                while data := await self._end.receive():
                    self.device.receive(data)
            except OSError:
                pass
            finally:
                running.cancel()


#: What makes the device of a test, by the name of its protocol.
DEVICES: dict[str, Callable[..., ScriptedDevice]] = {"rosserial": ScriptedDevice, "micro-ROS": ScriptedBoard}
