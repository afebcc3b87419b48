"""Findings about micro-ROS boards: each fault is drawn with a board in virtual time. A healthy board has none."""

import contextlib
from collections.abc import Callable
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.diagnosis.evidence import PortSharing
from hostlink.core.diagnosis.link_monitor import SAMPLE_INTERVAL_S, LinkMonitor
from hostlink.core.diagnosis.rules import diagnose
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.cdr import cdr_of
from hostlink.core.protocol.events import MessageReceived
from hostlink.core.protocol.resampling import resample
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.session import DeviceProtocol
from hostlink.core.protocol.xrce.findings import PINGS
from hostlink.core.protocol.xrce.protocol import MICRO_ROS_SERIAL, MICRO_ROS_TCP, MICRO_ROS_UDP
from hostlink.core.protocol.xrce.session import XrceSession
from hostlink.errors import HostlinkError
from tests.support.xrce_board import (
    DELETE,
    GET_INFO,
    PARTICIPANT,
    PUBLISHER,
    REFERENCE,
    TOPIC,
    TWIST,
    WRITER,
    Client,
    Datagrams,
    Lengths,
    Link,
    Program,
    Serial,
    Stock,
    World,
    endpoint,
    object_id,
    participant,
    sub,
    text,
    topic,
)

CATALOG = Catalog()
KEY = (0x01020304).to_bytes(4)
PING = b"\x80\0\0\0" + sub(GET_INFO, bytes.fromhex("000AFFFD02000000"))
NODE, FIRST_TOPIC, GROUP, FIRST_WRITER = (object_id(0, each) for each in (PARTICIPANT, TOPIC, PUBLISHER, WRITER))


def cdr(name: str, message: dict[str, object]) -> bytes:
    type_ = CATALOG.message(name)
    assert type_ is not None
    return cdr_of(type_).from_ros1(type_.encode(message))


ODOMETRY = cdr("nav_msgs/Odometry", {"header": {"frame_id": "odom"}, "child_frame_id": "base_link"})
IMU = cdr("sensor_msgs/Imu", {"header": {"frame_id": "imu_link"}})


def least_bytes(name: str) -> int:
    type_ = CATALOG.message(name)
    return 0 if type_ is None else len(type_.encode({}))


class Watched:
    """A board, its session and the monitor of their link, which is sampled every second."""

    def __init__(
        self,
        program: Program,
        client: Client,
        *,
        session: XrceSession | None = None,
        transport: Datagrams | None = None,
        baud: int | None = None,
        damage: float = 0.0,
        **faults: float | tuple[float, float],
    ) -> None:
        session = session or MICRO_ROS_UDP.session(CATALOG)
        self.monitor = LinkMonitor(session, now_s=0.0, least_bytes=least_bytes)
        self.monitor.baud = baud
        link = Link(Random(3), **faults)  # type: ignore[arg-type]
        self.world = World(session, program, client, link, transport, damage)
        self._read = 0
        self.world.at(SAMPLE_INTERVAL_S, self._sample)

    def _sample(self) -> None:
        world = self.world
        for at_s, event in world.found[self._read :]:
            if not isinstance(event, MessageReceived):
                self.monitor.observe(event, at_s)
        self._read = len(world.found)
        self.monitor.sample(world.now_s)
        world.at(world.now_s + SAMPLE_INTERVAL_S, self._sample)

    def found(self, until_s: float) -> dict[str, str]:
        """Play until then. Return the findings: details by code."""
        self.world.run(until_s)
        evidence = self.monitor.evidence(self.world.now_s, silent_s=0.0)
        return {each.code: each.detail for each in diagnose(evidence)}


def stock(*, turn_s: float = 0.0, is_reliable: bool = True, period_s: float = 0.02, restarts: bool = True) -> Stock:
    client = Client(key=KEY)
    return Stock(client, ODOMETRY, IMU, turn_s=turn_s, is_reliable=is_reliable, period_s=period_s, restarts=restarts)


def watched(board: Stock, **faults: object) -> Watched:
    return Watched(board.run(), board.client, **faults)  # type: ignore[arg-type]


