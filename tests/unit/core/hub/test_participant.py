"""Participant: its bounds, roles, subscriptions and what its end takes back."""

import asyncio
from collections.abc import Mapping

import pytest

from hostlink.core.hub.byte_budget import OWN_LATCHED_BYTES
from hostlink.core.hub.message import Message
from hostlink.core.hub.node import Node, Role, address_of, is_of
from hostlink.core.hub.participant import MAX_ADVERTISED, MAX_CALLS, MAX_LATCHED, MAX_SERVICES, MAX_SUBSCRIPTIONS
from hostlink.core.hub.topic import MAX_NESTED
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import BadRequest, DeviceGone, ServiceFailed, UnknownTopic, WrongType
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.participants import text
from tests.support.virtual_loop import inside

TEXT = "std_msgs/String"
TRIGGER = "std_srvs/Trigger"


async def answer(_: Mapping[str, object]) -> Mapping[str, object]:
    return {"success": True, "message": "done"}


@inside(in_hub)
async def test_participant_may_advertise_subscribe_and_provide_up_to_its_bounds(made: MemoryHub) -> None:
    ann = made.hub.join("ann")
    for number in range(MAX_ADVERTISED):
        ann.advertise(f"/t{number}", TEXT)
    ann.advertise("/t0", TEXT)  # the same topic again
    with pytest.raises(BadRequest, match=f"more than {MAX_ADVERTISED} topics"):
        ann.advertise("/more", TEXT)
    for number in range(MAX_SERVICES):
        ann.provide(f"/s{number}", TRIGGER, answer)
    with pytest.raises(BadRequest, match=f"more than {MAX_SERVICES} services"):
        ann.provide("/more", TRIGGER, answer)
    for number in range(MAX_SUBSCRIPTIONS):
        ann.subscribe(f"/t{number}", lambda _: None)
    with pytest.raises(BadRequest, match=f"more than {MAX_SUBSCRIPTIONS} subscriptions"):
        ann.subscribe("/more", lambda _: None)


@inside(in_hub)
async def test_daemon_s_own_participant_has_no_bounds(made: MemoryHub) -> None:
    own = made.hub.join_daemon()
    for number in range(MAX_ADVERTISED + 1):
        own.advertise(f"/t{number}", TEXT)
        own.subscribe(f"/t{number}", lambda _: None)
        own.provide(f"/s{number}", TRIGGER, answer)


@inside(in_hub)
async def test_latched_topics_are_bounded_by_their_number_and_their_bytes(made: MemoryHub) -> None:
    ann = made.hub.join("ann")
    for number in range(MAX_LATCHED):
        ann.advertise(f"/l{number}", TEXT, is_latched=True)
    with pytest.raises(BadRequest, match=f"more than {MAX_LATCHED} latched"):
        ann.advertise("/more", TEXT, is_latched=True)
    heard: list[int] = []
    made.hub.join("reader").subscribe("/l0", lambda message: heard.append(len(message.payload)))
    with pytest.raises(BadRequest, match="delivered, but not kept"):
        ann.publish("/l0", bytes(OWN_LATCHED_BYTES + 1))
    assert heard == [OWN_LATCHED_BYTES + 1]


@inside(in_hub)
async def test_latched_message_is_delivered_to_a_later_subscriber_until_its_publisher_leaves(made: MemoryHub) -> None:
    ann, heard = made.hub.join("ann"), list[bytes]()
    ann.advertise("/l", TEXT, is_latched=True)
    ann.advertise("/l", TEXT)  # stays latched
    ann.publish("/l", text("old"))
    ann.publish("/l", text("new"))
    reader = made.hub.join("reader")
    reader.subscribe("/l", lambda message: heard.append(message.payload))
    assert heard == [text("new")]
    ann.leave()
    reader.subscribe("/l", lambda message: heard.append(message.payload))
    assert heard == [text("new")]
    assert made.hub.budget["latched"].held_bytes == 0


@inside(in_hub)
async def test_role_that_may_read_can_subscribe_and_not_publish_drive_or_serve(made: MemoryHub) -> None:
    await made.connect()
    reader = made.hub.join("reader", role=Role.READ)
    reader.subscribe("/t", lambda _: None)
    for refused in (
        lambda: reader.advertise("/t", TEXT),
        lambda: reader.publish("/t", text("x")),
        lambda: reader.provide("/s", TRIGGER, answer),
        lambda: reader.drive(made.robot(), PlanarVelocity(0.1)),
    ):
        with pytest.raises(BadRequest, match="the token may only read"):
            refused()
    made.hub.join("server").provide("/s", TRIGGER, answer)
    made.hub.join("rosapi").provide("/r", TRIGGER, answer, is_reading=True)
    with pytest.raises(BadRequest, match="the token may only read"):
        await reader.call("/s", {})
    assert (await reader.call("/r", {}))["message"] == "done"


