"""Messages between daemons of a fleet, and the bounds on their lengths and names."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.zenoh.fleet_messages import (
    ANSWER,
    LIVE,
    MALFORMED,
    MAX_ROBOTS,
    REQUEST,
    STATE,
    STOP_REQUEST,
    TOPIC_LIST,
    FleetCommand,
    Keys,
    Lock,
    Sender,
    Stop,
    Unlock,
    encode,
)
from hostlink.core.robot.velocity import PlanarVelocity

KEYS, ME = Keys("hostlink"), Sender("host-a", "12ab")
ROBOT = {
    "name": "robot_0",
    "velocity_topic": "/robot_0/cmd_vel",
    "odometry_topic": "/robot_0/odom",
    "odometry_type": "nav_msgs/Odometry",
}


def test_a_key_has_the_verb_first_and_the_sender_in_it() -> None:
    assert KEYS.key("state", ME) == "hostlink/state/host-a/12ab"
    assert KEYS.key("drive", ME, to="34cd") == "hostlink/drive/34cd/host-a/12ab"
    assert KEYS.key("out", ME, "robot_0", "odom") == "hostlink/out/host-a/12ab/robot_0/odom"


def test_a_sender_and_a_topic_are_read_from_a_key() -> None:
    assert KEYS.sender("hostlink/state/host-a/12ab") == ME
    assert KEYS.sender("hostlink/drive/34cd/host-a/12ab") == ME
    assert KEYS.topic("hostlink/out/host-a/12ab/robot_0/odom") == "/robot_0/odom"
    assert KEYS.topic("hostlink/publish/34cd/host-a/12ab/robot_0/a/b") == "/robot_0/a/b"


@pytest.mark.parametrize("key", ["hostlink", "hostlink/state/host-a", "other/state/host-a/12ab", ""])
def test_a_key_of_another_kind_has_no_sender(key: str) -> None:
    assert KEYS.sender(key) is None


@pytest.mark.parametrize(
    "change",
    [
        {"name": "a/b"},
        {"name": ""},
        {"name": "x" * 65},
        {"name": "*"},
        {"name": "robot\n0"},
        {"velocity_topic": "/a/**"},
        {"velocity_topic": "relative"},
        {"odometry_topic": "/" + "x" * 300},
        {"odometry_type": "Odometry"},
        {"lease_s": 0},
        {"lease_s": 1e9},
        {"priority": 101},
        {"lock_reason": "x" * 300},
        {"velocity": [1.0]},
        {"link": "1"},
    ],
)
def test_a_state_with_something_else_than_agreed_is_refused(change: dict[str, object]) -> None:
    STATE.decode(msgspec.json.encode({"sent_s": 0.0, "topics": 0, "robots": [ROBOT]}))
    with pytest.raises(MALFORMED):
        STATE.decode(msgspec.json.encode({"sent_s": 0.0, "topics": 0, "robots": [ROBOT | change]}))


def test_a_state_with_too_many_robots_is_refused() -> None:
    robots = [ROBOT | {"name": f"r{number}"} for number in range(MAX_ROBOTS + 1)]
    with pytest.raises(MALFORMED):
        STATE.decode(msgspec.json.encode({"sent_s": 0.0, "topics": 0, "robots": robots}))


@pytest.mark.parametrize("number", ["1e999", "NaN", '"1"', "null"])
def test_velocity_that_is_not_finite_is_refused(number: str) -> None:
    fields = '"type":"drive","number":1,"sent_s":0.5,"robot":"r","owner":1,"owner_name":"x","priority":50,"velocity":'
    REQUEST.decode(b"{%b[0,0,0,0,0,0.5]}" % fields.encode())
    with pytest.raises(MALFORMED):
        REQUEST.decode(b"{%b[%b,0,0,0,0,0]}" % (fields.encode(), number.encode()))


@pytest.mark.parametrize(
    "request_", [Unlock(number=1, robot="r"), Stop(number=2), Lock(number=3, robot="r", reason="x")]
)
def test_a_request_is_only_for_whom_it_is_meant(request_: Unlock | Stop | Lock) -> None:
    read, refuse = (REQUEST, STOP_REQUEST) if isinstance(request_, Unlock) else (STOP_REQUEST, REQUEST)
    assert read.decode(encode(request_)) == request_
    with pytest.raises(MALFORMED):
        refuse.decode(encode(request_))


def test_a_command_passes_unchanged() -> None:
    drive = FleetCommand(
        number=1,
        sent_s=1.5,
        robot="r",
        owner=2,
        owner_name="client 3",
        velocity=(0.1, 0.2, 0.0, 0.0, 0.0, -0.5),
        priority=60,
        epoch=7,
    )
    assert REQUEST.decode(encode(drive)) == drive
    assert drive.wanted == PlanarVelocity(0.1, 0.2, -0.5)


def test_messages_of_a_daemon_without_epochs_are_read() -> None:
    """An older one sends `link` and `stops`, and refuses by the name of a class; a newer one may send more."""
    old = {
        "type": "drive", "number": 1, "sent_s": 1.5, "robot": "r", "owner": 2, "owner_name": "x",
        "velocity": [0.1, 0, 0, 0, 0, 0], "priority": 50, "link": 7, "stops": 3, "later": [],
    }  # fmt: skip
    drive = REQUEST.decode(msgspec.json.encode(old))
    assert isinstance(drive, FleetCommand)
    assert drive.epoch is None
    state = STATE.decode(msgspec.json.encode({"sent_s": 0.0, "topics": 0, "robots": [ROBOT | {"later": 1}]}))
    assert state.robots[0].epoch is None
    pose = [1.0, 2.0, 0.5, 0.2, -0.1, 7, 0.0, 10.0, 3]  # without the fields that came later
    live = LIVE.decode(msgspec.json.encode({"robots": [["r", [0.2, -0.1], pose]]})).robots[0]
    assert (live.linear_y_m_s, live.pose.linear_y_m_s, live.pose.angular_rad_s) == (0.0, 0.0, -0.1)
    answer = ANSWER.decode(
        msgspec.json.encode({"number": 1, "error": "RobotHeld", "reason": "r: x drives", "stops": 4})
    )
    assert (answer.error, answer.epoch) == ("RobotHeld", None)


@given(st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
def test_no_bytes_raise_anything_but_a_bad_payload(payload: bytes) -> None:
    for decoder in (STATE, LIVE, TOPIC_LIST, ANSWER, REQUEST, STOP_REQUEST):
        with pytest.raises(MALFORMED):
            decoder.decode(payload)
