"""Who subscribes to a topic, and the type that they expect."""

from hostlink.hub.topic import Subscriber, Topic


def subscriber(type_name: str = "") -> Subscriber:
    return Subscriber(lambda _: None, "test", type_name, lambda _: None)


def test_a_subscriber_that_is_removed_twice_takes_nobody_elses_type_away() -> None:
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
