"""Directory: which device is which robot, who came back, and who was flashed alike."""

import dataclasses
import itertools
import time
from collections.abc import Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.robot.command_types import TopicType
from hostlink.core.robot.model import NO_SETTINGS, CommandKind, CommandSettings, Endpoint, RobotTopicNames, find_robot
from hostlink.core.robot.names import ANSWER_S, SURE_S, Accepted, Directory, Origin, Places, Undecided, is_played
from hostlink.core.robot.parts import Membership
from hostlink.core.robot.velocity import TWIST_TYPE

TWIST, POSE, ODOMETRY, EMPTY = "geometry_msgs/Twist", "geometry_msgs/Pose2D", "nav_msgs/Odometry", "std_msgs/Empty"
HOME, AWAY = "192.168.4.2", "192.168.4.3"
names = st.builds(
    "/{}{}".format,
    st.sampled_from(["", "a/", "b/", "a/b/"]),
    st.sampled_from(["velocity_commands", "cmd_vel", "speed", "odom", "my_odometry", "pose"]),
)
SENSOR: list[Endpoint] = [Endpoint("/range", "sensor_msgs/Range", False)]


def to_device(name: str, type_name: str = TWIST) -> Endpoint:
    return Endpoint(name, type_name, is_to_device=True)


def from_device(name: str, type_name: str = POSE) -> Endpoint:
    return Endpoint(name, type_name, is_to_device=False)


def paper_robot(name: str = "robot_0") -> list[Endpoint]:
    return [
        to_device(f"/{name}/velocity_commands"),
        to_device(f"/{name}/reset_odometry", EMPTY),
        to_device(f"/{name}/pid_tune_l", "geometry_msgs/Vector3"),
        from_device(f"/{name}/odometry"),
        from_device(f"/{name}/plot_data", TWIST),
    ]


def plain_robot() -> list[Endpoint]:
    return [to_device("cmd_vel"), from_device("odom", ODOMETRY)]


class Clocked:
    """A directory with a clock. Between two claims enough time passes that a silent device counts as disconnected."""

    def __init__(
        self,
        addresses: Mapping[str, str | None] | None = None,
        settings: Mapping[str, CommandSettings] | None = None,
    ) -> None:
        self.directory = Directory(addresses or {}, settings)
        self.now_s = 0.0

    def claim(self, link: int, address: str, topics: list[Endpoint], *, port: int = 0) -> Accepted | Undecided:
        claim = self.directory.claim(link, address, topics, now_s=self.now_s, peer=f"{address}:{port}")
        for rival in claim.probe if isinstance(claim, Undecided) else ():
            self.directory.presence(rival).note_asked(self.now_s)
        return claim

    def leave(self, link: int) -> None:
        self.directory.leave(link)

    def talk(self, *links: int, seconds: float = 1.0) -> None:
        """So much time passes, and these links say something ten times a second."""
        for _ in range(round(seconds / 0.1)):
            self.now_s += 0.1
            for link in links:
                self.directory.presence(link).note_read(self.now_s)


def accepted(
    ours: Clocked, link: int, address: str, topics: list[Endpoint], *, port: int = 0
) -> tuple[str | None, int | None]:
    ours.now_s += 100.0
    claim = ours.claim(link, address, topics, port=port)
    assert isinstance(claim, Accepted)
    return None if claim.robot is None else claim.robot.name, claim.replaces


def beside(ours: Clocked, link: int, address: str, topics: list[Endpoint], *others: int, port: int = 0) -> str:
    """Name of a robot that connects while the others still send."""
    ours.talk(*others)
    claim = ours.claim(link, address, topics, port=port)
    while isinstance(claim, Undecided):
        ours.talk(*others, link, seconds=0.1)
        claim = ours.claim(link, address, topics, port=port)
    assert claim.replaces is None
    return claim.robot.name


def directory(addresses: Mapping[str, str | None] | None = None) -> Clocked:
    return Clocked(addresses)


# -- what is a robot --------------------------------------------------------------------------------------------------


def test_the_robot_of_the_paper() -> None:
    assert find_robot(paper_robot()) == RobotTopicNames(
        name="robot_0",
        commands=(TopicType("/robot_0/velocity_commands", TWIST),),
        odometry="/robot_0/odometry",
        odometry_type=POSE,
        reset="/robot_0/reset_odometry",
    )


def test_robot_without_a_namespace_is_named_by_the_directory() -> None:
    assert find_robot(plain_robot()) == RobotTopicNames("", (TopicType("cmd_vel", TWIST),), "odom", ODOMETRY)
    assert accepted(directory(), 1, HOME, plain_robot()) == ("robot_0", None)


@pytest.mark.parametrize(
    "topics",
    [
        [],
        SENSOR,
        [from_device("/a/odometry")],
        [from_device("/a/plot_data", TWIST), from_device("/a/odometry")],  # a Twist from the device does not drive it
        [to_device("/a/limits")],
        [to_device("/cmd_vel", "std_msgs/String"), from_device("/a/odometry")],
    ],
)
def test_device_that_takes_no_velocity_is_not_a_robot(topics: list[Endpoint]) -> None:
    assert find_robot(topics) is None


@pytest.mark.parametrize(
    ("velocity", "odometry", "name"),
    [
        ("/r/cmd_vel", "/r/odom", "r"),
        ("r/cmd_vel", "/r/odom", "r"),
        ("~cmd_vel", "~odom", ""),
        ("~/r/cmd_vel", "~r/odom", "r"),
        ("/fleet/r/cmd_vel", "/fleet/r/odom", "fleet_r"),
        ("/r/base/cmd_vel", "/r/odom", "r"),
        ("/r/drive/cmd_vel", "/r/state/odom", "r"),
        ("/cmd_vel", "/r/odom", ""),
        ("/r/cmd_vel", "/odom", "r"),
        ("/left/cmd_vel", "/right/odom", "left"),
        ("/", "", ""),
        ("//r//cmd_vel", "/r/odom", "r"),
        ("/r\x1b[2J é/cmd_vel", "/r\x1b[2J é/odom", "r__2J__"),
        (f"/{'r' * 80}/cmd_vel", "/odom", "r" * 64),
    ],
)
def test_name_is_the_namespace_of_the_velocity(velocity: str, odometry: str, name: str) -> None:
    robot = find_robot([to_device(velocity), from_device(odometry)])
    assert (robot.name, robot.velocity, robot.odometry) == (name, velocity, odometry)


