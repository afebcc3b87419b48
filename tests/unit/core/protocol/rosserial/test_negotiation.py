"""Topic requests to a silent device. They come earlier if the device requested the time regularly."""

import itertools

import pytest

from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.protocol.rosserial.negotiation import (
    ANSWER_WAY_S,
    CONFIRM_S,
    LONGEST_CALL_S,
    TRANSITIONS,
    NegotiationScheduler,
    NegotiationStep,
    SessionState,
)
from hostlink.core.protocol.rosserial.topic_table import MAX_MISSED
from tests.support.session_host import LED, ODOMETRY, TEXT, TIME, Host, wire


def regular_device() -> Host:
    host = Host(ODOMETRY, LED)
    host.receive(TIME, after_s=2.5)
    assert host.session.negotiation.is_regular
    return host


@pytest.mark.parametrize("period_s", [1.0, 2.5, 3.9])
def test_time_requests_at_their_period_are_regular(period_s: float) -> None:
    host = Host(ODOMETRY)
    assert not host.session.negotiation.is_regular  # two at once are part of a negotiation
    host.receive(TIME, after_s=period_s)
    assert host.session.negotiation.is_regular


@pytest.mark.parametrize("period_s", [0.01, 0.9, 4.1, 60.0])
def test_time_requests_at_another_period_are_not_regular(period_s: float) -> None:
    host = Host(ODOMETRY)
    for _ in range(5):
        host.receive(TIME, after_s=period_s)
    assert not host.session.negotiation.is_regular


def test_silent_regular_device_receives_a_request_before_its_link_ends() -> None:
    """The device may have restarted behind a radio that keeps the connection open.

    Then it waits for a topic request.
    """
    host = regular_device()
    host.wait(3.4)
    assert host.requests() == []
    host.wait(0.2)
    assert host.requests() == ["no_time_requests"]
    host.receive(TIME + wire(ODOMETRY, LED) + TIME)
    host.wait(3.4)
    assert host.requests() == []


def test_talking_device_has_five_seconds_for_its_next_time_request() -> None:
    host = regular_device()
    for _ in range(49):
        host.wait(0.09)
        host.receive(wire())
        assert host.requests() == []
    host.wait(0.6)
    assert host.requests() == ["no_time_requests"]


def test_device_that_never_requests_the_time_receives_a_request_after_five_seconds() -> None:
    host = Host(ODOMETRY)
    host.wait(4.9)
    assert host.requests() == []
    host.wait(0.2)
    assert host.requests() == ["no_time_requests"]


def advance(scheduler: NegotiationScheduler, step: NegotiationStep, now_s: float) -> None:
    if step is NegotiationStep.REQUESTED:
        scheduler.request("test")
        assert scheduler.pop_request(now_s) == "test"
    elif step is NegotiationStep.TOPIC_INFO:
        scheduler.topic_info_received(now_s)
    else:
        scheduler.finish(None)


def test_session_follows_the_transition_table() -> None:
    """Check every path of four steps from the start."""
    paths = 0
    for steps in itertools.product(NegotiationStep, repeat=4):
        scheduler, state = NegotiationScheduler(), SessionState.REQUESTING
        for number, step in enumerate(steps):
            if step not in TRANSITIONS[state]:
                break
            advance(scheduler, step, number * 10.0)
            state = TRANSITIONS[state][step]
            assert scheduler.state is state
        else:
            paths += 1
    assert paths == 16  # two steps are possible in each state


def test_request_during_a_negotiation_is_satisfied_by_it() -> None:
    host = Host(ODOMETRY)
    host.wait(2.0)
    host.receive(wire(ODOMETRY))
    host.session.probe()
    assert host.wait(0.45) == []
    host.wait(1.0)
    assert host.requests() == []


def test_probe_waits_for_no_request_but_the_last_probe() -> None:
    host = Host(ODOMETRY)
    host.session.probe()
    assert host.session.tick(now_s=host.now_s) == [events.TopicsRequested("probe")]
    host.session.probe()
    assert host.session.tick(now_s=host.now_s) == []  # the device has not answered yet
    host.receive(wire(ODOMETRY) + TIME, after_s=0.1)
    host.session.probe()
    assert host.wait(0.8) == []
    host.wait(0.2)
    assert host.requests() == ["probe"]


def test_unknown_id_causes_no_request_after_the_negotiation() -> None:
    host = Host(ODOMETRY)
    host.receive(encode(140, b"?"))  # the last request is less than one second old
    host.receive(wire(ODOMETRY) + TIME)
    host.wait(1.5)
    assert host.requests() == []


