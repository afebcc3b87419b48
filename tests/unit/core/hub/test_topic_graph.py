"""TopicGraph: users of a topic, its type, and its removal."""

import pytest

from hostlink.core.hub.graph_view import graph_topic
from hostlink.core.hub.message import Message
from hostlink.core.hub.topic import DeviceSubscription, Subscriber
from hostlink.core.hub.topic_graph import TopicGraph
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.serialisation import CDR, ROS1
from hostlink.errors import FrameTooLarge, UnknownTopic, WrongType
from tests.support.virtual_loop import run_virtual, virtual

CATALOG = Catalog()
LINK, OTHER_LINK = "link 1", "link 2"
BOOL, STRING = "std_msgs/Bool", "std_msgs/String"


class Program:
    """Keeps what it received, and the errors that ended it."""

    def __init__(self, type_name: str = "") -> None:
        self.received: list[bytes] = []
        self.errors: list[Exception] = []
        self.subscriber = Subscriber(self._receive, self, type_name, self.errors.append)

    def _receive(self, message: Message) -> None:
        self.received.append(message.payload)


def device() -> DeviceSubscription:
    return DeviceSubscription(lambda _: None, is_gate=False)


async def received_later(*, is_latched: bool) -> list[bytes]:
    """Return the messages that a program receives that subscribes after a message."""
    graph, program = TopicGraph(CATALOG), Program()
    topic = graph.advertise("/a", LINK, type_name=BOOL, is_latched=is_latched)
    topic.publish(b"\1", source=LINK)
    graph.subscribe("/a", program.subscriber)
    assert program.errors == []
    return program.received


def test_unknown_topic_is_refused_with_the_known_names() -> None:
    graph = TopicGraph(CATALOG)
    graph.advertise("/led", LINK, type_name=BOOL)
    with pytest.raises(UnknownTopic, match="no topic named /lid; known: /led"):
        graph.find("/lid")


def test_only_what_was_latched_is_delivered_to_a_later_subscriber() -> None:
    assert run_virtual(received_later(is_latched=True)) == [b"\1"]
    assert run_virtual(received_later(is_latched=False)) == []


async def sent_to_later_device(*, is_gate: bool = False, is_command: bool = False) -> list[bytes]:
    """Return the messages to a device that subscribes after two latching publishers, and announces its topics twice."""
    graph, sent = TopicGraph(CATALOG), list[bytes]()
    for source in ("one", "other"):
        graph.advertise("/a", source, type_name=BOOL, is_latched=True)
    topic = graph.find("/a")
    for source, payload in (("one", b"\0"), ("other", b"\1"), ("one", b"\2")):
        topic.publish(payload, source=source)
    subscription = DeviceSubscription(lambda each: sent.append(each.payload), is_gate=is_gate, is_command=is_command)
    graph.subscribe_device("/a", LINK, subscription, type_name=BOOL)
    graph.leave("other")
    graph.send_latched(LINK)
    return sent


def test_latched_messages_later_device_is_sent_those_of_publishers_that_are_there_newest_last() -> None:
    assert run_virtual(sent_to_later_device()) == [b"\1", b"\2", b"\2"]


def test_latched_messages_gate_and_command_topic_are_sent_none() -> None:
    assert run_virtual(sent_to_later_device(is_gate=True)) == []
    assert run_virtual(sent_to_later_device(is_command=True)) == []


def test_latched_message_that_the_device_cannot_take_does_not_keep_it_from_subscribing() -> None:
    async def subscribed() -> list[object]:
        graph = TopicGraph(CATALOG)
        graph.advertise("/a", "one", type_name=BOOL, is_latched=True).publish(b"\1", source="one")

        def refuse(_: Message) -> None:
            raise FrameTooLarge("/a", 600, 512)

        return list(
            graph.subscribe_device("/a", LINK, DeviceSubscription(refuse, is_gate=False), type_name=BOOL).devices
        )

    assert run_virtual(subscribed()) == [LINK]


def test_a_topic_is_not_latched_unless_its_publisher_says_so() -> None:
    assert TopicGraph(CATALOG).advertise("/a", LINK, type_name=BOOL).latched == {}


def test_a_device_that_publishes_a_topic_no_more_still_subscribes_to_it() -> None:
    graph = TopicGraph(CATALOG)
    graph.advertise("/a", LINK, type_name=BOOL)
    topic = graph.subscribe_device("/a", LINK, device(), type_name=BOOL)
    graph.unadvertise("/a", LINK)
    assert (topic.publishers, list(topic.devices)) == (set(), [LINK])
    graph.leave(LINK)
    assert graph.all() == []