def drive(made: Watched) -> Watched:
    """Send velocities at 20 Hz as soon as the board takes them."""
    world = made.world

    def command() -> None:
        if world.session.topics:
            with contextlib.suppress(HostlinkError):
                world.session.publish("/cmd_vel", TWIST.pack(0.1, 0, 0, 0, 0, 0), is_urgent=True)
            world.write()
        world.at(world.now_s + 0.05, command)

    world.at(0.0, command)
    return made


def with_writers(*writers: tuple[bytes, bool], form: int = 3) -> Callable[[Client], Program]:
    """A program that creates writers and then listens: content of each topic, and whether it is reliable."""

    def program(client: Client) -> Program:
        yield from client.connect()
        yield from client.create(NODE, participant("board"), 0)
        for number, (content, is_reliable) in enumerate(writers):
            yield from client.create(object_id(number, TOPIC), content, NODE, form=form)
            yield from client.create(object_id(number, PUBLISHER), b"\0\0", NODE)
            writer = endpoint(object_id(number, TOPIC), is_reader=False, is_reliable=is_reliable)
            yield from client.create(
                object_id(number, WRITER),
                content if form == REFERENCE else writer,
                object_id(number, PUBLISHER),
                form=form,
            )
        while True:
            yield from client.listen(1.0)

    return program


def created(*writers: tuple[bytes, bool], form: int = 3, **faults: object) -> Watched:
    client = Client(key=KEY)
    return Watched(with_writers(*writers, form=form)(client), client, **faults)  # type: ignore[arg-type]


# -- a healthy board --------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("protocol", "transport"),
    [(MICRO_ROS_UDP, Datagrams), (MICRO_ROS_TCP, Lengths), (MICRO_ROS_SERIAL, Serial)],
    ids=["udp", "tcp", "serial"],
)
def test_healthy_board_has_no_finding(protocol: DeviceProtocol, transport: type[Datagrams]) -> None:
    session = protocol.session(CATALOG)
    assert isinstance(session, XrceSession)
    made = drive(watched(stock(), session=session, transport=transport()))
    for until_s in (1.0, 4.0, 12.0, 40.0):
        assert made.found(until_s) == {}
    assert made.world.session.quality.reliable > 1000


@pytest.mark.slow
@pytest.mark.parametrize("is_reliable", [True, False])
def test_healthy_board_without_commands_has_no_finding(is_reliable: bool) -> None:
    board = stock(is_reliable=is_reliable)
    if not is_reliable:
        board.odometry = IMU  # of the right size for one datagram
    made = watched(board)
    assert made.found(5.0).keys() <= {"best_effort_too_long", "type_differs"}


# -- the line ---------------------------------------------------------------------------------------------------------


class Raw:
    """Bytes of a serial port, read by a session."""

    def __init__(self, baud: int = 57600, protocol: DeviceProtocol = MICRO_ROS_SERIAL) -> None:
        self.session = protocol.session(CATALOG)
        self.session.open(now_s=0.0)
        self.monitor = LinkMonitor(self.session, now_s=0.0)
        self.monitor.baud = baud

    def found(self, data: bytes, seconds: int = 8) -> dict[str, str]:
        """Read the same bytes every second. Return the findings."""
        for second in range(seconds):
            self.session.receive(data, now_s=second + 0.5)
            self.monitor.sample(second + 1.0)
        return {each.code: each.detail for each in diagnose(self.monitor.evidence(float(seconds), silent_s=0.5))}


@pytest.mark.slow
@pytest.mark.parametrize("error", [0.98, 1.0, 1.01])
@pytest.mark.parametrize(("sent", "read"), [(57600, 115200), (9600, 57600), (115200, 460800), (115200, 921600)])
def test_slower_board_is_named_by_its_pings(sent: int, read: int, error: float) -> None:
    pings = resample(Serial().encode(PING) * 5, ratio=read / sent * error, gap_bits=0.5)
    found = Raw(read).found(pings)
    assert found.keys() == {"wrong_baud"}
    assert f"read at {read} baud, most likely sent at {sent}" in found["wrong_baud"]