@pytest.mark.parametrize(
    ("velocities", "odometries", "chosen"),
    [
        (["/r/arm", "/r/cmd_vel", "/r/velocity_commands"], ["/r/odom"], ("/r/velocity_commands", "/r/odom")),
        (["/r/arm", "/cmd_vel"], ["/r/odom"], ("/cmd_vel", "/r/odom")),
        (["/arm/speed", "/base/speed"], ["/base/odom"], ("/base/speed", "/base/odom")),
        (["/arm/cmd_vel", "/base/cmd_vel"], ["/base/odom"], ("/base/cmd_vel", "/base/odom")),
        (["/r/b", "/r/a"], ["/r/odom"], ("/r/a", "/r/odom")),
        (["/r/cmd_vel"], ["/r/goal_reached", "/r/odometry"], ("/r/cmd_vel", "/r/odometry")),
        (["/r/cmd_vel"], ["/other/odom", "/r/pose"], ("/r/cmd_vel", "/r/pose")),
        (["/r/cmd_vel"], ["/r/pose_b", "/r/pose_a"], ("/r/cmd_vel", "/r/pose_a")),
    ],
)
def test_likeliest_pair_of_topics_is_chosen_in_any_order(
    velocities: list[str], odometries: list[str], chosen: tuple[str, str]
) -> None:
    topics = [*map(to_device, velocities), *map(from_device, odometries)]
    for order in itertools.permutations(topics):
        robot = find_robot(order)
        assert (robot.velocity, robot.odometry) == chosen


@pytest.mark.parametrize(
    ("topics", "reset"),
    [
        ([], None),
        ([to_device("/reset_bot/beep", EMPTY)], None),
        ([to_device("/reset_bot/reset", "std_msgs/Bool")], None),
        ([from_device("/reset_bot/was_reset", EMPTY)], None),
        ([to_device("/elsewhere/reset_odometry", EMPTY)], None),
        ([to_device("/", EMPTY)], None),
        ([to_device("/reset_bot/reset", EMPTY)], "/reset_bot/reset"),
        ([to_device("/reset_bot/a_reset", EMPTY), to_device("/reset_bot/odom_reset", EMPTY)], "/reset_bot/odom_reset"),
        ([to_device("/reset_bot/reset_b", EMPTY), to_device("/reset_bot/reset_a", EMPTY)], "/reset_bot/reset_a"),
    ],
)
def test_the_reset_topic(topics: list[Endpoint], reset: str | None) -> None:
    robot = find_robot([to_device("/reset_bot/cmd_vel"), from_device("/reset_bot/odom"), *topics])
    assert robot.reset == reset


# -- who came back ----------------------------------------------------------------------------------------------------


def test_a_robot_from_the_same_address_replaces_its_older_link() -> None:
    ours = directory()
    assert accepted(ours, 1, HOME, paper_robot()) == ("robot_0", None)
    assert accepted(ours, 2, HOME, paper_robot()[:4]) == ("robot_0", 1)
    assert accepted(ours, 3, HOME, paper_robot()) == ("robot_0", 2)


def test_device_that_announces_its_topics_again_replaces_no_device() -> None:
    ours = directory()
    for _ in range(2):
        assert accepted(ours, 1, HOME, paper_robot()) == ("robot_0", None)


def test_a_device_may_become_another() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot("robot_0"))
    assert accepted(ours, 1, HOME, paper_robot("robot_1")) == ("robot_1", None)
    assert accepted(ours, 2, AWAY, paper_robot("robot_0")) == ("robot_0", None)
    assert accepted(ours, 1, HOME, SENSOR) == (None, None)


def test_robots_behind_one_address_live_side_by_side() -> None:
    ours = directory()
    assert accepted(ours, 1, HOME, paper_robot("robot_0")) == ("robot_0", None)
    assert accepted(ours, 2, HOME, paper_robot("robot_1")) == ("robot_1", None)
    assert accepted(ours, 3, HOME, paper_robot("robot_0")) == ("robot_0", 1)


def test_device_that_is_not_a_robot_is_known_by_its_topics() -> None:
    ours = directory()
    assert accepted(ours, 1, HOME, SENSOR) == (None, None)
    assert accepted(ours, 2, HOME, [*SENSOR, from_device("/light", "std_msgs/Int16")]) == (None, None)
    assert accepted(ours, 3, AWAY, SENSOR) == (None, None)
    assert accepted(ours, 4, HOME, SENSOR) == (None, 1)
    assert accepted(ours, 5, HOME, paper_robot()) == ("robot_0", None)


def test_disconnected_device_is_not_replaced() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.leave(1)
    ours.leave(1)
    assert accepted(ours, 2, AWAY, paper_robot()) == ("robot_0", None)


# -- who is another that was flashed alike -----------------------------------------------------------------------------


def test_two_robots_that_talk_at_once_are_two() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.talk(1)
    assert ours.claim(2, HOME, paper_robot()) == Undecided(probe=(1,))
    ours.talk(2, seconds=0.1)
    assert ours.claim(2, HOME, paper_robot()) == Undecided(probe=())
    ours.talk(1, 2, seconds=0.2)
    assert ours.claim(2, HOME, paper_robot()) == Undecided(probe=())
    ours.talk(1, 2, seconds=0.3)
    claim = ours.claim(2, HOME, paper_robot())
    assert isinstance(claim, Accepted)
    assert claim.robot == dataclasses.replace(find_robot(paper_robot()), name="robot_0_2")
    assert (claim.own_name, claim.replaces, claim.is_numbered, claim.is_certain) == ("robot_0", None, True, False)


