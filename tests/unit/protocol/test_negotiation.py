"""A device that falls silent is asked for its topics: soon, if it has shown that it asks for the time regularly."""

import itertools

import pytest

from hostlink.protocol.control import TopicInfo
from hostlink.protocol.frame import Id, encode
from hostlink.protocol.negotiation import (
    ANSWER_WAY_S,
    CONFIRM_S,
    LONGEST_CALL_S,
    TRANSITIONS,
    NegotiationScheduler,
    SessionState,
    Step,
)
from hostlink.protocol.topic_table import MAX_MISSED
from tests.support.session_host import LED, ODOMETRY, TEXT, TIME, Host, wire


def regular_device() -> Host:
    host = Host(ODOMETRY, LED)
    host.receive(TIME, after_s=2.5)
    assert host.session.is_requesting_time
    return host


@pytest.mark.parametrize("period_s", [1.0, 2.5, 3.9])
def test_time_requests_at_their_period_are_regular(period_s: float) -> None:
    host = Host(ODOMETRY)
    assert not host.session.is_requesting_time  # two at once are part of a negotiation
    host.receive(TIME, after_s=period_s)
    assert host.session.is_requesting_time


@pytest.mark.parametrize("period_s", [0.01, 0.9, 4.1, 60.0])
def test_time_requests_at_any_other_period_are_not(period_s: float) -> None:
    host = Host(ODOMETRY)
    for _ in range(5):
        host.receive(TIME, after_s=period_s)
    assert not host.session.is_requesting_time


def test_a_silent_regular_device_receives_a_request_before_its_link_ends() -> None:
    """It may have restarted behind a radio that keeps the connection: then it waits for exactly this."""
    host = regular_device()
    host.wait(3.4)
    assert host.requests() == []
    host.wait(0.2)
    assert host.requests() == ["no_time_requests"]
    host.receive(TIME + wire(ODOMETRY, LED) + TIME)
    host.wait(3.4)
    assert host.requests() == []


def test_a_device_that_goes_on_talking_has_five_seconds_for_its_next_time_request() -> None:
    host = regular_device()
    for _ in range(49):
        host.wait(0.09)
        host.receive(wire())
        assert host.requests() == []
    host.wait(0.6)
    assert host.requests() == ["no_time_requests"]


def test_a_device_that_never_requests_the_time_receives_a_request_after_five_seconds() -> None:
    host = Host(ODOMETRY)
    host.wait(4.9)
    assert host.requests() == []
    host.wait(0.2)
    assert host.requests() == ["no_time_requests"]


def advance(scheduler: NegotiationScheduler, step: Step, now_s: float) -> None:
    if step is Step.REQUESTED:
        scheduler.request("test")
        assert scheduler.pop_request(now_s) == "test"
    elif step is Step.TOPIC_INFO:
        scheduler.topic_info_received(now_s)
    else:
        scheduler.finish(None)


def test_the_transition_table_is_what_happens() -> None:
    """Every path of four steps that the table allows, from the start."""
    paths = 0
    for steps in itertools.product(Step, repeat=4):
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


def test_no_request_leaves_while_the_device_answers_and_the_answer_grants_it() -> None:
    host = Host(ODOMETRY)
    host.wait(2.0)
    host.receive(wire(ODOMETRY))
    host.session.request_topics("claimed_twice")
    assert host.wait(0.45) == []
    host.wait(1.0)
    assert host.requests() == []


def test_an_unknown_id_is_no_reason_once_the_topics_came() -> None:
    host = Host(ODOMETRY)
    host.receive(encode(140, b"?"))  # the last request is too young
    host.receive(wire(ODOMETRY) + TIME)
    host.wait(1.5)
    assert host.requests() == []


def test_topics_that_are_missing_are_requested_again() -> None:
    scheduler = NegotiationScheduler()
    scheduler.topic_info_received(1.0)
    scheduler.finish(None, is_short=True)
    assert scheduler.pop_request(now_s=10.0) == "missing"


