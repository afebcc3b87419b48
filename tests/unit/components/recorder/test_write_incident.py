"""Incident files: their content, and the pauses that the writer leaves to the loop."""

from pathlib import Path

import pytest

from hostlink.components.recorder.channel import EVENTS, LOG
from hostlink.components.recorder.folder import Folder
from hostlink.components.recorder.incident import BURST, Incident, write_incident
from hostlink.components.recorder.reader import McapReader
from hostlink.components.recorder.ring import Entry

SECOND_NS = 1_000_000_000
COUNT = 10 * BURST


def test_incident_is_written_in_the_order_of_arrival_with_a_rest_after_each_burst(tmp_path: Path) -> None:
    robot = [Entry(EVENTS, (100 + number) * SECOND_NS, b"{}", 100 + number) for number in range(COUNT // 2)]
    nobody = [Entry(LOG, (100 + number) * SECOND_NS + 1, b"{}", 100 + number) for number in range(COUNT // 2)]
    old = Entry(LOG, 1 * SECOND_NS, b"{}", 1)
    incident = Incident("robot_0", "gone", "its link ended", (100 + COUNT) * SECOND_NS, 100 + COUNT)
    rests: list[None] = []
    path = write_incident(
        Folder(tmp_path, max_disk_mb=100, min_free_disk_mb=0),
        incident,
        [EVENTS, LOG],
        [robot, [old, *nobody]],
        before_s=COUNT,
        rest=lambda: rests.append(None),
    )
    stamps = [message.stamp_ns for message in McapReader(path).messages()]
    assert stamps == sorted(entry.stamp_ns for entry in robot + nobody)
    assert len(rests) == COUNT // BURST + 1  # the last one before the file gets its name


@pytest.mark.parametrize("jump_s", [-100_000, 100_000])
def test_clock_step_does_not_change_an_incident(tmp_path: Path, jump_s: int) -> None:
    stamps_ns = [(1_000_000 + second + (second >= 40) * jump_s) * SECOND_NS for second in range(50)]
    entries = [Entry(EVENTS, stamp_ns, b"{}", second) for second, stamp_ns in enumerate(stamps_ns)]
    path = write_incident(
        Folder(tmp_path, max_disk_mb=100, min_free_disk_mb=0),
        Incident("robot_0", "locked", "", stamps_ns[45], 45.0),
        [EVENTS],
        [entries],
        before_s=20.0,
        rest=lambda: None,
    )
    found = list(McapReader(path).messages())
    assert [message.stamp_ns for message in found] == stamps_ns[25:]
    assert [message.steady_ns - stamps_ns[45] for message in found] == [each * SECOND_NS for each in range(-20, 5)]