@pytest.mark.parametrize("after_s", [0.2, 0.6, 1.5])
def test_old_link_that_delivers_what_waited_in_an_outage_is_replaced(after_s: float) -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.talk(1)
    outage_s = ours.now_s
    assert ours.claim(2, HOME, paper_robot()) == Undecided(probe=(1,))
    ours.now_s += after_s
    for _ in range(20):
        ours.now_s += 0.001
        ours.directory.presence(1).note_read(ours.now_s)
    found = ours.claim(2, HOME, paper_robot())
    while found == Undecided(probe=()):
        ours.now_s += 0.1
        found = ours.claim(2, HOME, paper_robot())
    assert isinstance(found, Accepted)
    assert (found.robot, found.replaces) == (find_robot(paper_robot()), 1)
    assert ours.now_s < outage_s + after_s + 1.0


def test_device_that_seldom_sends_gets_a_request_and_stays_if_it_answers() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.now_s += 2.4  # all but the time between two of its requests for the time
    assert ours.claim(2, HOME, paper_robot()) == Undecided(probe=(1,))
    ours.now_s += 0.3
    ours.directory.presence(1).note_read(ours.now_s)
    assert beside(ours, 2, HOME, paper_robot(), 1) == "robot_0_2"


def test_device_that_answers_at_once_and_says_nothing_else_stays() -> None:
    """A board that publishes nothing: its answer arrives sooner than what was on its way from a dead link might."""
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.now_s += 1.0
    assert ours.claim(2, HOME, paper_robot()) == Undecided(probe=(1,))
    ours.directory.presence(1).note_read(ours.now_s + 0.01)
    ours.directory.presence(1).note_answered(ours.now_s, ours.now_s + 0.01)
    claim = ours.claim(2, HOME, paper_robot())
    assert isinstance(claim, Accepted)
    assert (claim.robot.name, claim.replaces) == ("robot_0_2", None)


def test_answer_to_a_request_that_was_sent_earlier_proves_nothing() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.directory.presence(1).note_answered(ours.now_s, ours.now_s + 1.0)
    ours.now_s += 1.0
    assert isinstance(ours.claim(2, HOME, paper_robot()), Undecided)
    ours.now_s += ANSWER_S + 2.0
    assert accepted(ours, 2, HOME, paper_robot()) == ("robot_0", 1)


def test_silence_counts_from_the_request_for_the_topics_and_a_device_with_a_slow_loop_has_longer() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    old = ours.directory.presence(1)
    old.note_read(ours.now_s)
    old.note_answered(ours.now_s - 0.4, ours.now_s)
    assert isinstance(ours.claim(2, HOME, paper_robot()), Undecided)
    ours.now_s += 0.9
    old.note_asked(ours.now_s)  # the request had to wait for the one before
    for _ in range(2):
        ours.now_s += 0.55
        assert isinstance(ours.claim(2, HOME, paper_robot()), Undecided)
    ours.now_s += 0.2
    claim = ours.claim(2, HOME, paper_robot())
    assert isinstance(claim, Accepted)
    assert claim.replaces == 1


def test_device_without_answer_counts_as_disconnected() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.now_s += 0.1
    assert ours.claim(2, HOME, paper_robot()) == Undecided(probe=(1,))
    ours.now_s += ANSWER_S
    claim = ours.claim(2, HOME, paper_robot())
    assert isinstance(claim, Accepted)
    assert (claim.replaces, claim.is_certain) == (1, True)


def test_busy_device_that_falls_silent_counts_as_disconnected_at_once() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.talk(1, seconds=2.0)
    ours.now_s += 0.6
    claim = ours.claim(2, HOME, paper_robot())
    assert isinstance(claim, Accepted)
    assert claim.replaces == 1


def test_device_whose_slow_loop_sends_in_bursts_is_not_replaced_by_an_equal_one() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    for _ in range(5):  # turns of its loop
        ours.now_s += 0.6
        for _ in range(6):
            ours.now_s += 0.002
            ours.directory.presence(1).note_read(ours.now_s)
    ours.now_s += 0.55
    claim = ours.claim(2, HOME, paper_robot())
    while isinstance(claim, Undecided):
        ours.talk(1, seconds=0.1)
        claim = ours.claim(2, HOME, paper_robot())
    assert (claim.robot.name, claim.replaces) == ("robot_0_2", None)


def test_device_that_was_silent_once_is_replaced_as_soon_as_before() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.talk(1)
    ours.now_s += 2.5
    ours.talk(1)
    ours.now_s += 0.6
    claim = ours.claim(2, HOME, paper_robot())
    assert isinstance(claim, Accepted)
    assert claim.replaces == 1


def test_short_silence_of_one_of_two_devices_does_not_replace_it() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    assert beside(ours, 2, HOME, paper_robot(), 1) == "robot_0_2"
    ours.talk(1, 2)
    ours.talk(2, seconds=1.0)
    assert isinstance(ours.claim(3, HOME, paper_robot()), Undecided)
    ours.talk(2, 3, seconds=SURE_S)
    claim = ours.claim(3, HOME, paper_robot())
    assert isinstance(claim, Accepted)
    assert (claim.robot.name, claim.replaces) == ("robot_0", 1)


def test_two_slow_ones_that_count_each_other_as_dead_do_so_once() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.now_s += 1.0
    ours.claim(2, HOME, paper_robot())
    ours.now_s += 0.6
    claim = ours.claim(2, HOME, paper_robot())
    assert isinstance(claim, Accepted)
    assert claim.replaces == 1
    ours.now_s += 0.9
    assert isinstance(ours.claim(3, HOME, paper_robot()), Undecided)
    ours.now_s += 0.9
    assert isinstance(ours.claim(3, HOME, paper_robot()), Undecided)
    ours.directory.presence(2).note_read(ours.now_s)
    assert beside(ours, 3, HOME, paper_robot(), 2) == "robot_0_2"


