"""Shares of the descriptors of the process."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.cli.descriptors import OWN, Claim, fitted, shares
from hostlink.components.gateway.settings import ApiConfig
from hostlink.components.ros1.node import DESCRIPTORS
from hostlink.components.ros1.settings import Ros1Config
from hostlink.core.config import Config
from hostlink.core.host import Connections
from hostlink.errors import ConfigError

ROS1 = Config().with_tables(ros1=Ros1Config(master="http://localhost:11311"))


def test_without_a_graph_nothing_is_kept_for_one() -> None:
    assert fitted(Config(), 1024) == Config()


def test_enough_for_all_changes_nothing() -> None:
    assert fitted(ROS1, 4096) == ROS1


@pytest.mark.parametrize("descriptors", [200, 512, 1024, 1500])
def test_devices_programs_and_nodes_have_together_what_there_is(descriptors: int) -> None:
    found = fitted(ROS1, descriptors)
    programs = found.table("api", ApiConfig).max_connections
    nodes = found.table("ros1", Ros1Config).max_connections
    assert found.tcp.max_connections + programs + DESCRIPTORS * nodes <= descriptors - OWN
    assert min(found.tcp.max_connections, programs, nodes) > 0


CLAIMS = st.builds(
    Claim, st.integers(1, 2000), st.builds(Connections, least=st.integers(1, 20), descriptors=st.integers(1, 4))
)


@given(st.dictionaries(st.sampled_from("abcdef"), CLAIMS, min_size=1), st.integers(0, 5000))
def test_each_part_has_its_least_and_more_in_proportion(claims: dict[str, Claim], more: int) -> None:
    room = sum(claim.least for claim in claims.values()) + more
    found = shares(claims, room)
    assert sum(found[name] * claim.sharing.descriptors for name, claim in claims.items()) <= room
    for name, claim in claims.items():
        assert min(claim.most, claim.sharing.least) <= found[name] <= claim.most
    if sum(claim.descriptors for claim in claims.values()) <= room:
        assert found == {name: claim.most for name, claim in claims.items()}


def test_parts_that_need_more_than_there_is_are_refused_with_what_they_need(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hostlink.components.ros1.node.Ros1.connections", {"ros1": Connections(200, DESCRIPTORS)})
    with pytest.raises(
        ConfigError, match="ulimit -n: 512 descriptors are too few; allow at least 683; \\[ros1\\] alone needs 600"
    ):
        fitted(ROS1, 512)
    assert fitted(ROS1, 683).table("ros1", Ros1Config).max_connections == 200
