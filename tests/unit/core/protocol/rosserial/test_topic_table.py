"""TopicTable: lookup by id and name, and the bound on topics."""

from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.session import Session
from hostlink.core.protocol.rosserial.topic_table import MAX_MISSED, MAX_TOPICS, TopicTable
from tests.support.session_host import LED, ODOMETRY, TIME, Host, check, wire


def info(topic_id: int, name: str, kind: EndpointKind = EndpointKind.PUBLISHER) -> DeviceEndpoint:
    return DeviceEndpoint(kind, topic_id, name, "std_msgs/Bool", "m", 64)


def table(*infos: DeviceEndpoint) -> TopicTable:
    made = TopicTable()
    made.begin()
    for each in infos:
        made.add(each, None)
    return made


def test_name_is_found_during_and_after_a_negotiation() -> None:
    made = table(info(125, "/a"), info(100, "/a", EndpointKind.SUBSCRIBER))
    for _ in range(2):
        assert made.by_name.get(("/a", EndpointKind.PUBLISHER)) == info(125, "/a")
        assert made.by_name.get(("/a", EndpointKind.SUBSCRIBER)) == info(100, "/a", EndpointKind.SUBSCRIBER)
        assert made.by_name.get(("/b", EndpointKind.PUBLISHER)) is None
        made.finish()


def test_duplicate_name_belongs_to_the_first_endpoint() -> None:
    made = table(info(125, "/a"), info(126, "/a"))
    for _ in range(2):
        assert made.by_name.get(("/a", EndpointKind.PUBLISHER)) == info(125, "/a")
        made.finish()


def test_name_with_a_changed_id_is_found_under_the_new_id() -> None:
    made = table(info(125, "/a"))
    made.finish()
    made.begin()
    made.add(info(126, "/a"), None)
    assert made.by_name.get(("/a", EndpointKind.PUBLISHER)) == info(126, "/a")
    made.finish()
    assert made.by_name.get(("/a", EndpointKind.PUBLISHER)) == info(126, "/a")


def test_id_with_a_changed_name_is_not_found_under_the_old_name() -> None:
    made = table(info(125, "/a"))
    made.add(info(125, "/b"), None)
    assert made.by_name.get(("/a", EndpointKind.PUBLISHER)) is None
    assert made.by_name.get(("/b", EndpointKind.PUBLISHER)) == info(125, "/b")


def many(count: int) -> bytes:
    return wire(*(info(125 + number, f"/t{number}") for number in range(count)))


def test_topics_over_the_bound_are_counted_and_are_one_event() -> None:
    host = Host()
    found = host.receive(TIME + many(MAX_TOPICS + 50) + TIME)
    assert len(host.session.topics) == MAX_TOPICS
    assert host.session.counts.excess_topics == 50
    refused = [event for event in found if isinstance(event, events.TopicRefused)]
    assert [str(event.reason) for event in refused] == [
        f"/t{MAX_TOPICS}: the device has more than {MAX_TOPICS} topics ([link] max_topics)"
    ]


def test_topic_that_is_announced_again_is_not_over_the_bound() -> None:
    host = Host()
    host.receive(TIME + many(MAX_TOPICS) + many(MAX_TOPICS) + TIME)
    host.receive(many(MAX_TOPICS) + TIME)
    assert host.session.counts.excess_topics == 0


def test_kept_topics_do_not_exceed_the_bound() -> None:
    host = Host()
    for number in range(5):
        first = 125 + number * MAX_TOPICS
        infos = (info(topic_id, f"/t{topic_id}") for topic_id in range(first, first + MAX_TOPICS))
        host.receive(TIME + wire(*infos) + TIME, after_s=1.0)
        assert [each.id for each in host.session.topics] == list(range(first, first + MAX_TOPICS))


def test_bound_is_a_setting() -> None:
    session = Session(check=check, max_topics=1)
    session.open(now_s=0.0)
    session.receive(TIME + wire(LED, ODOMETRY) + TIME, now_s=0.1)
    assert session.topics == (LED,)


def test_probe_repeats_the_negotiation_of_a_ready_device() -> None:
    host = Host(LED)
    host.wait(2.0)
    host.session.probe()
    assert host.session.deadline_s() <= host.now_s
    assert host.session.tick(now_s=host.now_s) == [events.TopicsRequested("probe")]


def test_removed_endpoint_has_no_fixed_size_any_longer() -> None:
    """Otherwise frames of a later topic with this id would be rejected by the size of the removed one."""
    made = TopicTable()
    made.begin()
    made.add(info(125, "/a"), 1)
    made.add(info(126, "/b"), 8)
    made.finish()
    for missed in range(1, MAX_MISSED + 1):
        made.begin()
        made.add(info(125, "/a"), 1)
        made.finish()
        is_kept = missed < MAX_MISSED
        assert made.fixed_bytes == ({125: 1, 126: 8} if is_kept else {125: 1})
        assert made.missing == ((126,) if is_kept else ())


def test_refused_endpoint_is_not_kept() -> None:
    made = TopicTable()
    made.begin()
    made.add(info(125, "/a"), 1)
    made.add(info(126, "/b"), 8)
    made.finish()
    made.begin()
    made.add(info(125, "/a"), 1)
    made.finish(refused=(126,))
    assert made.fixed_bytes == {125: 1}
    assert made.by_name.get(("/b", EndpointKind.PUBLISHER)) is None