def test_a_sensor_beside_one_of_the_same_topics_is_another() -> None:
    ours = directory()
    accepted(ours, 1, HOME, SENSOR)
    ours.talk(1)
    assert ours.claim(2, HOME, SENSOR) == Undecided(probe=(1,))
    ours.talk(1, seconds=0.2)
    assert ours.claim(2, HOME, SENSOR) == Undecided(probe=())
    ours.talk(1, seconds=0.3)
    assert ours.claim(2, HOME, SENSOR) == Accepted(None, None)


def test_robots_at_other_addresses_have_numbers_in_the_order_in_which_they_came() -> None:
    ours = directory()
    names = [beside(ours, link, f"192.168.4.{link}", plain_robot(), *range(1, link)) for link in range(1, 5)]
    assert names == ["robot_0", "robot_1", "robot_2", "robot_3"]


def test_a_number_passes_over_names_that_others_have() -> None:
    ours = directory({"robot_0_2": "10.0.0.1"})
    accepted(ours, 1, HOME, paper_robot("robot_0_3"))
    assert beside(ours, 2, HOME, paper_robot(), 1) == "robot_0"
    assert beside(ours, 3, AWAY, paper_robot(), 1, 2) == "robot_0_4"


def test_the_longest_name_with_a_number_is_no_longer() -> None:
    ours = directory()
    assert beside(ours, 1, HOME, paper_robot("r" * 80)) == "r" * 64
    assert beside(ours, 2, AWAY, paper_robot("r" * 80), 1) == "r" * 62 + "_2"


def test_a_robot_whose_old_link_is_silent_at_another_address_waits_and_has_its_name_again() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.talk(1)
    ours.now_s += 4.0
    assert isinstance(ours.claim(2, AWAY, paper_robot()), Undecided)
    ours.leave(1)
    assert beside(ours, 2, AWAY, paper_robot()) == "robot_0"


def test_moved_robot_does_not_wait_for_ever() -> None:
    ours = directory()
    accepted(ours, 1, "/dev/ttyACM0", paper_robot())  # no silence ends the link of a serial port
    ours.now_s += 60.0
    assert isinstance(ours.claim(2, AWAY, paper_robot()), Undecided)
    ours.now_s += 3.0
    assert beside(ours, 2, AWAY, paper_robot()) == "robot_0_2"


def test_name_configured_for_another_address_is_reserved_without_its_device() -> None:
    ours = directory({"robot_0": HOME})
    assert accepted(ours, 1, AWAY, paper_robot("robot_0")) == ("robot_0_2", None)
    assert accepted(ours, 2, HOME, paper_robot("robot_0")) == ("robot_0", None)


# -- reconnecting to a name ------------------------------------------------------------------------------------------


def test_robots_that_were_present_at_once_come_back_to_their_names_in_any_order() -> None:
    ours = directory()
    addresses = [f"192.168.4.{number}" for number in range(2, 5)]
    names = [beside(ours, link, address, paper_robot(), *range(link)) for link, address in enumerate(addresses)]
    for order in itertools.permutations(range(3)):
        for link in range(3):
            ours.leave(link)
        for link in order:
            assert accepted(ours, link, addresses[link], paper_robot()) == (names[link], None)


def test_port_identifies_a_device_that_reconnects_behind_a_shared_address() -> None:
    ours = directory()
    for link, port in ((1, 5001), (2, 5002), (3, 5003)):
        beside(ours, link, HOME, paper_robot(), *range(1, link), port=port)
    for link in (1, 2, 3):
        ours.leave(link)
    claim = ours.claim(4, HOME, paper_robot(), port=5002)
    assert isinstance(claim, Accepted)
    assert (claim.robot.name, claim.is_certain) == ("robot_0_2", True)
    assert beside(ours, 5, HOME, paper_robot(), 4, port=6000) == "robot_0"
    claim = ours.claim(5, HOME, paper_robot(), port=6000)
    assert isinstance(claim, Accepted)
    assert not claim.is_certain


def test_one_that_is_alone_keeps_its_name_at_another_address() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.leave(1)
    assert accepted(ours, 2, AWAY, paper_robot()) == ("robot_0", None)


def test_name_of_one_of_several_devices_is_kept_until_it_is_forgotten() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    beside(ours, 2, AWAY, paper_robot(), 1)
    ours.leave(1)
    assert accepted(ours, 3, "192.168.4.4", paper_robot()) == ("robot_0_3", None)
    ours.directory.forget("robot_0")
    assert accepted(ours, 4, "192.168.4.5", paper_robot()) == ("robot_0", None)


def test_a_robot_that_is_there_is_not_forgotten() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.directory.forget("robot_0")
    assert beside(ours, 2, AWAY, paper_robot(), 1) == "robot_0_2"


# -- how long it takes ------------------------------------------------------------------------------------------------


def test_ten_thousand_topics_are_read_once_each() -> None:
    topics = [
        *(to_device(f"/n{number}/cmd_vel") for number in range(10_000)),
        *(from_device(f"/n{number}/odom") for number in range(10_000)),
    ]
    began_s = time.process_time()
    robot = find_robot(topics)
    assert time.process_time() - began_s < 2.0  # 0.1 s; each with each is a minute
    assert robot.name == "n0"


@given(st.lists(st.builds(Endpoint, names, st.sampled_from([TWIST, POSE, ODOMETRY]), st.booleans()), max_size=12))
def test_the_pair_is_the_best_of_all_pairs(topics: list[Endpoint]) -> None:
    velocities = [name for name, type_name, is_to_device in topics if is_to_device and type_name == TWIST]
    odometries = [name for name, type_name, is_to_device in topics if not is_to_device and type_name != TWIST]
    # A name that tells of motion precedes one that tells of something else, such as "pose".
    velocities = [name for name in velocities if "vel" in name or "speed" in name] or velocities
    robot = find_robot(topics)
    if robot is None or not odometries:
        assert not velocities or not odometries
    else:
        best = min(itertools.product(velocities, odometries), key=lambda pair: unlikelihood(*pair))
        assert (robot.velocity, robot.odometry) == best


