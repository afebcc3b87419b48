"""Names of topics: what is parsed is what is built, and nothing else is a command."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.mqtt.topics import OF_ALL, OF_ROBOT, Request, Topics, Verb

robots = st.from_regex(r"[A-Za-z0-9_]{1,64}", fullmatch=True)
prefixes = st.sampled_from(["hostlink", "lab/robots", "a/b/c", "robots"])


@given(prefixes, robots, st.sampled_from((*OF_ROBOT, Verb.DRIVE)))
def test_command_of_a_robot_is_parsed(prefix: str, robot: str, verb: Verb) -> None:
    topics = Topics(prefix)
    assert topics.parse(topics.command(robot, verb)) == Request(verb, robot)


@given(prefixes, st.sampled_from(OF_ALL))
def test_command_of_all_robots_is_parsed(prefix: str, verb: Verb) -> None:
    assert Topics(prefix).parse(f"{prefix}/{verb}") == Request(verb, None)


@given(prefixes, st.text(alphabet="hostlink/robots_0stopdrive-+#é ", max_size=40))
def test_other_topics_are_not_commands(prefix: str, text: str) -> None:
    topics = Topics(prefix)
    request = topics.parse(text)
    if request is not None:
        levels = text.removeprefix(f"{prefix}/").split("/")
        assert levels in ([request.verb], ["robots", request.robot, request.verb])


@pytest.mark.parametrize(
    "topic",
    [
        "hostlink/drive",  # of all robots at once: never
        "hostlink/set_lock",
        "hostlink/robots/stop",
        "hostlink/robots//stop",
        "hostlink/robots/a b/stop",
        "hostlink/robots/robot_0/stop/",
        "hostlink/robots/robot_0/state",
        "other/robots/robot_0/stop",
        "hostlinks/stop",
        f"hostlink/robots/{'a' * 65}/stop",
    ],
)
def test_topic_that_is_almost_a_command_is_not_parsed(topic: str) -> None:
    assert Topics("hostlink").parse(topic) is None


@given(prefixes, robots)
def test_robot_of_an_availability_is_found(prefix: str, robot: str) -> None:
    topics = Topics(prefix)
    assert topics.robot_of_availability(topics.availability(robot)) == robot
    assert topics.robot_of_availability(topics.state(robot)) is None


def test_filters_match_the_topics_that_are_parsed() -> None:
    topics = Topics("hostlink")
    assert topics.commands == [
        "hostlink/stop",
        "hostlink/lock",
        "hostlink/unlock",
        "hostlink/robots/+/stop",
        "hostlink/robots/+/lock",
        "hostlink/robots/+/unlock",
        "hostlink/robots/+/set_lock",
    ]
    assert topics.drives == "hostlink/robots/+/drive"
