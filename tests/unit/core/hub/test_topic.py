"""Topic: its subscribers, devices, latched messages, and the order of deliveries."""

from collections.abc import Callable

from hostlink.core.hub.message import Message
from hostlink.core.hub.node import Node
from hostlink.core.hub.topic import (
    DEVICE_RANK,
    PROGRAM_RANK,
    Deliveries,
    DeviceSubscription,
    Subscriber,
    Topic,
    rank_of,
)
from hostlink.errors import DeviceGone
from tests.support.virtual_loop import virtual


def subscriber(type_name: str = "") -> Subscriber:
    return Subscriber(lambda _: None, "test", type_name, lambda _: None)


def test_subscriber_that_is_removed_twice_keeps_the_type_of_others() -> None:
    topic = Topic("/chat")
    number = topic.add_subscriber(subscriber("std_msgs/String"))
    topic.add_subscriber(subscriber("std_msgs/String"))
    topic.remove_subscriber(number)
    topic.remove_subscriber(number)
    assert (topic.expected_type, len(topic.subscribers)) == ("std_msgs/String", 1)


def test_a_subscriber_that_expects_no_type_leaves_those_that_do() -> None:
    topic = Topic("/chat")
    untyped = topic.add_subscriber(subscriber())
    typed = topic.add_subscriber(subscriber("std_msgs/String"))
    topic.remove_subscriber(untyped)
    assert topic.expected_type == "std_msgs/String"
    topic.remove_subscriber(typed)
    topic.remove_subscriber(typed)
    assert (topic.expected_type, topic.is_used) == ("", False)


def test_the_type_is_expected_until_the_last_who_expects_it_has_left() -> None:
    topic = Topic("/chat")
    numbers = [topic.add_subscriber(subscriber(name)) for name in ("std_msgs/Bool", "std_msgs/String", "std_msgs/Bool")]
    topic.remove_subscriber(numbers[0])
    assert topic.expected_type == "std_msgs/Bool"
    topic.remove_subscriber(numbers[2])
    assert topic.expected_type == "std_msgs/String"


def receiver(receive: Callable[[Message], None], failed: list[Exception]) -> Subscriber:
    return Subscriber(receive, "test", "", failed.append)


@virtual
async def test_message_reaches_devices_and_subscribers_but_not_its_source() -> None:
    topic, heard = Topic("/t"), list[str]()
    topic.add_device("link 1", DeviceSubscription(lambda _: heard.append("link 1"), is_gate=False))
    topic.add_device("link 2", DeviceSubscription(lambda _: heard.append("link 2"), is_gate=False))
    topic.add_subscriber(receiver(lambda _: heard.append("program"), []))
    topic.publish(b"", source="link 1")
    assert heard == ["link 2", "program"]
    assert topic.messages == 1


@virtual
async def test_refusal_of_a_device_is_raised_after_all_others_have_the_message() -> None:
    topic, heard = Topic("/t"), list[str]()

    def refuse(_: Message) -> None:
        raise DeviceGone("robot_0")

    topic.add_device("link 1", DeviceSubscription(refuse, is_gate=False))
    topic.add_device("link 2", DeviceSubscription(lambda _: heard.append("link 2"), is_gate=False))
    topic.add_subscriber(receiver(lambda _: heard.append("program"), []))
    try:
        topic.publish(b"", source="ann")
    except DeviceGone:
        heard.append("refused")
    assert heard == ["link 2", "program", "refused"]


@virtual
async def test_gated_topic_delivers_what_the_gate_sent_and_not_what_was_published() -> None:
    topic, heard = Topic("/cmd_vel"), list[bytes]()
    topic.add_subscriber(receiver(lambda message: heard.append(message.payload), []))
    assert not topic.is_gated
    topic.add_device("gate", DeviceSubscription(lambda _: None, is_gate=True))
    assert topic.is_gated
    topic.publish(b"wish", source="ann")
    topic.deliver(b"sent", source="gate", at_s=0.0)
    assert heard == [b"sent"]
    topic.remove_device("gate")
    assert not topic.is_gated


@virtual
async def test_subscriber_whose_callback_fails_is_removed_alone() -> None:
    topic, failed, heard = Topic("/t"), list[Exception](), list[bytes]()

    def crash(_: Message) -> None:
        raise ZeroDivisionError

    topic.add_subscriber(receiver(crash, failed))
    topic.add_subscriber(receiver(lambda message: heard.append(message.payload), []))
    topic.publish(b"1", source="ann")
    topic.publish(b"2", source="ann")
    assert (heard, len(failed), len(topic.subscribers)) == ([b"1", b"2"], 1, 1)


@virtual
async def test_latched_message_is_sent_to_devices_that_take_it() -> None:
    topic, heard = Topic("/t"), list[str]()
    topic.add_publisher("ann")
    topic.latched["ann"] = None
    topic.publish(b"", source="ann")
    assert topic.messages == 1
    assert topic.latched == {"ann": b""}
    topic.add_device("link", DeviceSubscription(lambda _: heard.append("link"), is_gate=False))
    topic.add_device("gate", DeviceSubscription(lambda _: heard.append("gate"), is_gate=True))
    topic.add_device("reset", DeviceSubscription(lambda _: heard.append("reset"), is_gate=False, is_command=True))
    for key in ("link", "gate", "reset", "other"):
        topic.send_latched(key)
    assert heard == ["link"]
    topic.forget_publisher("ann")
    assert topic.latched == {}


def test_rank_of_a_device_is_above_the_daemon_s_and_a_program_s() -> None:
    topic = Topic("/t")
    assert topic.highest_rank == PROGRAM_RANK
    topic.publishers |= {Node("program"), Node("hostlink", is_daemon=True)}
    assert PROGRAM_RANK < topic.highest_rank < DEVICE_RANK
    assert not topic.has_device_publisher
    topic.add_publisher("link")
    assert topic.highest_rank == DEVICE_RANK == rank_of("link")
    assert topic.has_device_publisher


@virtual
async def test_work_with_a_message_delays_deliveries_until_it_is_done() -> None:
    deliveries, order = Deliveries(), list[str]()
    message = Message("/t", "", None, b"", source=None, stamp_ns=0, at_s=0.0)

    def work(_: Message) -> str:
        deliveries.add(lambda _: order.append("delivered"), message)
        order.append("worked")
        return "result"

    assert deliveries.run(work, message) == "result"
    assert order == ["worked", "delivered"]
    assert deliveries.senders == ()
