"""Host and device under dropouts, in virtual time: whatever happens on the line, both find each other again.

The bound: RECOVERY_S after the last fault the topics are negotiated, odometry comes in and commands go out. The host
asks for topics after 5 s of silence, then every 2 s; a false header on either side may hide one answer.
"""

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from hostlink.protocol import events
from hostlink.protocol.control import TopicInfo
from hostlink.protocol.frame import Id
from hostlink.protocol.session import Session
from hostlink.sim.device import SimulatedDevice

PAPER_LOOP_S = 1 / 30  # with the retry clause; without it a frame that straddles two such turns is lost by design
FAST_LOOP_S = 1 / 200
RECOVERY_S = 12.0
POSE_BYTES, TWIST_BYTES = 24, 48
POSE, TWIST = "geometry_msgs/Pose2D", "geometry_msgs/Twist"


class Line:
    """A TCP connection and the UART behind it, host on one side, device on the other; bytes come in pieces."""

    def __init__(self, *, retries: bool, piece_bytes: int) -> None:
        self.now_s = 0.0
        self.commands: list[bytes] = []
        self.poses = 0
        self.piece_bytes = piece_bytes
        self.lose_next = 0  # bytes that the line swallows
        self.damage_next = 0
        self.loop_s = PAPER_LOOP_S if retries else FAST_LOOP_S
        self.device = SimulatedDevice(retries=retries)
        self.odometry_id = self.device.advertise("/odometry", POSE, "m")
        self.device.subscribe("/velocity", TWIST, "m", self.commands.append)
        self.session = self._connect()
        self._turn_at_s = 0.0
        self._turns = 0

    def _connect(self) -> Session:
        def check(info: TopicInfo) -> int | None:
            return {POSE: POSE_BYTES, TWIST: TWIST_BYTES}.get(info.type)

        session = Session(check=check, uart_bytes_s=3840)
        session.open(now_s=self.now_s)
        return session

    def reconnect(self) -> None:
        """The connection breaks, in the middle of whatever was on it; the device comes back at once."""
        self.device.from_host.cut()
        self.device.to_host.cut()
        self.session = self._connect()

    def run(self, seconds: float) -> None:
        """Let both sides run, a millisecond at a time."""
        until_s = self.now_s + seconds
        while self.now_s < until_s:
            self.now_s += 0.001
            self._host()
            if self.now_s >= self._turn_at_s:
                self._device()

    def _host(self) -> None:
        from_device = self._on_the_way(self.device.to_host.take(self.now_s))
        for at in range(0, len(from_device), self.piece_bytes):
            piece = from_device[at : at + self.piece_bytes]
            self._look(self.session.receive(piece, now_s=self.now_s))
        if self.now_s >= self.session.deadline_s():
            self._look(self.session.tick(now_s=self.now_s))
        while (frame := self.session.take(now_s=self.now_s, wall_ns=int(self.now_s * 1e9))) is not None:
            self.device.from_host.send(self._on_the_way(frame), self.now_s)

    def _look(self, found: list[events.Event]) -> None:
        for event in found:
            if isinstance(event, events.MessageReceived):
                assert event.topic.name == "/odometry"
                assert event.payload == b"\x11" * POSE_BYTES
                self.poses += 1

    def _device(self) -> None:
        """A turn of the loop; where the retry clause waits, it goes on after that."""
        wait_s = self.device.spin(self.now_s)
        if wait_s is not None:
            self._turn_at_s = self.now_s + wait_s
            return
        self._turns += 1
        self._turn_at_s = self.now_s + self.loop_s
        if self._turns % round(0.1 / self.loop_s) == 0:
            self.device.publish(self.odometry_id, b"\x11" * POSE_BYTES, self.now_s)

    def _on_the_way(self, data: bytes) -> bytes:
        line = bytearray(data)
        while self.damage_next and line:
            line[len(line) // 2] ^= 0x20
            self.damage_next -= 1
        lost = min(self.lose_next, len(line))
        self.lose_next -= lost
        return bytes(line[lost:])

    def find_each_other(self) -> None:
        """What must hold RECOVERY_S after the last fault."""
        self.lose_next = self.damage_next = 0
        self.run(RECOVERY_S)
        assert self.device.is_configured
        poses, commands = self.poses, len(self.commands)
        for _ in range(5):
            self.session.publish("/velocity", b"\x22" * TWIST_BYTES, is_urgent=True)
            self.run(0.2)
        assert self.poses >= poses + 8
        assert len(self.commands) >= commands + 4


class Dropouts(RuleBasedStateMachine):
    """Any order of faults; at the end both work again."""

    @initialize(retries=st.booleans(), piece_bytes=st.sampled_from([1, 3, 7, 1000]))
    def connect(self, retries: bool, piece_bytes: int) -> None:
        self.line = Line(retries=retries, piece_bytes=piece_bytes)

    @rule(seconds=st.floats(0.01, 3.0))
    def run_on(self, seconds: float) -> None:
        self.line.run(seconds)

    @rule()
    def drive(self) -> None:
        if any(topic.kind is Id.SUBSCRIBER for topic in self.line.session.topics):
            self.line.session.publish("/velocity", b"\x22" * TWIST_BYTES, is_urgent=True)

    @rule()
    def break_the_connection(self) -> None:
        self.line.reconnect()

    @rule()
    def reboot_the_device(self) -> None:
        self.line.device.reboot()

    @rule(count=st.integers(1, 300))
    def lose_bytes(self, count: int) -> None:
        self.line.lose_next += count

    @rule(count=st.integers(1, 3))
    def damage_bytes(self, count: int) -> None:
        self.line.damage_next += count

    @rule(junk=st.binary(max_size=80))
    def boot_noise(self, junk: bytes) -> None:
        self.line.device.to_host.send(junk, self.line.now_s)

    @invariant()
    def nothing_crashed(self) -> None:
        """DeviceCrashed would have ended the rule; what reached the device is what was sent."""
        if hasattr(self, "line"):
            assert set(self.line.commands) <= {b"\x22" * TWIST_BYTES}

    def teardown(self) -> None:
        if hasattr(self, "line"):
            self.line.find_each_other()


TestDropouts = Dropouts.TestCase
TestDropouts.settings = settings(stateful_step_count=15, deadline=None)


def test_a_paced_command_every_tenth_of_a_second_arrives_for_a_minute() -> None:
    """The paper's link: 38400 baud, 30 Hz loop, retry clause, commands and odometry at 10 Hz."""
    line = Line(retries=True, piece_bytes=1000)
    line.run(2.0)
    for _ in range(600):
        line.session.publish("/velocity", b"\x22" * TWIST_BYTES, is_urgent=True)
        line.run(0.1)
    assert len(line.commands) == 600
    assert line.poses >= 590  # the retry clause stretches some turns
    assert line.device.dropped_frames == 0
    assert line.device.from_host.lost_bytes == 0
    assert line.session.counts.asks == 1
