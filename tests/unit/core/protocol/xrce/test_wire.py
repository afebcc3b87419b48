"""Messages of DDS-XRCE: the bytes that boards were observed to send, round trips, and any bytes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.xrce import wire
from hostlink.core.protocol.xrce.wire import (
    ClientInfo,
    Kind,
    Range,
    ReadRequest,
    Status,
    Submessage,
    decode_message,
    decode_submessages,
    encode_message,
    encode_submessage,
)

PING = bytes.fromhex("80000000 02010800 000AFFFD02000000")
INFO = bytes.fromhex("80000000 06011200 000AFFFD 00 00 00 01 0D 00 0100 0000 00000000")
CREATE_CLIENT = bytes.fromhex("80000000 00011000 58524345 0100 010F AABBCCDD 81 00 FC01")
STATUS_AGENT = bytes.fromhex("81000000 04010B00 00 00 58524345 0100 010F 00")
READ_DATA = bytes.fromhex("81800A00 08011000 00140006 80 00 00 01 FFFF 0000 0000 0000")
TIMES = st.integers(0, 2**31 * 10**9)


def only(data: bytes) -> Submessage:
    message = decode_message(data)
    assert message is not None
    (found,), rest_bytes = decode_submessages(message.body)
    assert rest_bytes == 0
    return found


def sent(body: bytes, header: str = "81000000") -> bytes:
    return bytes.fromhex(header) + body


# -- observed bytes ---------------------------------------------------------------------------------------------------


def test_ping_without_a_session_is_answered_with_the_observed_bytes() -> None:
    assert wire.answer_ping(PING) == INFO


def test_ping_of_a_client_with_a_key_is_answered_with_the_key() -> None:
    ping = bytes.fromhex("01000000 AABBCCDD") + PING[4:]
    assert wire.answer_ping(ping) == bytes.fromhex("01000000 AABBCCDD") + INFO[4:]


@pytest.mark.parametrize(
    "data",
    [b"", PING[:7], bytes.fromhex("81800000") + PING[4:], CREATE_CLIENT, PING[:4] + bytes.fromhex("02010100 00")],
    ids=["empty", "cut", "on a stream", "no ping", "without a request"],
)
def test_bytes_without_a_ping_get_no_answer(data: bytes) -> None:
    assert wire.answer_ping(data) is None


def test_creation_of_a_client_is_the_greeting() -> None:
    assert wire.is_create_client(CREATE_CLIENT)
    assert not wire.is_create_client(PING)
    assert not wire.is_create_client(CREATE_CLIENT[:20])
    assert not wire.is_create_client(b"\x80")
    assert not wire.is_create_client(CREATE_CLIENT.replace(b"XRCE", b"XRCF"))
    assert not wire.is_create_client(b"\x80\x80" + CREATE_CLIENT[2:])


def test_client_tells_its_key_its_session_and_the_longest_message_it_takes() -> None:
    info = ClientInfo(b"\1\0", b"\1\x0f", bytes.fromhex("AABBCCDD"), 0x81, (), 508)
    assert wire.decode_client(only(CREATE_CLIENT)) == info
    assert encode_message(0x80, b"", 0, 0, wire.encode_client(info)) == CREATE_CLIENT


def test_client_with_properties_tells_them_before_its_longest_message() -> None:
    built = wire.Builder().raw(b"XRCE\1\0\1\x0fabcd").u8(0x81).u8(1).u32(1).string("uxr_sm").string("1").u16(508)
    info = wire.decode_client(Submessage(Kind.CREATE_CLIENT, 1, built.data))
    assert info is not None
    assert (info.properties, info.mtu) == ((("uxr_sm", "1"),), 508)
    many = wire.Builder().raw(b"XRCE\1\0\1\x0fabcd").u8(0x81).u8(1).u32(17)
    assert wire.decode_client(Submessage(Kind.CREATE_CLIENT, 1, many.data)) is None


def test_agent_status_has_the_observed_bytes() -> None:
    assert sent(wire.encode_status_agent(Status.OK)) == STATUS_AGENT


def test_status_has_the_observed_bytes() -> None:
    status = bytes.fromhex("81800000 05010600 000A0001 00 00")
    assert sent(wire.encode_status(0x000A, 0x0001, Status.OK), "81800000") == status


def test_read_request_without_limits_is_read_as_observed() -> None:
    wanted = ReadRequest(0x14, 0x0006, 0x80, 0, wire.UNLIMITED, 0, 0, 0)
    assert wire.decode_read(only(READ_DATA)) == wanted
    assert sent(wire.encode_read(0x14, 0x0006, 0x80), "81800A00") == READ_DATA


def test_read_request_without_delivery_control_wants_one_sample() -> None:
    plain = Submessage(Kind.READ_DATA, 1, bytes.fromhex("00140006 80 00 00 00"))
    assert wire.decode_read(plain) == ReadRequest(0x14, 0x0006, 0x80, 0, 1, 0, 0, 0)


def test_read_request_with_a_filter_and_limits_is_read() -> None:
    built = wire.Builder().id(20).id(6).u8(1).u8(0).u8(1).string("x > 1").u8(1).u16(5).u16(6).u16(700).u16(8)
    assert wire.decode_read(Submessage(Kind.READ_DATA, 1, built.data)) == ReadRequest(20, 6, 1, 0, 5, 6, 700, 8)


def test_acknowledgement_has_the_observed_bytes_the_high_byte_of_the_bitmap_first() -> None:
    data = bytes.fromhex("81000000 0A010500 0C00 0103 80")
    assert sent(wire.encode_acknack(12, 0x0103, 0x80)) == data
    assert wire.decode_acknack(only(data)) == Range(12, 0x0103, 0x80)


def test_heartbeat_has_the_observed_bytes() -> None:
    data = bytes.fromhex("81000000 0B010500 0C00 0D00 80")
    assert sent(wire.encode_heartbeat(12, 13, 0x80)) == data
    assert wire.decode_heartbeat(only(data)) == Range(12, 13, 0x80)


def test_velocity_is_60_constant_bytes() -> None:
    data = sent(wire.encode_data(0x0014, 0x0006, bytes(48)))
    assert data == bytes.fromhex("81000000 09013400 00140006") + bytes(48)
    assert len(data) == 60


def test_time_answer_repeats_the_time_of_the_client() -> None:
    asked = Submessage(Kind.TIMESTAMP, 1, bytes.fromhex("05000000 06000000"))
    originated = wire.decode_timestamp(asked)
    assert originated == asked.payload
    reply = wire.encode_timestamp_reply(7_000_000_008, originated)
    now = bytes.fromhex("07000000 08000000")
    assert reply == bytes.fromhex("0F011800") + now + now + originated


def test_deletion_names_its_object() -> None:
    assert wire.decode_request(only(bytes.fromhex("81010000 03010400 0335 0012"))) == (0x0335, 0x0012)


def test_fragment_of_a_long_message_is_read() -> None:
    message = decode_message(bytes.fromhex("81800C00 0D01F401") + bytes.fromhex("0701D402 0016 0005") + bytes(492))
    assert message is not None
    assert (message.session, message.stream, message.number) == (0x81, 0x80, 12)
    assert [each.kind for each in decode_submessages(message.body)[0]] == [Kind.FRAGMENT]


# -- other byte order, damage -----------------------------------------------------------------------------------------


def test_submessage_of_a_big_endian_client_is_read_in_its_order() -> None:
    body = bytes.fromhex("0B00 0005 000C 000D 80")
    (found,), _ = decode_submessages(body)
    assert wire.decode_heartbeat(found) == Range(12, 13, 0x80)


def test_submessages_are_aligned_to_four_bytes() -> None:
    first, second = wire.encode_acknack(1, 0, 0x80), wire.encode_heartbeat(1, 2, 0x80)
    body = wire.join_submessages(first, second)
    assert len(body) == 12 + 9
    assert [each.kind for each in decode_submessages(body)[0]] == [Kind.ACKNACK, Kind.HEARTBEAT]


def test_cut_submessage_is_left_out_and_its_bytes_are_counted() -> None:
    body = wire.join_submessages(wire.encode_acknack(1, 0, 0x80), wire.encode_heartbeat(1, 2, 0x80))
    found, rest_bytes = decode_submessages(body[:-1])
    assert [each.kind for each in found] == [Kind.ACKNACK]
    assert rest_bytes == 8
    assert decode_submessages(b"\1\2\3") == ([], 3)


def test_submessages_of_one_message_are_bounded() -> None:
    found, rest_bytes = decode_submessages(bytes((Kind.RESET, 1, 0, 0)) * (wire.SUBMESSAGES_MAX + 2))
    assert (len(found), rest_bytes) == (wire.SUBMESSAGES_MAX, 8)


@pytest.mark.parametrize("length", [0, 70_000 % 65536])
def test_message_of_more_than_64_kilobytes_ends_with_its_body(length: int) -> None:
    body = bytes((Kind.WRITE_DATA, 1)) + length.to_bytes(2, "little") + bytes(70_000)
    (found,), rest_bytes = decode_submessages(body)
    assert (len(found.payload), rest_bytes) == (70_000, 0)


@pytest.mark.parametrize("data", [b"", b"\x81\0\0", b"\1\0\0\0abc"], ids=["empty", "short", "without its key"])
def test_message_without_a_whole_header_is_none(data: bytes) -> None:
    assert decode_message(data) is None


def test_damaged_fields_are_none() -> None:
    empty = Submessage(0, 1, b"")
    decoders = (
        wire.decode_client, wire.decode_request, wire.decode_read, wire.decode_acknack, wire.decode_heartbeat,
        wire.decode_timestamp,
    )  # fmt: skip
    assert [decode(empty) for decode in decoders] == [None] * len(decoders)
    with pytest.raises(wire.BadField):
        wire.Fields(b"\xff\xff\xff\xff").string()
    with pytest.raises(wire.BadField):
        wire.Fields(b"abc").take(-1)


def test_rest_of_the_fields_is_returned_once() -> None:
    fields = wire.Fields(b"\1abc")
    assert (fields.u8(), fields.rest(), fields.rest()) == (1, b"abc", b"")


# -- properties -------------------------------------------------------------------------------------------------------

bodies = st.lists(
    st.tuples(st.integers(0, 255), st.integers(0, 255).map(lambda flags: flags | 1), st.binary(max_size=40)), max_size=6
)


@given(st.integers(0, 255), st.binary(min_size=4, max_size=4), st.integers(0, 255), st.integers(0, 65535), bodies)
def test_encoded_message_decodes_to_itself(
    session: int, key: bytes, stream: int, number: int, parts: list[tuple[int, int, bytes]]
) -> None:
    body = wire.join_submessages(*(encode_submessage(kind, payload, flags) for kind, flags, payload in parts))
    message = decode_message(encode_message(session, key, stream, number, body))
    assert message == (session, stream, number, key if session < wire.KEYLESS else b"", body)
    assert decode_submessages(body) == ([Submessage(*each) for each in parts], 0)


@given(st.binary(max_size=200))
def test_any_bytes_decode_to_something(data: bytes) -> None:
    wire.answer_ping(data)
    wire.is_create_client(data)
    message = decode_message(data)
    for each in decode_submessages(data if message is None else message.body)[0]:
        wire.decode_client(each)
        wire.decode_read(each)
        wire.decode_acknack(each)
        wire.decode_heartbeat(each)
        wire.decode_timestamp(each)
        wire.decode_request(each)


@given(st.integers(0, 65535), st.integers(-32768, 32767))
def test_distance_of_two_numbers_is_what_was_added(number: int, ahead: int) -> None:
    assert wire.distance(number, wire.number_after(number, ahead)) == ahead