def requests_while_it_publishes(host: Host, seconds: float) -> list[str]:
    """Of a device that requests the time, too, so that its silence is no cause."""
    found = []
    for tenth in range(round(seconds * 10)):
        host.receive(TIME if tenth % 25 == 24 else encode(125, bytes(24)), after_s=0.0)
        found += host.requests()
        host.wait(0.1)
        found += host.requests()
    return found


def test_topics_that_came_where_frames_are_lost_whole_are_requested_once_more() -> None:
    """The last of a row leaves no gap."""
    host = Host(ODOMETRY, is_lossy=True)
    assert requests_while_it_publishes(host, CONFIRM_S - 0.2) == []
    assert requests_while_it_publishes(host, 0.4) == ["unconfirmed"]
    host.receive(TIME + wire(ODOMETRY, LED) + TIME)
    assert host.session.topics == (LED, ODOMETRY)
    assert requests_while_it_publishes(host, CONFIRM_S + 0.2) == ["unconfirmed"]
    host.receive(TIME + wire(ODOMETRY, LED) + TIME)
    assert requests_while_it_publishes(host, 10.0) == []


def test_what_is_lost_of_an_answer_that_confirms_is_requested_as_ever() -> None:
    host = Host(ODOMETRY, LED, is_lossy=True)
    host.receive(wire(LED) + TIME)
    assert requests_while_it_publishes(host, 1.5) == ["missing"]
    assert host.session.topics == (LED, ODOMETRY)


def test_a_request_for_another_cause_confirms_the_topics() -> None:
    host = Host(ODOMETRY, LED, is_lossy=True)
    host.session.request_topics("claimed_twice")
    assert requests_while_it_publishes(host, 1.5) == ["claimed_twice"]
    host.receive(TIME + wire(ODOMETRY, LED) + TIME)
    assert requests_while_it_publishes(host, 10.0) == []


def test_what_goes_on_with_an_announcement_does_not_confirm_it() -> None:
    host = Host(ODOMETRY, is_lossy=True)
    host.receive(wire(LED._replace(md5="wrong")) + TIME)  # nothing that can be used, so the topics are the same
    assert requests_while_it_publishes(host, CONFIRM_S + 0.2) == ["unconfirmed"]


ASK = TopicInfo(Id.SERVICE_CLIENT_PUBLISHER, 126, "/ask", "my_srvs/Mine", "m", 512)
ANSWER = TopicInfo(Id.SERVICE_CLIENT_SUBSCRIBER, 101, "/ask", "my_srvs/Mine", "m", 512)


def test_nothing_is_confirmed_while_a_device_waits_for_a_service() -> None:
    """A request would end ros_lib's call; the response would then be written where its variable was."""
    host = Host(ODOMETRY, ASK, LED, ANSWER, is_lossy=True)
    host.receive(encode(ASK.topic_id, b""), after_s=CONFIRM_S - 0.2)
    assert requests_while_it_publishes(host, 1.0) == []
    host.session.respond(ANSWER, b"1")
    assert [frame.topic_id for frame in host.sent()][-1] == ANSWER.topic_id
    assert requests_while_it_publishes(host, ANSWER_WAY_S - 0.1) == []
    assert requests_while_it_publishes(host, 0.2) == ["unconfirmed"]


def test_a_call_that_is_never_answered_delays_the_confirmation_no_longer_than_an_answer_may_take() -> None:
    host = Host(ODOMETRY, ASK, LED, ANSWER, is_lossy=True)
    host.receive(encode(ASK.topic_id, b""), after_s=1.0)
    assert requests_while_it_publishes(host, LONGEST_CALL_S - 0.1) == []
    assert requests_while_it_publishes(host, 0.2) == ["unconfirmed"]


def test_what_is_missing_is_requested_also_where_a_gap_never_closes() -> None:
    """A device that numbers its topics otherwise has one for ever."""
    far = TEXT._replace(topic_id=105)
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


def test_topics_on_a_line_need_no_confirmation() -> None:
    assert requests_while_it_publishes(Host(ODOMETRY, LED), 10.0) == []
