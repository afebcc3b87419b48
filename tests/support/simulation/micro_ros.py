"""MicroRosBoard: a board of the simulated world with the micro-ROS client library, on a serial line."""

import random
from collections import deque

from hostlink.core.protocol.xrce.protocol import MICRO_ROS_SERIAL
from tests.support import xrce_board as library
from tests.support.simulation.board import COUNT_ID, POSE_ID, TEXT_ID, TWIST, VELOCITY_ID, Board, Dial
from tests.support.simulation.clock import WorldLoop
from tests.support.simulation.journal import Journal

STATUS_S = 3.0  # lines of this world take up to 0.6 s there and back
WAITING = 4  # messages to publish
HUNG_S = 0.05
READERS = {VELOCITY_ID: library.object_id(0, library.READER), TEXT_ID: library.object_id(1, library.READER)}
WRITERS = {POSE_ID: library.object_id(2, library.WRITER), COUNT_ID: library.object_id(3, library.WRITER)}
TYPES = {
    VELOCITY_ID: ("velocity_commands", "geometry_msgs::msg::dds_::Twist_"),
    TEXT_ID: ("text", "std_msgs::msg::dds_::UInt32_"),
    POSE_ID: ("odometry", "geometry_msgs::msg::dds_::Pose2D_"),
    COUNT_ID: ("count", "std_msgs::msg::dds_::UInt32_"),
}


class MicroRosBoard(Board):
    """Board that publishes reliably, and connects anew when a message is not acknowledged within a second."""

    protocol = MICRO_ROS_SERIAL
    least_velocities = 2  # one is in flight, of a board that answers after half a second
    held_s = 0.5

    @staticmethod
    def velocities_in(data: bytes) -> list[bytes]:
        found = []
        for message in library.Serial().decode(data):
            for kind, _, payload in library.submessages(message[4:]):
                is_velocity = kind == library.DATA and int.from_bytes(payload[2:4], "big") == READERS[VELOCITY_ID]
                found += [payload[4:]] if is_velocity and len(payload) == 4 + TWIST.size else []
        return found

    def __init__(self, loop: WorldLoop, journal: Journal, dial: Dial, number: int, dice: random.Random) -> None:
        super().__init__(loop, journal, dial, number, dice)
        self._keys = random.Random(f"key of {self.name}")
        self._forget_session()

    # -- the connection -----------------------------------------------------------------------------------------------

    def receive(self, data: bytes) -> None:
        self._inbox.extend(self._codec.decode(data))
        self._go()

    def start(self) -> None:
        super().start()
        if self.connection is not None:
            self._begin_session()

    def lose_connection(self) -> None:
        self._forget_session()
        super().lose_connection()

    def reboot(self, *, keeps_connection: bool) -> None:
        self._forget_session()
        super().reboot(keeps_connection=keeps_connection)

    def _connect(self, life: int) -> None:
        had_none = self.connection is None
        super()._connect(life)
        if had_none and self.connection is not None and life == self._life:
            self._begin_session()

    def _request_time(self) -> None: ...  # it needs none

    # -- its session --------------------------------------------------------------------------------------------------

    def _forget_session(self) -> None:
        self._session_life = getattr(self, "_session_life", 0) + 1
        self._codec = library.Serial()
        self._inbox: deque[bytes] = deque()
        self._outgoing: deque[tuple[int, bytes]] = deque()
        self._program: library.Program | None = None
        self._wake_s = 0.0
        self._is_busy = False  # it does not even read
        self._is_configured = False

    def _begin_session(self) -> None:
        self._forget_session()
        self._client = library.Client(key=self._keys.randbytes(4))
        self._client.on_data = self._take
        self._program = self._run(self._client)
        self._step(None)

    def _run(self, client: library.Client) -> library.Program:
        is_whole = yield from client.connect()
        node = library.object_id(0, library.PARTICIPANT)
        objects = [
            (node, library.participant("board"), 0),
            (library.object_id(0, library.PUBLISHER), b"\0\0", node),
            (library.object_id(0, library.SUBSCRIBER), b"\0\0", node),
        ]
        for topic_id, id_ in (READERS | WRITERS).items():
            name, type_ = TYPES[topic_id]
            topic = library.object_id(id_ >> 4, library.TOPIC)
            is_reader = topic_id in READERS
            parent = library.object_id(0, library.SUBSCRIBER if is_reader else library.PUBLISHER)
            objects += [
                (topic, library.topic(f"rt/{self.name}/{name}", type_), node),
                (id_, library.endpoint(topic, is_reader=is_reader), parent),
            ]
        for id_, content, parent in objects:
            is_whole = is_whole and (yield from client.create(id_, content, parent, timeout_s=STATUS_S)) in {0, 1}
        for id_ in READERS.values():
            client.read_data(id_)
        self._is_configured = is_whole
        while is_whole:
            while self._outgoing and is_whole:
                topic_id, payload = self._outgoing.popleft()
                is_whole = (yield from client.publish(WRITERS[topic_id], payload)).is_done
            if is_whole:
                yield from client.listen(1.0)
        self._loop.after(0.0, self._connect_anew, self._session_life)

    def _connect_anew(self, life: int) -> None:
        if life == self._session_life and self.is_present:
            self._hang_up()
            self.lose_connection()

    def _take(self, object_: int, payload: bytes) -> None:
        if object_ == READERS[VELOCITY_ID]:
            self._obey(payload)
        elif object_ == READERS[TEXT_ID]:
            self._count_text(payload)

    def _publish(self, topic_id: int, payload: bytes) -> bool:
        if not self._is_configured or self._is_hung or len(self._outgoing) >= WAITING:
            return False
        self._outgoing.append((topic_id, payload))
        if len(self._outgoing) == 1:
            self._inbox.append(b"")  # the program reads it and continues
            self._go()
        return True

    def _go(self) -> None:
        """Let the program read what has come."""
        while self._inbox and self._program is not None and not self._is_busy and not self._is_hung:
            self._step(self._inbox.popleft())

    def _step(self, message: bytes | None) -> None:
        program, life = self._program, self._session_life
        if program is None:
            return
        self._client.now_s = self._loop.world_s
        try:
            until_s = program.send(message) if message is not None else next(program)
        except StopIteration:
            self._program = None
            until_s = float("inf")
        sent, self._client.sent = self._client.sent, []
        for each in sent:
            self._send(self._codec.encode(each))
        self._is_busy, self._wake_s = until_s < 0, abs(until_s)
        if self._program is not None and self._wake_s < float("inf"):
            self._loop.at(self._wake_s + 1e-6, self._wake, life, self._wake_s)

    def _wake(self, life: int, wake_s: float) -> None:
        if life != self._session_life or wake_s != self._wake_s or self._program is None:
            return
        if self._is_hung:
            self._loop.after(HUNG_S, self._wake, life, wake_s)
            return
        self._step(None)
        self._go()