@inside(in_hub)
async def test_participant_that_has_left_can_do_nothing(made: MemoryHub) -> None:
    ann = made.hub.join("ann")
    ann.leave()
    ann.leave()
    for refused in (
        lambda: ann.advertise("/t", TEXT),
        lambda: ann.subscribe("/t", lambda _: None),
        lambda: ann.watch_graph(lambda: None),
        lambda: ann.observe(lambda _: None),
    ):
        with pytest.raises(BadRequest, match="ann has left"):
            refused()


@inside(in_hub)
async def test_leaving_takes_back_topics_services_drives_and_followers(made: MemoryHub) -> None:
    device = await made.connect()
    ann, poses = made.hub.join("ann"), list[int]()
    ann.advertise("/t", TEXT)
    ann.provide("/s", TRIGGER, answer)
    ann.follow(made.robot(), lambda: poses.append(1))
    await device.send(125, bytes(24))
    await asyncio.sleep(0.05)
    assert poses == [1]
    ann.drive(made.robot(), PlanarVelocity(0.1))
    ann.leave()
    await device.send(125, bytes(24))
    await asyncio.sleep(0.05)
    assert poses == [1]
    assert made.hub.topics.find_or_none("/t") is None
    assert not made.hub.services.is_offered("/s")
    assert made.robot().gate.owner is None


@inside(in_hub, reraises=False)
async def test_callback_that_fails_ends_its_participant_alone(made: MemoryHub) -> None:
    ended, heard = list[str](), list[bytes]()

    def crash(_: Message) -> None:
        raise ZeroDivisionError

    broken = made.hub.join("broken", on_end=lambda: ended.append("broken"))
    broken.subscribe("/t", crash)
    made.hub.join("reader").subscribe("/t", lambda message: heard.append(message.payload))
    own = made.hub.join_daemon()
    own.subscribe("/t", crash)
    ann = made.hub.join("ann")
    ann.advertise("/t", TEXT)
    ann.publish("/t", text("x"))
    assert (ended, heard, broken.has_left, own.has_left) == (["broken"], [text("x")], True, False)
    assert made.hub.isolation.crashes == {"participant": 2}


@inside(in_hub)
async def test_throttled_subscriptions_report_the_next_time_at_which_one_is_due(made: MemoryHub) -> None:
    reader, ann, heard = made.hub.join("reader"), made.hub.join("ann"), list[str]()
    throttled = list[int]()
    for topic, interval_s in (("/slow", 2.0), ("/quick", 1.0), ("/all", 0.0)):
        reader.subscribe(
            topic,
            lambda message: heard.append(message.topic),
            interval_s=interval_s,
            queue_length=3,
            on_throttled=lambda: throttled.append(1),
        )
        ann.advertise(topic, TEXT)
    began_s = made.now_s
    assert reader.flush(began_s) is None
    for topic in ("/slow", "/quick", "/all"):
        ann.publish(topic, text("1"))
        ann.publish(topic, text("2"))
    assert heard == ["/slow", "/quick", "/all", "/all"]
    assert len(throttled) == 2
    assert reader.flush(began_s + 0.5) == began_s + 1.0
    assert reader.flush(began_s + 1.0) == began_s + 2.0
    assert heard[4:] == ["/quick"]
    assert reader.flush(began_s + 2.0) is None
    assert heard[5:] == ["/slow"]


@inside(in_hub, reraises=False)
async def test_flush_whose_callback_fails_ends_the_participant(made: MemoryHub) -> None:
    reader, ann, count = made.hub.join("reader"), made.hub.join("ann"), list[int]()

    def receive(_: Message) -> None:
        count.append(1)
        if len(count) > 1:
            raise ZeroDivisionError

    reader.subscribe("/t", receive, interval_s=1.0, queue_length=1)
    ann.advertise("/t", TEXT)
    ann.publish("/t", text("1"))
    ann.publish("/t", text("2"))
    assert reader.flush(made.now_s + 1.0) is None
    assert reader.has_left


@inside(in_hub)
async def test_callback_that_publishes_what_calls_it_back_is_refused_after_a_few_times(made: MemoryHub) -> None:
    ann, heard, refused = made.hub.join("ann"), list[int](), list[str]()
    ann.advertise("/t", TEXT)

    def receive(_: Message) -> None:
        heard.append(1)
        try:
            ann.publish("/t", text("again"))
        except BadRequest as error:
            refused.append(str(error))

    ann.subscribe("/t", receive)
    ann.publish("/t", text("first"))
    assert len(heard) == MAX_NESTED
    assert refused == ["ann sends in a callback what calls it back, again and again"]
    ann.publish("/t", text("later"))
    assert len(heard) == 2 * MAX_NESTED