def test_topics_that_are_missing_are_requested_again() -> None:
    scheduler = NegotiationScheduler()
    scheduler.topic_info_received(1.0)
    scheduler.finish(None, is_short=True)
    assert scheduler.pop_request(now_s=10.0) == "missing"


def requests_while_it_publishes(host: Host, seconds: float) -> list[str]:
    """Return the requests to a device that also requests the time, so that its silence is not a cause."""
    found = []
    for tenth in range(round(seconds * 10)):
        host.receive(TIME if tenth % 25 == 24 else encode(125, bytes(24)), after_s=0.0)
        found += host.requests()
        host.wait(0.1)
        found += host.requests()
    return found


def test_topics_over_a_lossy_transport_are_requested_once_more() -> None:
    """A lost last TopicInfo leaves no gap."""
    host = Host(ODOMETRY, is_lossy=True)
    assert requests_while_it_publishes(host, CONFIRM_S - 0.2) == []
    assert requests_while_it_publishes(host, 0.4) == ["unconfirmed"]
    host.receive(TIME + wire(ODOMETRY, LED) + TIME)
    assert host.session.topics == (LED, ODOMETRY)
    assert requests_while_it_publishes(host, CONFIRM_S + 0.2) == ["unconfirmed"]
    host.receive(TIME + wire(ODOMETRY, LED) + TIME)
    assert requests_while_it_publishes(host, 10.0) == []


def test_loss_in_a_confirming_answer_causes_a_request() -> None:
    host = Host(ODOMETRY, LED, is_lossy=True)
    host.receive(wire(LED) + TIME)
    assert requests_while_it_publishes(host, 1.5) == ["missing"]
    assert host.session.topics == (LED, ODOMETRY)


def test_request_for_another_cause_confirms_the_topics() -> None:
    host = Host(ODOMETRY, LED, is_lossy=True)
    host.session.probe()
    assert requests_while_it_publishes(host, 1.5) == ["probe"]
    host.receive(TIME + wire(ODOMETRY, LED) + TIME)
    assert requests_while_it_publishes(host, 10.0) == []


def test_continued_announcement_does_not_confirm_itself() -> None:
    host = Host(ODOMETRY, is_lossy=True)
    host.receive(wire(LED._replace(md5="wrong")) + TIME)  # an unusable topic, so the usable topics do not change
    assert requests_while_it_publishes(host, CONFIRM_S + 0.2) == ["unconfirmed"]


ASK = DeviceEndpoint(EndpointKind.SERVICE_CLIENT_PUBLISHER, 126, "/ask", "my_srvs/Mine", "m", 512)
ANSWER = DeviceEndpoint(EndpointKind.SERVICE_CLIENT_SUBSCRIBER, 101, "/ask", "my_srvs/Mine", "m", 512)


def test_no_confirmation_is_requested_while_a_device_waits_for_a_service() -> None:
    """A request would end ros_lib's call. The response would then be written to freed stack memory."""
    host = Host(ODOMETRY, ASK, LED, ANSWER, is_lossy=True)
    host.receive(encode(ASK.id, b""), after_s=CONFIRM_S - 0.2)
    assert requests_while_it_publishes(host, 1.0) == []
    host.session.respond(ANSWER, b"1")
    assert [frame.topic_id for frame in host.sent()][-1] == ANSWER.id
    assert requests_while_it_publishes(host, ANSWER_WAY_S - 0.1) == []
    assert requests_while_it_publishes(host, 0.2) == ["unconfirmed"]


def test_unanswered_call_delays_the_confirmation_by_its_deadline() -> None:
    host = Host(ODOMETRY, ASK, LED, ANSWER, is_lossy=True)
    host.receive(encode(ASK.id, b""), after_s=1.0)
    assert requests_while_it_publishes(host, LONGEST_CALL_S - 0.1) == []
    assert requests_while_it_publishes(host, 0.2) == ["unconfirmed"]


def test_missing_topic_is_requested_despite_a_permanent_gap() -> None:
    """A device that does not number its topics from 100 has a permanent gap."""
    far = TEXT._replace(id=105)
    host = Host(ODOMETRY, LED, far)
    for _ in range(5):
        host.receive(TIME + wire(ODOMETRY, LED, far) + TIME, after_s=1.1)
    host.wait(1.5)
    assert host.requests() == []
    found = []
    for _ in range(MAX_MISSED):
        assert LED in host.session.topics
        host.receive(TIME + wire(ODOMETRY, far) + TIME, after_s=1.1)
        found += host.requests()
    assert found == ["missing"] * (MAX_MISSED - 1) + ["gap"]
    assert LED not in host.session.topics


def test_topics_on_a_serial_line_need_no_confirmation() -> None:
    assert requests_while_it_publishes(Host(ODOMETRY, LED), 10.0) == []
