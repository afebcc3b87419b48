"""XrceSession with boards behind one address that do valid things in any order, and an oracle of what each may see."""

import contextlib
import struct
from collections import defaultdict
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.events import MessageReceived
from hostlink.core.protocol.xrce.protocol import MICRO_ROS_UDP
from hostlink.core.protocol.xrce.session import CLIENTS_MAX
from hostlink.errors import HostlinkError
from tests.support import xrce_board as board
from tests.support.xrce_board import TWIST, Client, sub

CATALOG = Catalog()
WRITER, LOSSY_WRITER, VELOCITY, WORDS = 0x05, 0x15, 0x06, 0x16
TEXT = "std_msgs::msg::dds_::String_"
OBJECTS = (
    (0x01, board.participant("/ns/base"), 0),
    (0x02, board.topic("rt/chatter", TEXT), 1),
    (0x03, b"\0\0", 1),
    (WRITER, board.endpoint(0x02, is_reader=False), 3),
    (0x32, board.topic("rt/noise", TEXT), 1),
    (LOSSY_WRITER, board.endpoint(0x32, is_reader=False, is_reliable=False), 3),
    (0x12, board.topic("rt/cmd_vel", "geometry_msgs::msg::dds_::Twist_"), 1),
    (0x04, b"\0\0", 1),
    (VELOCITY, board.endpoint(0x12, is_reader=True), 4),
    (0x22, board.topic("rt/words", TEXT), 1),
    (WORDS, board.endpoint(0x22, is_reader=True), 4),
)
STEPS = 250
KEPT_MAX = 4 * CLIENTS_MAX * 262144
QUEUED_MAX = 512


class Life:
    """A board from its start to the next one."""

    def __init__(self, number: int, client: Client) -> None:
        self.number, self.client = number, client
        self.has_begun = False  # it reads from then on
        self.sent: dict[int, int] = defaultdict(int)  # texts, by stream
        self.has_readers = False
        self.since = 0  # number of the first text and velocity that may be for it
        self.read = 0  # of `client.taken`
        self.last_text = -1