def unlikelihood(velocity: str, odometry: str) -> tuple[int, bool, bool, str, str]:
    """Rank of a pair by a person's choice: a usual name, one namespace, a word for odometry."""
    *velocity_space, velocity_leaf = velocity.split("/")
    *odometry_space, odometry_leaf = odometry.split("/")
    rank = {"velocity_commands": 0, "cmd_vel": 1}.get(velocity_leaf, 2)
    return rank, velocity_space != odometry_space, "odom" not in odometry_leaf, velocity, odometry


# -- configured names -------------------------------------------------------------------------------------------------


def test_the_configuration_names_a_robot_by_its_address() -> None:
    ours = directory({"left": HOME, "right": AWAY, "spare": None})
    assert accepted(ours, 1, HOME, plain_robot()) == ("left", None)
    assert accepted(ours, 2, AWAY, plain_robot()) == ("right", None)
    assert accepted(ours, 3, HOME, plain_robot()) == ("left", 1)
    assert accepted(ours, 4, "192.168.4.9", plain_robot()) == ("robot_0", None)


@pytest.mark.parametrize("is_named", [True, False])
def test_board_at_a_configured_port_never_gets_the_name_of_another_port(*, is_named: bool) -> None:
    topics = plain_robot() if is_named else [to_device("cmd_vel")]
    ours = directory({"left": f"{HOME}:5001", "right": f"{HOME}:5002"})
    assert accepted(ours, 1, HOME, topics, port=5001) == ("left", None)
    assert accepted(ours, 2, HOME, topics, port=5002) == ("right", None)  # the first is silent
    ours.leave(1)
    ours.leave(2)
    assert accepted(ours, 3, HOME, topics, port=5002) == ("right", None)
    ours.leave(3)
    assert accepted(ours, 4, HOME, topics, port=5001) == ("left", None)


def test_the_configuration_names_a_robot_by_its_address_and_port() -> None:
    ours = directory({"left": f"{HOME}:5001", "right": f"{HOME}:5002"})
    assert beside(ours, 1, HOME, plain_robot(), port=5002) == "right"
    assert beside(ours, 2, HOME, plain_robot(), 1, port=5001) == "left"
    assert beside(ours, 3, HOME, plain_robot(), 1, 2, port=5003) == "robot_0"


def test_a_configured_serial_port_is_an_address() -> None:
    ours = directory({"due": "/dev/ttyACM0"})
    assert accepted(ours, 1, "/dev/ttyACM0", plain_robot()) == ("due", None)


def test_a_configured_name_does_not_make_a_robot_of_a_sensor() -> None:
    assert accepted(directory({"left": HOME}), 1, HOME, SENSOR) == (None, None)


def test_a_robot_without_a_configured_address_keeps_its_name() -> None:
    assert accepted(directory({"robot_0": None}), 1, HOME, paper_robot()) == ("robot_0", None)


def test_one_configured_name_does_not_make_one_robot_of_two() -> None:
    ours = directory({"left": HOME})
    assert accepted(ours, 1, HOME, paper_robot("robot_0")) == ("left", None)
    assert accepted(ours, 2, HOME, paper_robot("robot_1")) == ("robot_1", None)
    assert accepted(ours, 3, HOME, paper_robot("robot_0")) == ("left", 1)
    assert accepted(ours, 4, HOME, paper_robot("robot_1")) == ("robot_1", 2)


def test_several_names_at_one_address_go_to_those_who_have_them() -> None:
    ours = directory({"robot_0": HOME, "robot_1": HOME, "third": HOME})
    assert accepted(ours, 1, HOME, paper_robot("robot_1")) == ("robot_1", None)
    assert accepted(ours, 2, HOME, paper_robot("robot_0")) == ("robot_0", None)
    assert accepted(ours, 3, HOME, plain_robot()) == ("third", None)


def test_one_that_leaves_before_it_is_decided_leaves_nothing_behind() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.talk(1)
    assert isinstance(ours.claim(2, HOME, paper_robot()), Undecided)
    ours.leave(2)
    assert beside(ours, 3, HOME, paper_robot(), 1) == "robot_0_2"


# -- which topics are a robot's own -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "own"),
    [
        (("/a/cmd_vel", "/a/odom", "/a/reset"), {"/a/cmd_vel", "/a/odom", "/a/reset"}),
        (("/a/cmd_vel", "/a/odom", None), {"/a/cmd_vel", "/a/odom"}),
        (("/cmd_vel", "/odom", None), {"/cmd_vel", "/odom"}),
        (("/cmd_vel", "/a/odom", "/reset"), {"/cmd_vel", "/a/odom"}),
        (("/a/cmd_vel", "/b/odom", "/b/reset"), {"/a/cmd_vel"}),
        (("/fleet/a/cmd_vel", "/fleet/a/sensors/odom", None), {"/fleet/a/cmd_vel", "/fleet/a/sensors/odom"}),
    ],
)
def test_a_robots_own_topics_are_its_velocity_and_what_is_in_its_namespace(
    names: tuple[str, str, str | None], own: set[str]
) -> None:
    velocity, odometry, reset = names
    types = {velocity: TWIST_TYPE, odometry: "geometry_msgs/Pose2D", reset: "std_msgs/Empty"}
    robot = RobotTopicNames("a", (TopicType(velocity, TWIST),), odometry, "geometry_msgs/Pose2D", reset)
    assert robot.own == {name: types[name] for name in own}


def test_a_name_that_is_both_is_a_velocity() -> None:
    assert RobotTopicNames("x", (TopicType("/x", TWIST),), "/x", "geometry_msgs/Pose2D").own == {"/x": TWIST_TYPE}


# -- recordings that are played ---------------------------------------------------------------------------------------