@pytest.mark.parametrize(("sent", "read"), [(57600, 115200), (115200, 921600)])
def test_slower_board_is_named_at_a_port_that_expects_rosserial(sent: int, read: int) -> None:
    found = Raw(read, ROSSERIAL).found(resample(Serial().encode(PING) * 5, ratio=read / sent, gap_bits=0.5))
    assert found.keys() == {"wrong_baud"}
    assert f"read at {read} baud, most likely sent at {sent}" in found["wrong_baud"]


@pytest.mark.parametrize("stuck", [b"\0", b"\xff", b"\x80\x90"])
def test_stuck_line_has_no_rate(stuck: bytes) -> None:
    assert Raw(57600, ROSSERIAL).found(stuck * 100).keys() == {"no_sync"}
    assert Raw(57600).found(stuck * 100).keys() == {"no_sync"}


@pytest.mark.slow
@pytest.mark.parametrize(("sent", "read"), [(115200, 57600), (921600, 115200), (230400, 115200)])
def test_faster_board_is_not_given_a_wrong_rate(sent: int, read: int) -> None:
    found = Raw(read).found(resample(Serial().encode(PING) * 5, ratio=read / sent, gap_bits=0.5))
    assert found.keys() <= {"wrong_baud", "no_sync"}
    assert found
    assert "most likely" not in found.get("wrong_baud", "")


def test_ping_is_the_frame_that_the_guess_at_a_rate_knows() -> None:
    assert Serial().encode(PING) * 8 == PINGS


def test_text_boot_message_and_noise_on_the_line_are_named() -> None:
    assert Raw().found(b"connecting to WiFi...\r\n" * 4).keys() == {"text_on_line"}
    assert Raw().found(b"rst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST)\r\n").keys() == {"boot_noise"}
    assert Raw().found(bytes(range(128, 256)) * 3).keys() == {"no_sync"}


@pytest.mark.slow
def test_damaged_frames_are_counted_by_their_checksums() -> None:
    made = drive(watched(stock(), session=MICRO_ROS_SERIAL.session(CATALOG), transport=Serial(), damage=0.02))
    found = made.found(15.0)
    assert made.world.session.bad_checksums > 0
    assert found["damaged"] == f"{made.world.session.bad_checksums} bad checksums and {_frames(made)} good frames"


def _frames(made: Watched) -> int:
    return made.world.session.counts.frames_from_device


def test_other_program_at_the_port_explains_the_damage() -> None:
    made = Raw()
    made.monitor.sharing = PortSharing(("cat (pid 12)",), lost_reads=3)
    assert made.found(bytes(range(128, 256)) * 3).keys() == {"serial_shared"}


def test_board_that_hears_no_answer_is_named_by_its_questions() -> None:
    found = Raw().found(Serial().encode(PING))
    assert found == {"unheard": "it asked 8 times"}
    assert Raw().found(Serial().encode(Client(key=KEY).creation())).keys() == {"unheard"}


def test_board_that_is_heard_has_asked_and_begun() -> None:
    found = watched(stock()).found(6.0)
    assert "unheard" not in found


# -- loss -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@given(st.sampled_from((0.03, 0.1, 0.3)))
def test_loss_of_best_effort_messages_is_exact(loss: float) -> None:
    sent = []

    def program(client: Client) -> Program:
        yield from client.connect()
        for each in (
            (NODE, participant("board"), 0),
            (FIRST_TOPIC, topic("rt/imu", "sensor_msgs::msg::dds_::Imu_"), NODE),
        ):
            yield from client.create(*each)
        yield from client.create(GROUP, b"\0\0", NODE)
        yield from client.create(FIRST_WRITER, endpoint(FIRST_TOPIC, is_reader=False, is_reliable=False), GROUP)
        made.world.link.loss = loss
        while True:
            client.publish_best_effort(FIRST_WRITER, IMU)
            sent.append(client.now_s)
            yield from client.listen(0.02)

    client = Client(key=KEY)
    made = Watched(program(client), client)
    found = made.found(20.0)
    came, lost = made.world.session.quality.best_effort, made.world.session.counts.lost_messages
    total = came + lost
    assert 0 <= len(sent) - total <= 10  # those on their way, and the last ones
    assert found == {"best_effort_lost": f"{lost} of {total} messages ({lost / total:.1%}) in 30 s"}


