"""Readings of real captures: healthy devices have no flaw, no leap and no doubtful pose."""

import json
from pathlib import Path

import pytest

from hostlink.core.protocol.events import MessageReceived
from hostlink.core.protocol.rosserial.session import Session
from hostlink.core.robot.feedback import RECOGNISED, Feedback, FeedbackKind
from hostlink.core.robot.kinematics import PLANAR
from hostlink.core.robot.odometry import OdometryEstimator

CAPTURES = Path(__file__).parents[3] / "captures"


@pytest.mark.parametrize("name", ["robot", "robot_serial", "reconnect", "services"])
def test_odometry_of_a_capture_has_no_flaw(name: str) -> None:
    sessions: dict[int, tuple[Session, OdometryEstimator]] = {}
    count = 0
    for line in (CAPTURES / f"{name}.jsonl").read_text().splitlines():
        read = json.loads(line)
        if read["dir"] != "device" or not read["hex"]:
            continue
        if read["conn"] not in sessions:
            sessions[read["conn"]] = Session(check=lambda _: None), OdometryEstimator()
            sessions[read["conn"]][0].open(now_s=read["t"])
        session, estimator = sessions[read["conn"]]
        for event in session.receive(bytes.fromhex(read["hex"]), now_s=read["t"]):
            if not isinstance(event, MessageReceived):
                continue
            feedback = Feedback([(event.topic.name, event.topic.type)], RECOGNISED, PLANAR)
            if feedback.kind is not FeedbackKind.POSE:
                assert feedback.kind is FeedbackKind.NONE
                continue
            reading = feedback.read(event.topic.name, event.payload, now_s=read["t"])
            assert reading is not None
            assert (reading.flaws, reading.pose is None) == ((), False)
            estimator.update(reading.pose, now_s=read["t"], wall_ns=0, twist=reading.twist)
            count += 1
    assert count > 200
    for _, estimator in sessions.values():
        assert estimator.ignored == 0
        assert estimator.restarts <= 1  # in one of them the host reset the odometry