def played(name: str = "robot_0") -> list[Endpoint]:
    return [*paper_robot(name), from_device(f"/{name}/played", "hostlink_msgs/PlayedRecording")]


def test_board_with_a_topic_named_played_is_a_robot() -> None:
    ours = directory()
    topics = [*paper_robot(), from_device("/robot_0/played", "std_msgs/String")]
    assert not is_played(topics)
    assert accepted(ours, 1, HOME, topics) == ("robot_0", None)


def test_a_recording_has_the_name_of_a_robot_that_was_never_there() -> None:
    assert accepted(directory(), 1, HOME, played()) == ("robot_0", None)


@pytest.mark.parametrize("address", [HOME, AWAY])
def test_robot_that_connects_gets_its_name_from_a_played_recording(address: str) -> None:
    ours = directory()
    assert beside(ours, 1, HOME, played()) == "robot_0"
    ours.talk(1)
    claim = ours.claim(2, address, paper_robot())
    assert isinstance(claim, Accepted)
    assert (claim.robot.name, claim.replaces) == ("robot_0", 1)
    ours.leave(1)
    assert beside(ours, 3, HOME, played(), 2) == "robot_0_2"


@pytest.mark.parametrize("address", [HOME, AWAY])
def test_a_robot_that_was_away_gets_its_name_back_from_a_recording(address: str) -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.leave(1)
    assert accepted(ours, 2, HOME, played()) == ("robot_0", None)
    assert accepted(ours, 3, address, paper_robot()) == ("robot_0", 2)


@pytest.mark.parametrize("address", [HOME, AWAY])
def test_a_recording_never_replaces_the_link_of_a_silent_robot(address: str) -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    assert accepted(ours, 2, address, played()) == ("robot_0_2", None)


def test_two_played_recordings_take_no_name_from_a_robot_that_connects_later() -> None:
    ours = directory()
    assert [beside(ours, link, HOME, played(), *range(1, link), port=link) for link in (1, 2)] == [
        "robot_0",
        "robot_0_2",
    ]
    ours.leave(1)
    ours.leave(2)
    assert accepted(ours, 3, HOME, paper_robot()) == ("robot_0", None)


def test_a_recording_beside_its_robot_is_not_one_of_several_devices_of_a_name() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    claim = ours.claim(2, HOME, played())
    assert isinstance(claim, Accepted)
    assert (claim.robot.name, claim.own_name, claim.is_numbered) == ("robot_0_2", "robot_0", False)


# -- settings that describe a device ----------------------------------------------------------------------------------

INT16, OTHER = "std_msgs/Int16", "192.168.4.9"
MOTORS = [to_device("l", INT16), to_device("r", INT16)]
TWO_MOTORS = CommandSettings(CommandKind.WHEELS, ("l", "r"))
AT_HOME = Origin("", HOME, f"{HOME}:1")


def test_device_is_the_robot_whose_settings_name_its_topics_those_of_its_address_precede() -> None:
    ours = Clocked({"van": None, "car": HOME}, {"van": TWO_MOTORS, "car": TWO_MOTORS._replace(topics=("r", "l"))})
    found = [ours.claim(link, address, MOTORS) for link, address in enumerate((HOME, AWAY))]
    robots = [claim.robot for claim in found if isinstance(claim, Accepted)]
    assert [(each.name, [topic.name for topic in each.commands]) for each in robots] == [
        ("car", ["r", "l"]),
        ("van", ["l", "r"]),
    ]
    assert accepted(ours, 3, OTHER, MOTORS[:1]) == (None, None)


def test_settings_without_an_address_belong_to_the_device_that_announces_their_name() -> None:
    topics = [to_device("/rover/cmd_vel"), from_device("/rover/odom", ODOMETRY), from_device("/rover/pose")]
    settings = CommandSettings(odometry="/rover/pose")
    ours = Clocked({"rover": None}, {"rover": settings})
    claim = ours.claim(1, HOME, topics)
    assert isinstance(claim, Accepted)
    assert (claim.robot.name, claim.robot.odometry, claim.settings) == ("rover", "/rover/pose", settings)
    others = Clocked({"rover": None}, {"rover": settings._replace(topics=("/drive",))}).claim(1, HOME, topics)
    assert isinstance(others, Accepted)
    assert (others.robot.name, others.robot.odometry) == ("rover", "/rover/pose")  # also with a wrong topic


def test_device_with_a_wrong_topic_has_the_name_of_its_address_until_the_right_one_connects() -> None:
    ours = Clocked({"car": HOME}, {"car": TWO_MOTORS})
    assert accepted(ours, 1, HOME, paper_robot()) == ("car", None)
    assert accepted(ours, 2, HOME, MOTORS) == ("car", 1)
    assert accepted(ours, 3, HOME, paper_robot()) == ("robot_0", None)


def test_device_without_the_topics_of_several_robots_of_its_address_is_none_of_them() -> None:
    others = TWO_MOTORS._replace(topics=("a", "b"))
    ours = Clocked({"car": HOME, "van": HOME}, {"car": TWO_MOTORS, "van": others})
    assert accepted(ours, 1, HOME, paper_robot()) == ("robot_0", None)
    assert ours.directory.explain(paper_robot(), AT_HOME)[1] is None
    assert accepted(ours, 2, HOME, MOTORS) == ("car", None)
    more = Clocked({"car": HOME, "any": HOME}, {"car": TWO_MOTORS, "any": CommandSettings(odometry="")})
    claim = more.claim(1, HOME, paper_robot())
    assert isinstance(claim, Accepted)
    assert (claim.robot.name, claim.settings.odometry) == ("any", "")


def test_settings_with_a_wrong_topic_do_not_describe_a_namesake_at_another_address_or_in_space() -> None:
    topics = [to_device("/rover/cmd_vel")]
    for address, settings in ((AWAY, TWO_MOTORS), (None, TWO_MOTORS._replace(is_spatial=True))):
        claim = Clocked({"rover": address}, {"rover": settings}).claim(1, HOME, topics)
        assert isinstance(claim, Accepted)
        assert claim.robot is not None
        assert claim.settings == NO_SETTINGS


