"""The tokens of rmw_zenoh. The examples are those of the design document of ros2/rmw_zenoh, word for word."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.graphs.ros2_qos import COMMANDS, Qos
from hostlink.components.zenoh.rmw_protocol import (
    DEFAULT_DEPTH,
    LATCHED,
    OWN_ENCLAVE,
    EndpointToken,
    NodeToken,
    TokenKind,
    data_key,
    decode_qos,
    demangle,
    encode_qos,
    gid_of,
    is_hidden,
    mangle,
    parse_token,
)

STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
LISTENER = "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"
SUBSCRIPTION = (
    "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MS/%/%/listener/"
    f"%chatter/std_msgs::msg::dds_::String_/{STRING_HASH}/::,10:,:,:,,"
)
PUBLISHER = (
    "@ros2_lv/0/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/"
    f"%chatter/std_msgs::msg::dds_::String_/{STRING_HASH}/::,7:,:,:,,"
)

names = st.from_regex(r"(/[A-Za-z_][A-Za-z0-9_]{0,8}){1,4}", fullmatch=True)
qualities = st.builds(
    Qos,
    is_reliable=st.booleans(),
    is_latched=st.booleans(),
    depth=st.one_of(st.none(), st.integers(1, 1000)),
)


def test_the_documented_examples_are_read() -> None:
    node = parse_token(LISTENER)
    assert node == NodeToken(0, "aac3178e146ba6f1fc6e6a4085e77f21", 0, "/", "listener")
    publisher = parse_token(PUBLISHER)
    assert isinstance(publisher, EndpointToken)
    assert (publisher.kind, publisher.number, publisher.name) == (TokenKind.PUBLISHER, 10, "/chatter")
    assert (publisher.type_name, publisher.type_hash) == ("std_msgs/msg/String", STRING_HASH)
    assert publisher.qos == Qos(depth=7)
    assert publisher.node.full_name == "/talker"


@pytest.mark.parametrize("text", [LISTENER, SUBSCRIPTION, PUBLISHER])
def test_the_documented_examples_are_written_as_they_were_read(text: str) -> None:
    token = parse_token(text)
    assert token is not None
    assert token.encode() == text


@given(
    kind=st.sampled_from([TokenKind.PUBLISHER, TokenKind.SUBSCRIPTION, TokenKind.SERVER, TokenKind.CLIENT]),
    name=names,
    namespace=st.one_of(st.just("/"), names),
    qos=qualities,
    enclave=st.sampled_from(["", OWN_ENCLAVE]),
    number=st.integers(0, 2**64 - 1),
)
def test_encoded_token_is_decoded_to_itself(
    kind: TokenKind, name: str, namespace: str, qos: Qos, enclave: str, number: int
) -> None:
    node = NodeToken(42, "8b20917502ee955ac4476e0266340d5c", 3, namespace, "node_1", enclave)
    token = EndpointToken(kind, node, number, name, "std_srvs/srv/SetBool", "RIHS01_00", qos)
    assert parse_token(token.encode()) == token
    assert parse_token(node.encode()) == node
    assert node.is_hostlink == (enclave == OWN_ENCLAVE)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "@ros2_lv",
        "ros2_lv/0/aa/0/0/NN/%/%/listener",
        "@ros2_lv/x/aa/0/0/NN/%/%/listener",
        "@ros2_lv/0/aa/-1/0/NN/%/%/listener",
        "@ros2_lv/0/aa/0/\u0661/NN/%/%/listener",
        "@ros2_lv/0/aa/0/0/XX/%/%/listener",
        "@ros2_lv/0/aa/0/0/NN/%/%/",
        "@ros2_lv/0/aa/0/0/NN/%/%/2listener",
        "@ros2_lv/0/aa/0/0/NN/%/%/list\x1bener",
        "@ros2_lv/0/aa/0/0/MP/%/%/talker",
        f"{PUBLISHER.partition('/std_msgs')[0]}/std_msgs::String/{STRING_HASH}/::,7:,:,:,,",
        f"{PUBLISHER.rpartition('/')[0]}/no_quality",
        f"{PUBLISHER.rpartition('/')[0]}/x::,7:,:,:,,",
        PUBLISHER.replace("%chatter", "chatter"),
        PUBLISHER.replace("%chatter", "%chat%%ter"),
        PUBLISHER + "/" * 3000,
        "@ros2_lv/" + "9" * 30 + "/aa/0/0/NN/%/%/listener",
    ],
)
def test_malformed_token_is_refused(text: str) -> None:
    assert parse_token(text) is None


@given(st.text(alphabet="@ros2_lv/0aNMPS%:,-9", max_size=120))
def test_any_text_is_a_token_or_none(text: str) -> None:
    parse_token(text)
    parse_token(f"@ros2_lv/0/aa/0/1/MP/{text}")


def test_a_token_of_a_type_with_buffers_has_one_part_more() -> None:
    token = parse_token(f"{PUBLISHER}/backends:cpu:")
    assert token == parse_token(PUBLISHER)


def test_the_gid_is_the_hash_of_the_token_low_half_first() -> None:
    assert (
        gid_of("").hex() == "7f498d4624c30160d8984701d306aa99"
    )  # XXH3-128 of nothing is 99aa06d3014798d86001c324468d497f
    assert len({gid_of(LISTENER), gid_of(PUBLISHER), gid_of(SUBSCRIPTION)}) == 3


@pytest.mark.parametrize(
    ("qos", "text"),
    [
        (Qos(), "::,10:,:,:,,"),
        (LATCHED, ":1:,1:,:,:,,"),
        (COMMANDS, "2::,1:,:,:,,"),
        (Qos(depth=DEFAULT_DEPTH), "::,:,:,:,,"),
        (Qos(depth=None), "::2,:,:,:,,"),
    ],
)
def test_a_quality_leaves_out_what_is_usual(qos: Qos, text: str) -> None:
    assert encode_qos(qos) == text
    assert decode_qos(text) == qos


@pytest.mark.parametrize("text", ["1:2:1,10:,:,:,,", "1:2:1,10:5,0:7,1:1,9223372036,854775807"])
def test_a_quality_may_be_written_out(text: str) -> None:
    assert decode_qos(text) == Qos(depth=10)


def test_a_depth_is_bounded() -> None:
    decoded = decode_qos("::,99999999999999999999:,:,:,,")
    assert decoded is not None
    assert decoded.depth == 1_000_000
    assert decode_qos("::,0:,:,:,,") == Qos(depth=DEFAULT_DEPTH)


@given(qualities)
def test_a_quality_that_is_written_is_read(qos: Qos) -> None:
    assert decode_qos(encode_qos(qos)) == qos


def test_keys_of_data_keep_the_slashes_of_a_name() -> None:
    assert (
        data_key(0, "/chatter", "std_msgs/msg/String", STRING_HASH)
        == f"0/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
    )
    assert (
        data_key(2, "/robot1/chatter", "std_msgs/msg/String", "X") == "2/robot1/chatter/std_msgs::msg::dds_::String_/X"
    )


def test_names_of_actions_are_hidden() -> None:
    assert is_hidden("/drive/_action/status")
    assert not is_hidden("/robot_0/odom")


@given(names)
def test_mangling_is_undone(name: str) -> None:
    assert "/" not in mangle(name)
    assert demangle(mangle(name)) == name