def test_a_device_that_subscribes_no_more_still_publishes() -> None:
    graph = TopicGraph(CATALOG)
    topic = graph.advertise("/a", LINK, type_name=BOOL)
    graph.subscribe_device("/a", LINK, device(), type_name=BOOL)
    graph.unsubscribe_device("/a", LINK)
    assert (topic.publishers, topic.devices) == ({LINK}, {})
    graph.leave(LINK)
    assert graph.all() == []


def test_a_topic_is_one_however_its_name_is_written() -> None:
    graph = TopicGraph(CATALOG)
    topic = graph.advertise("a", LINK, type_name=BOOL)
    assert graph.advertise("~a", OTHER_LINK, type_name="") is topic
    assert graph.find("/a") is topic
    assert topic.publishers == {LINK, OTHER_LINK}


def test_topic_is_removed_with_its_last_user() -> None:
    graph, program = TopicGraph(CATALOG), Program()
    place = graph.subscribe("/a", program.subscriber)
    graph.advertise("/a", LINK, type_name=BOOL)
    graph.leave(LINK)
    assert list(graph.names()) == ["/a"]
    graph.unsubscribe(*place)
    graph.unsubscribe(*place)  # once more changes nothing
    with pytest.raises(UnknownTopic, match="/a"):
        graph.find("/a")
    graph.unadvertise("/a", LINK)
    graph.unsubscribe_device("/a", LINK)


def test_a_subscription_that_ended_late_leaves_the_new_topic_of_its_name_alone() -> None:
    graph, program = TopicGraph(CATALOG), Program()
    place = graph.subscribe("/a", program.subscriber)
    graph.unsubscribe(*place)
    topic = graph.advertise("/a", LINK, type_name=BOOL)
    graph.unsubscribe(*place)
    assert graph.find("/a") is topic


def test_a_topic_has_one_type_and_one_that_names_none_accepts_it() -> None:
    graph = TopicGraph(CATALOG)
    graph.subscribe("/a", Program(BOOL).subscriber)
    assert graph.advertise("/a", LINK, type_name="").type_name == BOOL
    with pytest.raises(WrongType, match=STRING):
        graph.subscribe("/a", Program(STRING).subscriber)


# -- types without a definition ---------------------------------------------------------------------------------------

OWN = "my_msgs/Own"  # without a definition


@virtual
async def test_messages_of_a_type_without_a_definition_have_the_encoding_of_their_device() -> None:
    graph, found = TopicGraph(CATALOG), list[tuple[str, bytes]]()
    early = Subscriber(lambda message: found.append((message.encoding, message.payload)), "early", OWN, found.append)
    graph.subscribe("/a", early)
    graph.subscribe_device("/a", OTHER_LINK, device(), type_name=OWN, raw_encoding=CDR)
    topic = graph.advertise("/a", LINK, type_name=OWN, raw_encoding=CDR, is_latched=True)
    topic.publish(b"1", source=LINK)
    topic.deliver(b"2", source=LINK, at_s=0.0)
    graph.subscribe("/a", early._replace(key="late"))
    assert found == [(CDR, b"1"), (CDR, b"2"), (CDR, b"2")]
    seen = graph_topic(topic, "")
    assert seen is not None
    assert seen.encoding == CDR
    graph.leave(LINK)
    graph.leave(OTHER_LINK)
    assert (topic.type_name, topic.encoding) == (OWN, ROS1)


def test_devices_that_serialise_an_unknown_type_in_different_ways_do_not_share_a_topic() -> None:
    graph = TopicGraph(CATALOG)
    graph.advertise("/a", LINK, type_name=OWN, raw_encoding=CDR)
    with pytest.raises(WrongType, match="/a: wanted my_msgs/Own as cdr, got my_msgs/Own as ros1"):
        graph.subscribe_device("/a", OTHER_LINK, device(), type_name=OWN)
    with pytest.raises(WrongType, match="/a: wanted my_msgs/Own, got my_msgs/Other"):
        graph.subscribe_device("/a", OTHER_LINK, device(), type_name="my_msgs/Other", raw_encoding=CDR)


def test_type_with_a_definition_is_that_of_ros_1_from_every_device() -> None:
    graph = TopicGraph(CATALOG)
    topic = graph.advertise("/a", LINK, type_name=BOOL, raw_encoding=CDR)
    graph.subscribe_device("/a", OTHER_LINK, device(), type_name=BOOL)
    assert topic.encoding == ROS1