def test_explanation_names_the_robot_of_the_settings_and_what_the_device_calls_itself() -> None:
    settings = {"car": TWO_MOTORS, "r": CommandSettings(devices=(OTHER, "arm"))}
    ours = Directory({"car": None, "home": HOME}, settings)

    def explained(topics: list[Endpoint], address: str) -> tuple[str | None, str | None]:
        robot, chosen = ours.explain(topics, Origin("", address, f"{address}:1"))
        return None if robot is None else robot.name, chosen

    assert explained(MOTORS, AWAY) == ("car", "car")
    assert explained(paper_robot(), HOME) == ("robot_0", "home")
    assert explained(SENSOR, HOME) == (None, "home")
    assert explained(paper_robot(), AWAY) == ("robot_0", None)
    assert explained(SENSOR, OTHER) == (None, "r")
    assert explained([to_device("/arm/cmd_vel")], AWAY) == ("arm", "r")


# -- robots of several devices ----------------------------------------------------------------------------------------

COMMAND, POSE_ALONE = [to_device("cmd_vel")], [from_device("odom", ODOMETRY)]
SECOND_COMMAND = [*POSE_ALONE, to_device("other/cmd_vel")]
BOTH = CommandSettings(devices=(HOME, AWAY))


def of_two(settings: CommandSettings = BOTH, **others: CommandSettings) -> Clocked:
    return Clocked({"r": None, **dict.fromkeys(others)}, {"r": settings, **others})


def part(ours: Clocked, link: int, address: str, topics: list[Endpoint]) -> tuple[str | None, str | None]:
    """Name of the robot that the device commands, and that of which it is a part."""
    claim = ours.claim(link, address, topics)
    assert isinstance(claim, Accepted)
    assert claim.replaces is None
    if claim.member is not None:
        assert claim.member.place in (address, "arm", "base")
        assert claim.robot is None or (claim.is_certain and not claim.is_numbered)
    return None if claim.robot is None else claim.robot.name, None if claim.member is None else claim.member.robot


@pytest.mark.parametrize("order", [(1, 2), (2, 1)])
def test_robot_of_several_devices_is_the_one_that_takes_a_velocity_and_the_others_are_its_parts(
    order: tuple[int, int],
) -> None:
    ours = of_two()
    devices = {1: (HOME, COMMAND), 2: (AWAY, POSE_ALONE)}
    found = {link: part(ours, link, *devices[link]) for link in order}
    assert found == {1: ("r", "r"), 2: (None, "r")}
    assert part(ours, 3, OTHER, plain_robot()) == ("robot_0", None)


def test_device_is_a_part_by_the_namespace_of_its_topics() -> None:
    ours = of_two(CommandSettings(devices=(HOME, "arm")))
    assert part(ours, 1, OTHER, [to_device("/arm/cmd_vel")]) == ("r", "r")
    assert part(ours, 2, "10.0.0.7", [from_device("/arm/odom", ODOMETRY)]) == (None, "r")
    assert ours.directory.member([from_device("/arm/odom")], AT_HOME) == Membership("r", HOME)


@pytest.mark.parametrize(("first", "second"), [(HOME, AWAY), (AWAY, HOME)])
def test_second_device_that_takes_a_velocity_gets_the_name_of_its_robot_only_once(first: str, second: str) -> None:
    """Two programs would each drive one half of it."""
    ours = of_two()
    assert part(ours, 1, first, COMMAND) == ("r", "r")
    assert part(ours, 2, second, SECOND_COMMAND) == (None, "r")
    assert part(ours, 1, first, COMMAND) == ("r", "r")  # it announces its topics again
    ours.leave(1)
    assert part(ours, 2, second, SECOND_COMMAND) == ("r", "r")


@pytest.mark.parametrize("order", [(1, 2), (2, 1)])
def test_new_settings_choose_the_device_that_commands_and_leave_other_robots_as_they_are(
    order: tuple[int, int],
) -> None:
    other = CommandSettings(devices=(OTHER, "arm"))
    ours = of_two(s=other)
    devices = {1: (HOME, COMMAND), 2: (AWAY, SECOND_COMMAND)}
    assert part(ours, 2, *devices[2]) == ("r", "r")
    assert part(ours, 1, *devices[1]) == (None, "r")
    assert part(ours, 3, OTHER, COMMAND) == ("s", "s")
    chosen = {"r": BOTH._replace(command_device=HOME), "s": other}
    places = Places({"r": None, "s": None}, {name: each.devices for name, each in chosen.items()})
    assert ours.directory.reconfigure(places, chosen) == {}
    assert part(ours, 4, "10.0.0.7", [to_device("/arm/cmd_vel")]) == (None, "s")  # the other device still commands it
    assert {link: part(ours, link, *devices[link]) for link in order} == {1: ("r", "r"), 2: (None, "r")}


def test_name_of_a_robot_of_several_devices_is_reserved_without_them() -> None:
    assert part(of_two(), 1, OTHER, [to_device("/r/cmd_vel")]) == ("r_2", None)


@pytest.mark.parametrize("order", [(1, 2), (2, 1)])
def test_two_robots_that_the_settings_make_one_are_one_in_any_order(order: tuple[int, int]) -> None:
    ours = Clocked()
    devices = {1: (HOME, [to_device("/r/cmd_vel")]), 2: (AWAY, [to_device("/other/cmd_vel")])}
    assert [part(ours, link, *devices[link]) for link in (1, 2)] == [("r", None), ("other", None)]
    ours.directory.reconfigure(Places({"r": None}, {"r": BOTH.devices}), {"r": BOTH})
    assert {link: part(ours, link, *devices[link]) for link in order} == {1: ("r", "r"), 2: (None, "r")}


