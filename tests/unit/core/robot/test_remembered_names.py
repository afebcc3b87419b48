"""Directory: names of robots that nothing names, over restarts of the daemon."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.robot.model import Endpoint
from hostlink.core.robot.names import MAX_REMEMBERED, PLAYED, Accepted, Directory, Remembered, Undecided

TWIST = "geometry_msgs/Twist"
HERE, THERE, THIRD = "192.168.4.2", "192.168.4.3", "/dev/ttyUSB0"


def board(namespace: str = "") -> list[Endpoint]:
    return [Endpoint(f"{namespace}/cmd_vel".lstrip("/"), TWIST, is_to_device=True)]


class Daemon:
    """A directory that restarts. Devices send all the time, so that two are never one that reconnected."""

    def __init__(self, addresses: dict[str, str | None] | None = None) -> None:
        self.addresses = addresses or {}
        self.directory = Directory(self.addresses)
        self.names: dict[int, str] = {}
        self.now_s = 0.0
        self._link = 0

    def restart(self) -> None:
        before, self.directory = self.directory, Directory(self.addresses)
        self.directory.remember(before.remembered)
        self.names.clear()

    def connect(self, address: str, topics: list[Endpoint], peer: str = "") -> str:
        self._link += 1
        while isinstance(claim := self._claim(address, topics, peer or address), Undecided):
            self.now_s += 0.05
            for link in (*self.names, self._link):
                self.directory.presence(link).note_read(self.now_s)
        assert isinstance(claim, Accepted)
        assert claim.robot is not None
        self.names[self._link] = claim.robot.name
        return claim.robot.name

    def _claim(self, address: str, topics: list[Endpoint], peer: str) -> Accepted | Undecided:
        return self.directory.claim(self._link, address, topics, now_s=self.now_s, peer=peer)

    def leave_all(self) -> None:
        for link in self.names:
            self.directory.leave(link)
        self.names.clear()


def test_unnamed_robots_keep_their_names_in_any_order_after_a_restart() -> None:
    daemon = Daemon()
    assert [daemon.connect(HERE, board()), daemon.connect(THIRD, board())] == ["robot_0", "robot_1"]
    daemon.restart()
    assert [daemon.connect(THERE, board()), daemon.connect(THIRD, board())] == ["robot_2", "robot_1"]
    assert daemon.connect(HERE, board()) == "robot_0"


@pytest.mark.parametrize("address", [HERE, THERE])
def test_board_that_announces_the_name_of_an_unnamed_one_has_another_name_for_good(address: str) -> None:
    daemon = Daemon()
    assert daemon.connect(HERE, board()) == "robot_0"
    assert daemon.connect(address, board("/robot_0")) == "robot_0_2"
    daemon.restart()
    assert daemon.connect(address, board("/robot_0")) == "robot_0_2"
    assert daemon.connect(HERE, board()) == "robot_0"
    daemon.leave_all()
    assert daemon.connect(address, board("/robot_0")) == "robot_0_2"


def test_unnamed_board_never_has_the_name_that_another_announced_before_the_restart() -> None:
    daemon = Daemon()
    assert daemon.connect(HERE, board("/robot_0")) == "robot_0"
    daemon.restart()
    assert daemon.connect(THERE, board()) == "robot_1"
    assert daemon.connect(HERE, board("/robot_0")) == "robot_0"


def test_board_that_announces_robot_0_may_move_to_another_address() -> None:
    daemon = Daemon()
    daemon.connect(HERE, board("/robot_0"))
    daemon.restart()
    assert daemon.connect(THERE, board("/robot_0")) == "robot_0"


def test_two_that_announce_one_name_keep_theirs_over_a_restart() -> None:
    daemon = Daemon()
    assert [daemon.connect(HERE, board("/robot_0")), daemon.connect(THERE, board("/robot_0"))] == [
        "robot_0",
        "robot_0_2",
    ]
    daemon.restart()
    assert [daemon.connect(THERE, board("/robot_0")), daemon.connect(HERE, board("/robot_0"))] == [
        "robot_0_2",
        "robot_0",
    ]


def test_two_unnamed_boards_behind_one_address_have_new_names_after_a_restart() -> None:
    """A program that drives robot_0 must not move the other one, and their addresses do not tell them apart."""
    daemon = Daemon()
    assert [daemon.connect(HERE, board()), daemon.connect(HERE, board())] == ["robot_0", "robot_1"]
    daemon.restart()
    assert [daemon.connect(HERE, board()), daemon.connect(HERE, board())] == ["robot_2", "robot_3"]


def test_name_that_the_settings_give_another_robot_is_forgotten() -> None:
    daemon = Daemon()
    daemon.connect(HERE, board())
    daemon.addresses = {"robot_0": THERE}
    daemon.restart()
    assert daemon.connect(HERE, board()) == "robot_1"
    daemon.addresses = {}
    daemon.restart()
    assert daemon.connect(HERE, board()) == "robot_1"


def test_forgotten_name_of_one_that_announces_it_is_free_for_others_that_announce_it_only() -> None:
    daemon = Daemon()
    daemon.connect(HERE, board("/robot_0"))
    daemon.leave_all()
    daemon.directory.forget("robot_0")
    assert daemon.connect(THERE, board()) == "robot_1"
    assert daemon.connect(THIRD, board("/robot_0")) == "robot_0"


def test_forgotten_number_of_two_that_announce_one_name_is_free() -> None:
    daemon = Daemon()
    assert daemon.connect(HERE, board("/robot_0")) == "robot_0"
    assert daemon.connect(THERE, board("/robot_0")) == "robot_0_2"
    daemon.directory.forget("robot_0_2")
    assert daemon.connect(THIRD, board("/robot_0")) == "robot_0_3"  # the second one is still there
    daemon.directory.leave(2)
    daemon.directory.forget("robot_0_2")
    assert daemon.directory.remembered.keys() == {"robot_0", "robot_0_3"}
    assert daemon.connect("10.0.0.9", board("/robot_0")) == "robot_0_2"


def test_forgotten_unnamed_robot_has_its_name_when_it_is_back() -> None:
    daemon = Daemon()
    daemon.connect(HERE, board())
    daemon.leave_all()
    daemon.directory.forget("robot_0")
    assert daemon.connect(THERE, board("/robot_0")) == "robot_0_2"
    assert daemon.connect(HERE, board()) == "robot_0"


def test_remembered_names_are_bounded_and_recordings_are_not_remembered() -> None:
    many = {f"robot_{number}": Remembered("robot_0", f"10.0.0.{number}", True) for number in range(MAX_REMEMBERED + 9)}
    directory = Directory({})
    directory.remember({**many, "../../etc": Remembered("robot_0", HERE, True)})
    assert len(directory.remembered) == MAX_REMEMBERED
    assert "robot_0" not in directory.remembered
    assert PLAYED not in {each.address for each in directory.remembered.values()}


boards = st.lists(
    st.tuples(st.sampled_from([HERE, THERE, THIRD, "10.0.0.9"]), st.sampled_from(["", "/robot_0", "/robot_1", "/car"])),
    min_size=1,
    max_size=6,
    unique=True,
)


@given(boards, st.data())
def test_name_is_never_that_of_another_board_than_before(
    all_boards: list[tuple[str, str]], data: st.DataObject
) -> None:
    """Boards that differ in their address or in what they announce: each name stays its board's over restarts."""
    daemon, owners = Daemon(), dict[str, tuple[str, str]]()
    for _ in range(data.draw(st.integers(2, 4))):
        present = data.draw(st.permutations(all_boards))[: data.draw(st.integers(1, len(all_boards)))]
        for address, namespace in present:
            name = daemon.connect(address, board(namespace))
            before = owners.setdefault(name, (address, namespace))
            if not name.startswith("robot") or not before[1] or not namespace:
                assert before[1] == namespace, name
            if not namespace:
                assert before == (address, namespace)
            owners[name] = (address, namespace)
        daemon.restart() if data.draw(st.booleans()) else daemon.leave_all()


@given(st.lists(st.lists(st.integers(0, 3), unique=True, min_size=1), min_size=2, max_size=5))
def test_unnamed_boards_behind_one_address_never_exchange_names_by_a_restart(runs: list[list[int]]) -> None:
    """Once two of them were there at once, no name of before is given again."""
    daemon, had, were_several = Daemon(), set[str](), False
    for run in runs:
        names = {daemon.connect(HERE, board(), f"{HERE}:{40000 + number}") for number in run}
        if were_several:
            assert not names & had
        had |= names
        were_several |= len(run) > 1
        daemon.restart()