class Scene:
    """Boards behind one address, a session, and a network that loses, doubles and delays."""

    def __init__(self, seed: int) -> None:
        self.dice = Random(seed)
        self.session = MICRO_ROS_UDP.resumed(CATALOG, "")
        self.now_s = 0.0
        self.session.open(now_s=0.0)
        self.flying: list[tuple[float, int, Life | None, bytes]] = []  # to a life, or to the host
        self.order = 0
        self.lives: list[Life] = []
        self.seen: dict[tuple[int, int], int] = {}  # last text that the host took, by life and stream
        self.numbers = 1  # of texts and velocities to boards
        self.delivered = self.delivered_bytes = 0
        self.loss = self.dice.choice((0.0, 0.0, 0.1, 0.3))
        self.doubles = self.dice.choice((0.0, 0.1))
        self.delay_s = self.dice.choice((0.001, 0.01, 0.05))
        self.boards: list[Life] = []
        for _ in range(self.dice.randint(1, 3)):
            self.boards.append(self.start())

    def start(self, before: Life | None = None) -> Life:
        """A board begins, perhaps with the session or key of its life before; what was on its way is lost."""
        dice = self.dice
        key = dice.choice((b"\1\2\3\4", b"\5\6\7\x08", dice.randbytes(4)))
        session = dice.choice((0x81, 0x81 + len(self.lives) % 4, 0x01))
        if before is not None:
            key = dice.choice((key, before.client.key))
            session = dice.choice((session, before.client.session))
            self.flying.clear()
        used = {each.client.session for each in self.boards if each is not before}
        while session in used:  # a message does not tell which of them it is for
            session = 0x82 + dice.randrange(100)
        history, mtu = dice.choice((2, 4, 8)), dice.choice((96, 128, 512))
        life = Life(len(self.lives), Client(key=key, session=session, mtu=mtu, history=history))
        life.client.now_s = self.now_s
        self.lives.append(life)
        return life

    # -- the network --------------------------------------------------------------------------------------------------

    def fly(self, life: Life | None, data: bytes) -> None:
        while True:
            if self.dice.random() >= self.loss:
                self.order += 1
                self.flying.append((self.now_s + self.dice.uniform(0.0, self.delay_s), self.order, life, data))
            if self.dice.random() >= self.doubles:
                return

    def flush(self, life: Life) -> None:
        sent, life.client.sent = life.client.sent, []
        for each in sent:
            self.fly(None, each)

    def write(self) -> None:
        session = self.session
        while session.outbox.has_waiting:
            outgoing = session.pop_frame(now_s=self.now_s, wall_ns=10**18)
            if outgoing is None:
                break
            for life in self.boards:
                self.fly(life, outgoing.frame)

    def wait(self, seconds: float) -> None:
        """Let time pass, and deliver what arrives."""
        until_s = self.now_s + seconds
        for _ in range(20_000):
            due_s = min(self.session.deadline_s(), min((each[0] for each in self.flying), default=until_s))
            if due_s >= until_s:
                break
            self.now_s = max(self.now_s, due_s)
            arrived = sorted(each for each in self.flying if each[0] <= self.now_s)
            self.flying = [each for each in self.flying if each[0] > self.now_s]
            for _, _, life, data in arrived:
                self.deliver(life, data)
            if self.session.deadline_s() <= self.now_s:
                self.check_events(self.session.tick(now_s=self.now_s))
            self.write()
        else:
            raise AssertionError("the session asks to be called again and again")
        self.now_s = until_s

    def deliver(self, life: Life | None, data: bytes) -> None:
        if life is None:
            self.delivered += 1
            self.delivered_bytes += len(data)
            self.check_events(self.session.receive(data, now_s=self.now_s))
            self.write()
        elif life in self.boards and life.has_begun:
            life.client.now_s = self.now_s
            was_begun = life.client.agent_status is not None
            life.client.read(data)
            if life.client.agent_status is not None and not was_begun:
                life.client.reset()
                self.flying = [each for each in self.flying if each[2] is not life]  # of the session before
            self.check_taken(life)
            self.flush(life)

    # -- the oracle ---------------------------------------------------------------------------------------------------

    def check_events(self, found: list[object]) -> None:
        """No text is taken twice, in another order, or without being sent."""
        for event in found:
            if isinstance(event, MessageReceived):
                number, stream, text = map(int, event.payload[4:].decode().strip(".").split(":"))
                assert event.topic.name == ("/chatter" if stream >= 0x80 else "/noise")
                assert 0 <= text < self.lives[number].sent[stream], "invented"
                assert self.seen.get((number, stream), -1) < text, (number, stream, text, "twice or out of order")
                self.seen[number, stream] = text

    def check_taken(self, life: Life) -> None:
        """A board takes texts in their order and once, and neither a text nor a velocity of before its start."""
        taken, life.read = life.client.taken[life.read :], len(life.client.taken)
        for _, object_, _, payload in taken if life.client.agent_status == 0 else ():
            if object_ == WORDS:
                text = int(payload[4:-1].decode().strip("."))
                assert life.since <= text < self.numbers, (life.number, life.since, text, "old or invented")
                assert life.last_text < text, (life.number, life.last_text, text, "twice or out of order")
                life.last_text = text
            else:
                assert object_ == VELOCITY
                if not life.has_readers:
                    continue  # the middleware drops it
                number = int(TWIST.unpack(payload)[0])
                assert number == 0 or life.since <= number < self.numbers, (life.number, life.since, number)

    def check_counts(self) -> None:
        session = self.session
        assert session.counts.frames_from_device == self.delivered
        assert session.counts.bytes_from_device == self.delivered_bytes
        assert session.counts.malformed == 0
        assert session.wrong_sizes == 0
        q = session.quality
        assert all(getattr(q, each) >= 0 for each in q.__slots__)
        assert len(session._clients) <= CLIENTS_MAX
        assert session.kept_bytes <= KEPT_MAX
        outbox = session.outbox
        assert sum(map(len, outbox.answers.values())) <= QUEUED_MAX
        assert sum(len(each.waiting) + len(each.samples) for each in session._clients.values()) <= QUEUED_MAX
        assert len({each.slot for each in session._clients.values()}) == len(session._clients)

    # -- what happens -------------------------------------------------------------------------------------------------

    def step(self) -> None:
        dice = self.dice
        place = dice.randrange(len(self.boards))
        life = self.boards[place]
        client = life.client
        client.now_s = self.now_s
        has_session = client.agent_status == 0
        match dice.choices(
            ("wait", "text", "lossy", "object", "objects", "read", "heartbeat", "delete", "restart", "end",
             "ping", "words", "velocity", "zero"),
            (6, 8, 4, 3, 4, 3, 2, 1, 0.5, 0.2, 1, 6, 4, 2),
        )[0]:  # fmt: skip
            case "text" | "lossy" | "object" | "objects" | "read" | "heartbeat" | "delete" if not has_session:
                life.has_begun, life.since = True, self.numbers
                client.sent.append(client.creation())
                self.flush(life)
                self.wait(0.1)
                if client.agent_status == 0:
                    client.put(client.creating(*OBJECTS[0])[1])
            case "wait":
                self.wait(dice.choice((0.0, 0.002, 0.02, 0.15, 0.15, 1.5)))
            case "text":
                self.put_text(life)
            case "lossy":
                text = f"{life.number}:1:{life.sent[1]}"
                life.sent[1] += 1
                client.publish_best_effort(LOSSY_WRITER, board.text(text))
            case "object":
                life.has_readers = True
                client.put(client.creating(*dice.choice(OBJECTS), flags=dice.choice((0, 1, 2, 3)) << 1 | 1)[1])
            case "objects":
                life.has_readers = True
                for each in OBJECTS:
                    client.put(client.creating(*each)[1])
                    self.flush(life)
                    self.wait(0.03)
                    self.wait(0.0)
            case "read":
                for each in (VELOCITY, WORDS):
                    client.read_data(each, dice.choice((0x80, 0x80, 0x01)) if each == VELOCITY else 0x80)
            case "heartbeat":
                if client.slots:
                    self.ask(life)
            case "delete":
                client.put(sub(board.DELETE, struct.pack(">HH", client.request(), dice.choice(OBJECTS)[0])))
            case "restart":
                self.boards[place] = self.start(life)
            case "end":
                client.send(0, 0, sub(board.DELETE, bytes.fromhex("0335FFFE")))
                self.flush(life)
                self.wait(0.2)
                self.boards[place] = self.start(life)
            case "ping":
                client.send(0, 0, sub(board.GET_INFO, bytes.fromhex("000AFFFD02000000")), 0x80)
            case "words":
                size = dice.choice((1, 1, 100, 700))
                text = f"{self.numbers}".ljust(size, ".").encode()
                with contextlib.suppress(HostlinkError):
                    self.session.publish("/words", struct.pack("<I", len(text)) + text, depth=dice.choice((1, 4)))
                self.numbers += 1
            case "velocity":
                self.velocity()
            case "zero":
                for each in self.session.topics:
                    if each.name == "/cmd_vel":
                        self.session.send_zero(each, bytes(48))
        for each in self.boards:
            if each.client.slots and dice.random() < 0.3:
                self.ask(each)
        self.flush(life)
        self.write()
        self.check_counts()

    def ask(self, life: Life) -> None:
        """Send the HEARTBEAT of a client that waits for an acknowledgement."""
        client = life.client
        first = (client.last_acked + 1) & 0xFFFF
        client.send(0, 0, sub(board.HEARTBEAT, struct.pack("<HHB", first, client.last_sent, 0x80)))
        self.flush(life)

    def put_text(self, life: Life) -> None:
        number = life.sent[0x80]
        text = f"{life.number}:128:{number}".ljust(self.dice.choice((1, 100, 700)), ".")
        written = sub(board.WRITE, struct.pack(">HH", life.client.request(), WRITER) + board.text(text))
        if life.client.put(written):
            life.sent[0x80] += 1

    def velocity(self) -> None:
        with contextlib.suppress(HostlinkError):
            self.session.publish("/cmd_vel", TWIST.pack(self.numbers, 0, 0, 0, 0, 0), is_urgent=True)
        self.numbers += 1


@pytest.mark.slow
@given(st.integers(0, 2**32))
def test_boards_that_do_valid_things_in_any_order_see_each_message_once_and_in_order(seed: int) -> None:
    scene = Scene(seed)
    for _ in range(STEPS):
        scene.step()
    scene.wait(3.0)
    scene.check_counts()
