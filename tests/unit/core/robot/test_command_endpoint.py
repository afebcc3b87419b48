"""CommandEndpoint as the API shows it."""

import pytest

from hostlink.core.robot.command_endpoint import CommandEndpoint, command_endpoint_view


@pytest.mark.parametrize(("reason", "is_sent"), [("", True), ("it has no zero", False)])
def test_view_says_whether_a_zero_was_sent(reason: str, is_sent: bool) -> None:
    endpoint = CommandEndpoint(
        3, "10.0.0.1:5", "rover", "/left", "std_msgs/Int16", is_guarded=False, is_locked=True, reason=reason
    )
    assert command_endpoint_view(endpoint) == {
        "link": 3,
        "peer": "10.0.0.1:5",
        "robot": "rover",
        "topic": "/left",
        "type": "std_msgs/Int16",
        "is_guarded": False,
        "is_locked": True,
        "is_zero_sent": is_sent,
        "reason": reason,
        "host": None,
    }