def test_device_that_the_settings_make_a_part_of_a_robot_gives_up_its_own_name() -> None:
    ours = Clocked()
    assert part(ours, 1, HOME, COMMAND) == ("robot_0", None)
    places = Places({"r": None}, {"r": BOTH.devices})
    assert ours.directory.reconfigure(places, {"r": BOTH}) == {"robot_0": 1}
    assert part(ours, 1, HOME, COMMAND) == ("r", "r")
    assert ours.directory.reconfigure(Places({}), {}) == {}
    assert part(ours, 1, HOME, COMMAND) == ("r", None)  # programs know it by that name, and it is free


def test_played_recording_is_a_part_of_no_robot() -> None:
    assert part(of_two(CommandSettings(devices=(HOME, "robot_0"))), 1, HOME, played()) == ("robot_0", None)


# -- several devices that one entry of a robot means ------------------------------------------------------------------

ENCODERS, NAMED = [from_device("/enc/odom", ODOMETRY)], CommandSettings(devices=("base", "enc"))
BASE = [to_device("/base/cmd_vel")]


def memberships(ours: Clocked, links: dict[int, str], topics: list[Endpoint]) -> dict[int, bool]:
    """Return for each device, by its link and address, whether it waits for the place."""
    found = {}
    for link, address in links.items():
        claim = ours.claim(link, address, topics)
        assert isinstance(claim, Accepted)
        assert claim.member is not None
        assert claim.robot is None or not claim.member.is_waiting
        found[link] = claim.member.is_waiting
    return found


@pytest.mark.parametrize("topics", [ENCODERS, BASE])
def test_first_device_has_its_place_in_a_robot_until_it_leaves_and_another_is_offered_it(
    topics: list[Endpoint],
) -> None:
    ours = of_two(NAMED)
    place = Membership("r", "enc" if topics is ENCODERS else "base")
    assert ours.directory.is_free(place)
    assert memberships(ours, {1: HOME, 2: AWAY}, topics) == {1: False, 2: True}
    assert not ours.directory.is_free(place._replace(is_waiting=True))
    assert memberships(ours, {2: AWAY, 1: HOME}, topics) == {2: True, 1: False}  # they announce again
    assert memberships(ours, {2: AWAY}, [*topics, from_device("/range")]) == {2: True}  # other topics
    ours.leave(1)
    assert ours.directory.is_free(place)
    assert memberships(ours, {2: AWAY}, topics) == {2: True}  # the robot may still move
    ours.directory.offer(2)
    assert memberships(ours, {2: AWAY, 3: HOME}, topics) == {2: False, 3: True}


def test_device_that_reconnects_while_its_old_link_seems_alive_keeps_its_place() -> None:
    ours = of_two(NAMED)
    assert memberships(ours, {1: HOME, 2: AWAY}, ENCODERS) == {1: False, 2: True}
    ours.talk(1, 2)
    claim = ours.claim(3, HOME, ENCODERS)
    while isinstance(claim, Undecided):
        ours.talk(2, 3)
        claim = ours.claim(3, HOME, ENCODERS)
    assert (claim.replaces, claim.member) == (1, Membership("r", "enc"))
    assert memberships(ours, {2: AWAY}, ENCODERS) == {2: True}


def test_device_that_reconnects_while_it_waits_for_a_place_waits_on() -> None:
    ours = of_two(NAMED)
    assert memberships(ours, {1: HOME, 2: AWAY}, ENCODERS) == {1: False, 2: True}
    ours.leave(1)
    claim = ours.claim(3, AWAY, ENCODERS)
    while isinstance(claim, Undecided):
        ours.now_s += 1.0
        claim = ours.claim(3, AWAY, ENCODERS)
    assert (claim.replaces, claim.member) == (2, Membership("r", "enc", is_waiting=True))
    ours.directory.offer(3)
    assert memberships(ours, {3: AWAY}, ENCODERS) == {3: False}


def test_new_places_that_name_the_same_parts_leave_the_name_of_a_robot_of_several_devices() -> None:
    ours = of_two(NAMED)
    same, others = Places({"r": None}, {"r": NAMED.devices}), Places({"r": None}, {"r": ("arm", "enc")})
    assert part(ours, 1, HOME, BASE) == ("r", "r")
    assert (ours.directory.misplaced(same), ours.directory.misplaced(others)) == ({}, {"r": 1})
    assert ours.directory.misplaced(Places({})) == {}
    ours.leave(1)
    assert ours.directory.misplaced(others) == {}  # a part that connects will have it
    assert ours.directory.misplaced(Places({"r": AWAY})) == {"r": None}


@pytest.mark.parametrize(
    ("command", "node", "name"),
    [
        ("/cmd_vel", "linorobot_base_node", "linorobot_base_node"),
        ("/cmd_vel", "/bot 1/base", "bot_1"),
        ("/left/cmd_vel", "base", "left"),
        ("/cmd_vel", "", "robot_0"),
        ("/cmd_vel", "//", "robot_0"),
    ],
)
def test_robot_is_named_by_its_velocity_s_namespace_or_its_node_and_never_by_its_odometry(
    command: str, node: str, name: str
) -> None:
    topics = [to_device(command), from_device("/odom/unfiltered", ODOMETRY)]
    directory = Directory({})
    accepted = directory.claim(1, HOME, topics, now_s=0.0, node=node)
    assert isinstance(accepted, Accepted)
    assert accepted.robot is not None
    assert accepted.robot.name == name
    again = directory.claim(2, AWAY, topics, now_s=0.1, node=node)
    assert isinstance(again, Accepted)
    assert again.robot is not None
    assert again.robot.name != name


def test_robots_that_the_settings_place_at_a_port_precede_those_of_its_address() -> None:
    found = Directory({"car": HOME, "arm": f"{HOME}:40001", "free": None}, {})
    assert found.placed(Origin("", HOME, f"{HOME}:40001")) == ["arm"]
    assert found.placed(Origin("", HOME, f"{HOME}:40002")) == ["car"]
    assert found.placed(Origin("", AWAY, AWAY)) == []
