"""Shares of the descriptors of the process."""

import pytest

from hostlink.cli.check import NODE_SHARES, OWN, fitted
from hostlink.components.gateway.settings import ApiConfig
from hostlink.components.ros1.settings import Ros1Config
from hostlink.core.config import Config

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
    assert found.tcp.max_connections + programs + NODE_SHARES * nodes <= descriptors - OWN
    assert min(found.tcp.max_connections, programs, nodes) > 0
