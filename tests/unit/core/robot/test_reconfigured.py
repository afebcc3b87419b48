"""Names and limits that change while robots are there."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.robot.model import Endpoint
from hostlink.core.robot.names import Accepted, Directory, Places
from hostlink.core.robot.velocity import ZERO, PlanarVelocity
from hostlink.core.robot.velocity_gate import Limits
from tests.support.gates import GateOfRobot

PLACES = tuple(f"10.0.0.{number}" for number in range(1, 6))
TOPICS: list[Endpoint] = [
    Endpoint("/robot_0/cmd_vel", "geometry_msgs/Twist", is_to_device=True),
    Endpoint("/robot_0/odometry", "geometry_msgs/Pose2D", is_to_device=False),
]
configurations = st.dictionaries(
    st.sampled_from(["left", "right", "rover", "robot_0", "robot_0_2"]), st.sampled_from(PLACES)
).filter(lambda addresses: len(set(addresses.values())) == len(addresses))


def claim(directory: Directory, link: int) -> str:
    """The name of the robot whose device is at the place of this number."""
    accepted = directory.claim(link, PLACES[link], TOPICS, now_s=0.0, peer=f"{PLACES[link]}:1")
    assert isinstance(accepted, Accepted)
    return accepted.robot.name


def test_configuration_of_unknown_robots_changes_nothing() -> None:
    directory = Directory({})
    claim(directory, 0)
    assert directory.misplaced(Places({"rover": PLACES[3]})) == {}


def test_the_name_of_a_robot_that_is_away_is_free_too() -> None:
    directory = Directory({})
    name = claim(directory, 0)
    directory.leave(0)
    assert directory.misplaced(Places({"rover": PLACES[0]})) == {name: None}
    directory.reconfigure(Places({"rover": PLACES[0]}), {})
    assert claim(directory, 0) == "rover"


@given(before=configurations, after=configurations, count=st.integers(1, len(PLACES)))
def test_every_robot_has_the_name_that_the_new_configuration_gives_to_its_place(
    before: dict[str, str], after: dict[str, str], count: int
) -> None:
    """And who has none keeps the one that he has, unless it is another's."""
    directory = Directory(before)
    old = {link: claim(directory, link) for link in range(count)}
    misplaced = directory.misplaced(Places(after))
    directory.reconfigure(Places(after), {})
    new = {link: claim(directory, link) for link in range(count)}
    at = {place: name for name, place in after.items()}
    for link, name in new.items():
        if PLACES[link] in at:
            assert name == at[PLACES[link]]
        elif old[link] not in after:
            assert name == old[link]
        assert (name != old[link]) == (old[link] in misplaced)
    assert len(set(new.values())) == count
    assert directory.misplaced(Places(after)) == {}


@given(configurations)
def test_the_same_configuration_again_changes_nothing(addresses: dict[str, str]) -> None:
    directory = Directory(addresses)
    names = {link: claim(directory, link) for link in range(len(PLACES))}
    assert directory.misplaced(Places(addresses)) == {}
    directory.reconfigure(Places(addresses), {})
    assert {link: claim(directory, link) for link in range(len(PLACES))} == names


# -- limits -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("limits", "speeds"),
    [
        (Limits(max_linear_m_s=0.1), [0.1, 0.1]),
        (Limits(max_linear_m_s=0.1, max_linear_deceleration_m_s2=2.0), [0.3, 0.1]),
        (Limits(max_linear_m_s=1.0), [0.5, 0.5]),
    ],
    ids=["at once", "as it may brake", "none of it"],
)
def test_other_limits_change_how_a_robot_is_driven_not_who_drives(limits: Limits, speeds: list[float]) -> None:
    gate = GateOfRobot(Limits())
    gate.drive("ann", PlanarVelocity(x_m_s=0.5), priority=50, now_s=0.0)
    assert gate.step(0.0) == PlanarVelocity(x_m_s=0.5)
    gate.change_limits(limits)
    steps = [gate.step(0.1), gate.step(0.2)]
    assert [step.x_m_s for step in steps if step is not None] == pytest.approx(speeds)
    assert gate.owner == "ann"


def test_a_robot_that_stands_is_not_moved_by_other_limits() -> None:
    gate = GateOfRobot(Limits(max_linear_m_s=0.1))
    gate.change_limits(Limits())
    assert (gate.step(0.0), gate.current) == (None, ZERO)