@inside(in_hub)
async def test_type_of_messages_is_that_of_the_topic_or_the_named_one(made: MemoryHub) -> None:
    ann = made.hub.join("ann")
    with pytest.raises(UnknownTopic):
        ann.message_type("/t")
    assert ann.message_type("/t", TEXT).name == TEXT
    with pytest.raises(BadRequest, match="unknown type"):
        ann.advertise("/t", "my_msgs/Unknown")
    ann.advertise("/t", TEXT)
    assert ann.message_type("/t").name == TEXT
    with pytest.raises(WrongType):
        ann.message_type("/t", "std_msgs/Bool")
    reader = made.hub.join("reader")
    reader.subscribe("/raw", lambda _: None)
    with pytest.raises(WrongType):
        reader.message_type("/raw")
    with pytest.raises(WrongType):
        reader.subscribe("/t", lambda _: None, type_name="std_msgs/Bool")


@inside(in_hub)
async def test_unadvertised_topic_is_removed_and_an_unknown_one_is_ignored(made: MemoryHub) -> None:
    ann = made.hub.join("ann")
    ann.advertise("/t", TEXT)
    ann.unadvertise("t")
    ann.unadvertise("/other")
    assert made.hub.topics.find_or_none("/t") is None
    ann.provide("/s", TRIGGER, answer)
    ann.withdraw("s")
    ann.withdraw("/other")
    assert not made.hub.services.is_offered("/s")


@inside(in_hub)
async def test_closed_gates_refuse_publications(made: MemoryHub) -> None:
    ann = made.hub.join("ann")
    ann.advertise("/t", TEXT)
    made.hub.gates.refuse_all()
    with pytest.raises(DeviceGone):
        ann.publish("/t", text("x"))


@inside(in_hub)
async def test_calls_under_way_are_bounded_and_fail_when_their_participant_leaves(made: MemoryHub) -> None:
    never = asyncio.Event()

    async def wait(_: Mapping[str, object]) -> Mapping[str, object]:
        await never.wait()
        return {}

    made.hub.join("server").provide("/s", TRIGGER, wait)
    ann = made.hub.join("ann")
    async with asyncio.TaskGroup() as tasks:

        async def call() -> str:
            try:
                await ann.call("/s", {})
            except ServiceFailed as error:
                return str(error)
            return ""

        calls = [tasks.create_task(call()) for _ in range(MAX_CALLS)]
        await asyncio.sleep(0.1)
        with pytest.raises(BadRequest, match=f"more than {MAX_CALLS} calls"):
            await ann.call("/s", {})
        ann.leave()
    assert {call.result() for call in calls} == {"/s: ann has left"}


@inside(in_hub)
async def test_command_carries_the_priority_and_time_of_its_participant(made: MemoryHub) -> None:
    await made.connect()
    await asyncio.sleep(0.5)
    ann = made.hub.join("ann", priority=70)
    robot = made.robot()
    assert ann.drive(robot, PlanarVelocity(9.0)) == PlanarVelocity(1.0)
    assert robot.gate.priority == 70
    assert await ann.driven(robot, PlanarVelocity(1.0)) == PlanarVelocity(1.0)
    ann.drive(robot, PlanarVelocity(0.1), priority=80, received_s=made.now_s - 0.2)
    assert robot.gate.priority == 80
    assert robot.gate.driver.deadline_s == pytest.approx(made.now_s + 0.3)


def test_node_belongs_to_its_group_alone() -> None:
    node = Node("bridge", group="ros2")
    node.address = "10.0.0.7"
    assert is_of(node, "ros2")
    assert not is_of(node, "ros1")
    assert not is_of(Node("program"), "")
    assert not is_of("link", "ros2")
    assert (str(node), address_of(node), address_of("link")) == ("bridge", "10.0.0.7", "")


def test_request_with_an_unknown_field_is_refused_before_a_program_is_called() -> None:
    async def test(made: MemoryHub) -> None:
        called: list[object] = []

        async def note(request: Mapping[str, object]) -> Mapping[str, object]:
            called.append(request)
            return {"success": True}

        made.hub.join("server").provide("/s", TRIGGER, note)
        made.hub.join("server").provide("/own", "my_msgs/Unknown", note)
        ann = made.hub.join("ann")
        with pytest.raises(BadRequest, match="/s: the request has no field 'nonsense'; its fields: none"):
            await ann.call("/s", {"nonsense": 1})
        assert called == []
        await ann.call("/own", {"any": 1})
        assert called == [{"any": 1}]

    in_hub(test)
