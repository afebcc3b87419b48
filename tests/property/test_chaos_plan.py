"""Generator of chaos, checked over hundreds of draws."""

import random

import pytest

from hostlink.core.protocol.endpoint import EndpointKind
from tests.support.chaos import frames, requests
from tests.support.chaos.names import CLASHING_NAMES


@pytest.mark.slow
def test_announcements_are_small_and_huge_and_clash_with_each_other() -> None:
    drawn = [frames.draw_announcement(random.Random(seed)) for seed in range(200)]
    assert min(map(len, drawn)) < 5
    assert max(map(len, drawn)) > 3000
    both_ways = 0
    for infos in drawn:
        velocities = {i.name for i in infos if i.kind is EndpointKind.SUBSCRIBER and i.type == "geometry_msgs/Twist"}
        poses = {i.name for i in infos if i.kind is EndpointKind.PUBLISHER and i.type == "geometry_msgs/Pose2D"}
        both_ways += bool(velocities & poses & set(CLASHING_NAMES))
    assert both_ways > 5


def test_only_rivals_lock_or_drive_the_honest_robot() -> None:
    dice = random.Random(1)
    sent = b"".join(requests.draw_operation(dice) for _ in range(2000)) + b"".join(
        requests.draw_http(dice) for _ in range(2000)
    )
    assert b"/honest/lock HTTP" not in sent
    assert b"robots/honest/velocity" not in sent
    assert b'"robot": "honest"' not in sent