@pytest.mark.slow
@pytest.mark.parametrize("loss", [0.05, 0.2])
def test_lost_acknowledged_messages_are_counted_with_the_time_of_an_answer(loss: float) -> None:
    made = drive(watched(stock(), loss=loss))
    found = made.found(15.0)
    assert "messages_resent" in found
    quality = made.world.session.quality
    assert f"{quality.missing} were missing, {quality.duplicates} came twice" in found["messages_resent"]
    assert f"of {quality.reliable} messages" in found["messages_resent"]
    assert "an answer takes" in found["messages_resent"]
    assert "best_effort_lost" not in found


# -- the board's program ----------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("period_s", [0.2, 1.0])
def test_healthy_board_that_publishes_seldom_and_is_driven_has_no_finding(period_s: float) -> None:
    assert drive(watched(stock(period_s=period_s))).found(20.0) == {}


@pytest.mark.slow
def test_slow_turns_of_the_loop_are_measured() -> None:
    made = drive(watched(stock(turn_s=0.15, period_s=0.15)))
    assert made.found(15.0).keys() == {"slow_loop"}


@pytest.mark.slow
def test_slow_board_without_commands_is_not_said_to_lose_messages() -> None:
    made = watched(stock(turn_s=0.15, period_s=0.15))
    for until_s in (2.0, 5.0, 15.0):
        assert made.found(until_s) == {}


@pytest.mark.slow
def test_board_far_away_waits_in_its_publishes() -> None:
    made = drive(watched(stock(), delay_s=(0.015, 0.016)))
    found = made.found(15.0)
    assert found.keys() == {"publishes_wait"}
    assert "messages/s of at least 3" in found["publishes_wait"]


@pytest.mark.slow
def test_publishes_whose_acknowledgements_are_lost_wait() -> None:
    made = watched(stock(), loss=0.1)  # without commands the board's own HEARTBEATs repair it
    found = made.found(20.0)
    assert "publishes waited for 0.1 s or longer" in found["publishes_wait"]
    assert made.world.session.quality.waits >= 3


def restarting(*, says_goodbye: bool, key_changes: bool) -> Watched:
    """A board that begins a new session every four seconds."""

    def program(client: Client) -> Program:
        while True:
            yield from client.connect()
            yield from client.create(NODE, participant("board"), 0)
            until_s = client.now_s + 4.0
            while client.now_s < until_s:
                yield from client.listen(0.5)
            if says_goodbye:
                client.send(0, 0, sub(DELETE, client.request().to_bytes(2) + b"\xff\xfe"))
            if key_changes:
                client.key = (int.from_bytes(client.key) + 1).to_bytes(4)

    client = Client(key=KEY)
    return Watched(program(client), client)


@pytest.mark.parametrize("says_goodbye", [False, True])
@pytest.mark.parametrize("key_changes", [False, True])
def test_objects_that_are_created_again_every_few_seconds_are_found(*, says_goodbye: bool, key_changes: bool) -> None:
    made = restarting(says_goodbye=says_goodbye, key_changes=key_changes)
    assert made.found(9.0) == {}
    assert made.found(31.0).keys() == {"created_again"}


@pytest.mark.slow
def test_board_without_code_to_reconnect_is_found_after_a_restart_of_the_host() -> None:
    before = Watched((board := stock(restarts=False)).run(), board.client)
    before.world.run(3.0)
    session = MICRO_ROS_UDP.resumed(CATALOG, before.world.session.memory())
    after = Watched(iter_of(before), before.world.client, session=session)
    assert after.found(20.0) == {}
    assert after.found(45.0).keys() == {"no_reconnect"}


