"""Objects of a client: by binary, XML and reference, with reuse and replacement. Names of topics and services."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.xrce.names import NO_TYPE, name_of_reference, service_names, topic_names
from hostlink.core.protocol.xrce.objects import ObjectTable, XrceObject, decode_object
from hostlink.core.protocol.xrce.wire import REPLACE, REUSE, Builder, Kind, Representation, Status, Submessage
from tests.support import xrce_board as board

NODE, TOPIC, PUBLISHER, SUBSCRIBER, WRITER, READER, REQUESTER, REPLIER = range(1, 9)
TWIST = "geometry_msgs::msg::dds_::Twist_"
SET_BOOL = "std_srvs::srv::dds_::SetBool"


def creation(id_: int, content: bytes, parent: int = 0x0001, form: int = Representation.BINARY) -> Submessage:
    built = Builder().id(10).id(id_).u8(id_ & 0xF).u8(form).octets(content)
    payload = built.u16(0).data if id_ & 0xF == NODE else built.id(parent).data
    return Submessage(Kind.CREATE, 7, payload)


def made(id_: int, content: bytes, parent: int = 0x0001, form: int = Representation.BINARY) -> XrceObject:
    found = decode_object(creation(id_, content, parent, form))
    assert found is not None
    return found


NODE_1 = made(NODE, board.participant("base"))
TOPIC_1 = made(TOPIC, board.topic("rt/cmd_vel", TWIST))
SUBSCRIBER_1 = made(SUBSCRIBER, b"\0\0")
READER_1 = made(READER, board.endpoint(TOPIC, is_reader=True), SUBSCRIBER)


def table(*objects: XrceObject, max_endpoints: int = 8) -> ObjectTable:
    found = ObjectTable(max_endpoints)
    for each in objects:
        assert found.create(each, 0) == Status.OK
    return found


# -- observed bytes ---------------------------------------------------------------------------------------------------


def observed(payload: str, text_: str = "", rest: str = "") -> XrceObject | None:
    return decode_object(Submessage(Kind.CREATE, 7, bytes.fromhex(payload) + text_.encode() + bytes.fromhex(rest)))


def test_participant_as_observed_names_the_node() -> None:
    node = observed("000A0001 01 03 0000 1C000000 00 01 0000 14000000", "linorobot_base_node\0", "0000")
    assert node is not None
    assert (node.id, node.name) == (0x0001, "linorobot_base_node")


def test_topic_as_observed_has_the_names_of_ros() -> None:
    head = "000B0002 02 03 0000 3F000000 13000000"
    middle = "00 01 000000 1F000000"
    payload = bytes.fromhex(head) + b"rt/odom/unfiltered\0" + bytes.fromhex(middle)
    payload += b"nav_msgs::msg::dds_::Odometry_\0" + bytes.fromhex("0001")
    assert len(payload) == 0x4D
    topic = decode_object(Submessage(Kind.CREATE, 7, payload))
    assert topic is not None
    assert (topic.name, topic.type, topic.parent) == ("/odom/unfiltered", "nav_msgs/Odometry", 0x0001)


def test_writer_and_reader_as_observed_name_their_topic() -> None:
    writer = observed("000D0005 05 03 0000 0E000000 0002 01 00 0300 01 00 0A00 00 00 00 00 0003")
    reader = observed("00130006 06 03 0000 0F000000 0022 01 00 0300 01 00 0A00 00 00 00 00 00 0004")
    assert writer is not None
    assert reader is not None
    assert (writer.topic, writer.parent, writer.is_reliable) == (0x0002, 0x0003, True)
    assert (reader.topic, reader.parent) == (0x0022, 0x0004)


def test_publisher_as_observed_belongs_to_the_participant() -> None:
    publisher = observed("000C0003 03 03 0000 02000000 0000 0001")
    assert publisher is not None
    assert publisher.parent == 0x0001


def test_best_effort_writer_is_told_from_a_reliable_one() -> None:
    assert not made(WRITER, board.endpoint(TOPIC, is_reader=False, is_reliable=False), PUBLISHER).is_reliable
    assert made(WRITER, TOPIC.to_bytes(2) + b"\0", PUBLISHER).is_reliable


def test_service_has_the_names_of_ros() -> None:
    replier = made(REPLIER, board.service("led", SET_BOOL))
    assert (replier.name, replier.type) == ("/led", "std_srvs/SetBool")


# -- XML and references -----------------------------------------------------------------------------------------------


def xml(id_: int, text_: str) -> XrceObject:
    return made(id_, text_.encode() + b"\0", form=Representation.XML)


def test_objects_by_xml_have_the_same_names() -> None:
    names = f"<name>rt/cmd_vel</name><dataType>{TWIST}</dataType>"
    topic = xml(TOPIC, f"<dds><topic>{names}</topic></dds>")
    reader = xml(READER, f"<dds><data_reader><topic><kind>NO_KEY</kind>{names}</topic></data_reader></dds>")
    quality = "<qos><reliability><kind>BEST_EFFORT</kind></reliability></qos>"
    writer = xml(WRITER, f"<dds><data_writer>{quality}<topic>{names}</topic></data_writer></dds>")
    for each in (topic, reader, writer):
        assert (each.name, each.type) == ("/cmd_vel", "geometry_msgs/Twist")
    assert reader.is_reliable
    assert not writer.is_reliable
    assert xml(NODE, "<dds><participant><rtps><name>a&amp;b</name></rtps></participant></dds>").name == "a&b"
    assert xml(PUBLISHER, "").name == ""


def test_xml_full_of_spaces_is_read_in_linear_time() -> None:
    for text_ in ("<name>" + " " * 1000, "<name>" * 150, 'service_name="' * 70, "<reliability> " * 70):
        assert xml(TOPIC, text_).type == NO_TYPE
        assert xml(REPLIER, text_).type == NO_TYPE


def test_service_by_xml_has_the_same_names() -> None:
    attributes = f'profile_name="r" service_name="/led" request_type="{SET_BOOL}_Request_" reply_type="r"'
    topics = "<request_topic_name>rq/ledRequest</request_topic_name>"
    for text_ in (f"<dds><replier {attributes}>{topics}</replier></dds>", f"<dds><replier {attributes}/></dds>"):
        replier = xml(REPLIER, text_)
        assert (replier.name, replier.type) == ("/led", "std_srvs/SetBool")
    assert xml(REQUESTER, "<dds/>").type == NO_TYPE


def test_reference_tells_the_topic_and_no_type() -> None:
    writer = made(WRITER, b"odom__dw\0", form=Representation.REFERENCE)
    assert (writer.name, writer.type) == ("/odom", NO_TYPE)
    assert made(NODE, b"participant_profile\0", form=Representation.REFERENCE).name == ""


def test_type_of_a_reference_is_that_of_an_object_with_its_name() -> None:
    topic = xml(TOPIC, "<topic><name>rt/odom</name><dataType>nav_msgs::msg::dds_::Odometry_</dataType></topic>")
    publisher = made(PUBLISHER, b"\0\0")
    writer = made(WRITER, b"odom__dw\0", PUBLISHER, form=Representation.REFERENCE)
    objects = table(NODE_1, topic, publisher, writer)
    assert objects.name_and_type(writer) == ("/odom", "nav_msgs/Odometry")
    assert table(NODE_1, publisher, writer).name_and_type(writer) == ("/odom", NO_TYPE)
    objects.delete(TOPIC)
    assert objects.name_and_type(writer) == ("/odom", NO_TYPE)
    assert objects.create(topic, 0) == Status.OK
    assert objects.name_and_type(writer) == ("/odom", "nav_msgs/Odometry")


def test_types_of_many_references_are_found_in_linear_time() -> None:
    """The session compares the types of all endpoints when a board creates an object, and a board creates many."""

    def taken_s(content: str, form: int) -> float:
        objects = ObjectTable(256)
        for each in (NODE_1, made(PUBLISHER, b"\0\0")):
            assert objects.create(each, 0) == Status.OK
        for number in range(1, 251):
            name = content.format(number).encode() + b"\0"
            assert objects.create(made(number << 4 | WRITER, name, PUBLISHER, form=form), 0) == Status.OK

        def once_s() -> float:
            began_s = time.perf_counter()
            for each in objects.endpoints():
                objects.name_and_type(each)
            return time.perf_counter() - began_s

        return min(once_s() for _ in range(5))

    typed = "<topic><name>rt/t{}</name><dataType>nav_msgs::msg::dds_::Odometry_</dataType></topic>"
    assert taken_s("t{}__dw", Representation.REFERENCE) < 10 * taken_s(typed, Representation.XML)


@pytest.mark.parametrize(
    ("dds_topic", "dds_type", "expected"),
    [
        ("rt/a/b", TWIST, ("/a/b", "geometry_msgs/Twist")),
        ("HelloWorldTopic", "HelloWorld", ("/HelloWorldTopic", "unknown/HelloWorld")),
        ("rt/a b", TWIST, ("/a_b", "geometry_msgs/Twist")),
        ("", "", ("/unknown", NO_TYPE)),
        ("rt/x", "a::b", ("/x", "unknown/a_b")),
    ],
)
def test_names_without_ros_stay_as_far_as_names_permit(
    dds_topic: str, dds_type: str, expected: tuple[str, str]
) -> None:
    assert topic_names(dds_topic, dds_type) == expected


def test_service_without_a_topic_has_the_name_that_it_says() -> None:
    assert service_names("/led", "", f"{SET_BOOL}_Request_") == ("/led", "std_srvs/SetBool")
    assert name_of_reference("ns/led__rp") == "/ns/led"


# -- reuse, replacement, bounds ---------------------------------------------------------------------------------------


def test_object_that_exists_is_created_again_as_its_flags_permit() -> None:
    other = made(NODE, board.participant("other"))
    objects = table(NODE_1)
    assert objects.create(NODE_1, 0) == Status.ALREADY_EXISTS
    assert objects.create(NODE_1, REUSE) == Status.MATCHED
    assert objects.create(NODE_1, REUSE | REPLACE) == Status.MATCHED
    assert objects.create(other, REUSE) == Status.MISMATCH
    assert objects.node == "base"
    assert objects.create(other, REUSE | REPLACE) == Status.OK
    assert objects.create(NODE_1, REPLACE) == Status.OK
    assert objects.node == "base"


def test_reader_of_a_program_before_gives_way_to_another_one_of_its_name() -> None:
    objects = table(NODE_1, TOPIC_1, SUBSCRIBER_1, READER_1)
    other = made(0x16, board.endpoint(TOPIC, is_reader=True), SUBSCRIBER)
    objects.begin_anew()
    assert [each.id for each in objects.current_endpoints()] == [READER]
    objects.create(other, 0)
    assert [each.id for each in objects.current_endpoints()] == [0x16]
    objects.create(READER_1, REUSE)
    assert [each.id for each in objects.current_endpoints()] == [READER, 0x16]
    objects.begin_anew()
    objects.create(READER_1, REUSE)
    objects.delete(READER)
    assert [each.id for each in objects.current_endpoints()] == [0x16]


def test_object_without_its_parent_or_topic_is_refused() -> None:
    objects = table()
    assert objects.create(TOPIC_1, 0) == Status.UNKNOWN_REFERENCE
    objects = table(NODE_1, SUBSCRIBER_1)
    assert objects.create(READER_1, 0) == Status.UNKNOWN_REFERENCE
    wrong_parent = made(READER, board.endpoint(TOPIC, is_reader=True), 0x0001)
    assert table(NODE_1, TOPIC_1).create(wrong_parent, 0) == Status.UNKNOWN_REFERENCE
    wrong_topic = made(READER, board.endpoint(0x0001, is_reader=True), SUBSCRIBER)
    assert objects.create(wrong_topic, 0) == Status.UNKNOWN_REFERENCE


def test_reader_has_the_names_of_its_topic_also_after_the_topic_was_deleted() -> None:
    objects = table(NODE_1, TOPIC_1, SUBSCRIBER_1, READER_1)
    (reader,) = objects.endpoints()
    assert objects.delete(TOPIC) == Status.OK
    assert objects.name_and_type(reader) == ("/cmd_vel", "geometry_msgs/Twist")


STAMPED_1 = made(TOPIC, board.topic("rt/cmd_vel", "geometry_msgs::msg::dds_::TwistStamped_"))


@pytest.mark.parametrize("is_deleted", [False, True])
def test_reader_has_the_type_of_its_topic_also_after_the_topic_has_another(*, is_deleted: bool) -> None:
    objects = table(NODE_1, TOPIC_1, SUBSCRIBER_1, READER_1)
    if is_deleted:
        objects.delete(TOPIC)
    assert objects.create(STAMPED_1, REUSE | REPLACE) == Status.OK
    assert objects.create(READER_1, REUSE | REPLACE) == Status.MATCHED
    (reader,) = objects.endpoints()
    assert objects.name_and_type(reader) == ("/cmd_vel", "geometry_msgs/TwistStamped")
    again = table()
    for each in objects.by_id.values():  # as after a restart of the host
        assert again.create(each, 0) == Status.OK
    assert again.by_id == objects.by_id


def test_deleted_object_takes_those_below_it_along() -> None:
    objects = table(NODE_1, TOPIC_1, SUBSCRIBER_1, READER_1)
    assert objects.delete(SUBSCRIBER) == Status.OK
    assert objects.delete(READER) == Status.UNKNOWN_REFERENCE
    assert objects.delete(NODE) == Status.OK
    assert not objects.by_id


def test_endpoints_and_other_objects_are_bounded() -> None:
    objects = table(NODE_1, TOPIC_1, SUBSCRIBER_1, READER_1, max_endpoints=1)
    second = made(0x16, board.endpoint(TOPIC, is_reader=True), SUBSCRIBER)
    assert objects.create(second, 0) == Status.RESOURCES
    assert objects.refused == 1
    assert objects.create(READER_1, REPLACE) == Status.OK
    assert objects.create(made(0x12, board.topic("rt/a", TWIST)), 0) == Status.RESOURCES
    assert objects.refused == 2


def test_objects_that_an_endpoint_needs_come_before_it() -> None:
    objects = table(NODE_1, TOPIC_1, SUBSCRIBER_1, READER_1, made(0x11, board.participant("second")))
    ids = [each.id for each in objects.with_parents(READER)]
    assert ids == [0x11, NODE, SUBSCRIBER, TOPIC, READER]
    objects.delete(TOPIC)
    assert [each.id for each in objects.with_parents(READER)] == [0x11, NODE, SUBSCRIBER, READER]


# -- damage -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "submessage",
    [
        Submessage(Kind.CREATE, 7, b""),
        creation(0x000A, b""),  # a type, which no known client creates
        creation(TOPIC, b"\xff\xff\0\0"),
        creation(TOPIC, b"", form=9),
        Submessage(Kind.CREATE, 7, bytes.fromhex("000A0001 02 03 0000 00000000 0000")),  # another kind than its id's
        Submessage(Kind.CREATE, 7, bytes.fromhex("000A0001 01 03 0000 00FFFFFF 0000")),
    ],
)
def test_damaged_creation_is_none(submessage: Submessage) -> None:
    assert decode_object(submessage) is None


@given(st.integers(0, 0xFFFF), st.integers(0, 4), st.binary(max_size=80), st.integers(0, 0xFFFF), st.integers(0, 255))
def test_any_creation_raises_nothing(id_: int, form: int, content: bytes, parent: int, flags: int) -> None:
    objects = table(NODE_1, TOPIC_1)
    found = decode_object(creation(id_, content, parent, form)._replace(flags=flags))
    if found is not None:
        objects.create(found, flags)
        objects.name_and_type(found)
