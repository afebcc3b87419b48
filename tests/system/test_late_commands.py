"""Load on the API's port while a robot is driven: no velocity is obeyed that is older than its lease."""

from pathlib import Path

import pytest

from tests.support.core_part import can_limit
from tests.support.late_commands import measure

pytestmark = pytest.mark.alone

LEASE_S = 0.5
# The device's end, in this process, waits for a core during the load; without bounds velocities are 4 to 17 s old.
SLACK_S = 0.5
STOP_S = 0.5  # 0.02 s on a quiet machine; 0.5 to 1 s without bounds
MOST_MIB = 250  # docs/reliability.md


@pytest.mark.parametrize(
    ("load", "connections"), [pytest.param("uploads", 200, marks=pytest.mark.long), ("bodies", 60)]
)
async def test_bodies_of_a_megabyte_delay_no_velocity_and_no_stop(tmp_path: Path, load: str, connections: int) -> None:
    outcome = await measure([load], folder=tmp_path, connections=connections, has_stops=True)
    assert len(outcome.ages_s) > 20, outcome
    assert max(outcome.ages_s) < LEASE_S + SLACK_S, outcome
    assert outcome.zero_s < LEASE_S + SLACK_S, outcome
    assert sorted(outcome.stops_s)[len(outcome.stops_s) // 2] < STOP_S, outcome
    assert outcome.most_mib < outcome.before_mib + 64, outcome


@pytest.mark.long
async def test_latched_megabytes_of_sixty_clients_stay_within_the_budget(tmp_path: Path) -> None:
    outcome = await measure(["latched"], folder=tmp_path, connections=60)
    assert outcome.most_mib < MOST_MIB, outcome
    assert max(outcome.ages_s) < LEASE_S + SLACK_S, outcome


@pytest.mark.long
@pytest.mark.skipif(not can_limit(), reason="no control group can be written")
async def test_daemon_with_an_eighth_of_a_core_obeys_no_velocity_older_than_its_lease(tmp_path: Path) -> None:
    outcome = await measure(["metrics", "bodies"], folder=tmp_path, connections=6, part=0.12, drive_s=5.0)
    assert max(outcome.ages_s, default=0.0) < LEASE_S + SLACK_S, outcome
    assert outcome.zero_s < LEASE_S + SLACK_S, outcome