@pytest.mark.slow
@pytest.mark.parametrize("away_s", [0.2, 1.5])
@pytest.mark.parametrize(
    ("protocol", "transport"), [(MICRO_ROS_UDP, Datagrams), (MICRO_ROS_SERIAL, Serial)], ids=["udp", "serial"]
)
def test_messages_sent_while_the_host_is_away_are_not_a_loss(
    protocol: DeviceProtocol, transport: type[Datagrams], away_s: float
) -> None:
    session = protocol.session(CATALOG)
    assert isinstance(session, XrceSession)
    board = stock(restarts=False)
    board.gives_up = False
    made = Watched(board.run(), board.client, session=session, transport=transport())
    made.world.run(3.0)
    resumed = protocol.resumed(CATALOG, session.memory())
    assert isinstance(resumed, XrceSession)
    made.world.restart_host(resumed, away_s=away_s)
    made.world.run(8.0)
    quality = resumed.quality
    assert quality.resumed == 1
    assert quality.reliable > 100
    assert (quality.missing, quality.duplicates, quality.resent) == (0, 0, 0)
    made.world.link.loss = 0.1
    made.world.run(12.0)
    assert quality.missing + quality.duplicates > 5


def iter_of(made: Watched) -> Program:
    """The program of a board, which now has another host."""
    return made.world._program


def test_board_in_the_session_of_another_host_is_named() -> None:
    before = Watched((board := stock(restarts=False)).run(), board.client)
    before.world.run(3.0)
    after = Watched(iter_of(before), before.world.client)
    found = after.found(9.0)
    assert found.keys() == {"session_unknown"}


def test_board_in_the_place_of_the_one_whose_session_was_kept_is_named() -> None:
    before = Watched((board := stock(restarts=False)).run(), board.client)
    before.world.run(3.0)
    memory = before.world.session.memory()
    number = before.world.session.state().clients[0].number
    session = MICRO_ROS_UDP.resumed(CATALOG, memory.replace(f'"number": {number}', f'"number": {number + 1}'))
    after = Watched(iter_of(before), before.world.client, session=session)
    found = after.found(2.0)
    assert found["session_unknown"] == "its numbers or messages are not those of the board whose session was kept"


# -- topics and types -------------------------------------------------------------------------------------------------

ODOMETRY_TOPIC = topic("rt/odom", "nav_msgs::msg::dds_::Odometry_")
LOG_TOPIC = topic("rt/rosout", "rcl_interfaces::msg::dds_::Log_")
OWN_TOPIC = topic("rt/own", "my_msgs::msg::dds_::Own_")


def test_best_effort_odometry_never_leaves_the_board() -> None:
    found = created((ODOMETRY_TOPIC, False)).found(3.0)
    assert found == {"best_effort_too_long": "/odom: a message of at least 700 bytes, best effort takes 496"}
    assert created((ODOMETRY_TOPIC, True)).found(3.0) == {}


def test_type_without_a_definition_is_named() -> None:
    assert created((OWN_TOPIC, True)).found(3.0) == {"type_unknown": "/own (my_msgs/Own)"}
    many = [(topic(f"rt/own{number}", "my_msgs::msg::dds_::Own_"), True) for number in range(5)]
    assert created(*many).found(3.0)["type_unknown"].endswith("; and 2 more")


def test_names_by_reference_are_said() -> None:
    client_made = created((text("odom__t")[4:], True), form=REFERENCE)
    assert client_made.found(3.0) == {"types_by_reference": "/odom"}


def test_messages_of_another_definition_are_counted() -> None:
    board = stock()
    board.imu = IMU[:100]
    assert watched(board).found(4.0).keys() == {"type_differs"}


def test_type_that_ros_2_has_changed_is_refused_with_its_fields() -> None:
    found = created((topic("rt/m", "visualization_msgs::msg::dds_::Marker_"), True)).found(3.0)
    assert found.keys() == {"type_changed"}


def test_message_that_is_longer_than_the_memory_of_the_board_is_named() -> None:
    made = watched(stock())
    assert made.found(3.0) == {}
    made.world.session.too_large = "/x: frame of 9000 bytes, the device takes 1984"
    assert made.found(4.0) == {"message_too_long": "/x: frame of 9000 bytes, the device takes 1984"}


def test_endpoints_above_the_bound_are_counted() -> None:
    session = MICRO_ROS_UDP.session(CATALOG, max_topics=2)
    bools = ((topic(f"rt/b{number}", "std_msgs::msg::dds_::Bool_"), True) for number in range(3))
    made = created(*bools, session=session)
    assert made.found(3.0) == {"too_many_endpoints": "1 were refused"}
