"""XML-RPC as ROS 1 has it, and bodies that must not be read."""

import xmlrpc.client
from datetime import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.graphs.ros1.xml_rpc import (
    BadXml,
    CallRefused,
    decode_answer,
    decode_call,
    encode_answer,
    encode_call,
    encode_fault,
)

BOMB = """<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;">]>
<methodCall><methodName>&b;</methodName></methodCall>"""


def test_a_call_is_read_as_it_was_written() -> None:
    body = encode_call("requestTopic", ("/listener", "/odom", [["TCPROS"]]))
    assert decode_call(body) == ("requestTopic", ("/listener", "/odom", [["TCPROS"]]))


@pytest.mark.parametrize("value", [0, [], ["TCPROS", "127.0.0.1", 4000], {"a": {"b": [1, 2.5, True, "ä<&>"]}}])
def test_an_answer_is_read_as_it_was_written(value: object) -> None:
    assert decode_answer(encode_answer(1, "done", value)) == value


@pytest.mark.parametrize("status", [0, -1])
def test_an_answer_without_success_is_a_refusal_with_its_text(status: int) -> None:
    with pytest.raises(CallRefused, match="not a publisher"):
        decode_answer(encode_answer(status, "not a publisher", 0))


def test_a_fault_is_a_refusal_with_its_text() -> None:
    with pytest.raises(CallRefused, match="broken"):
        decode_answer(encode_fault("broken"))


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"GET / HTTP/1.1",
        BOMB.encode(),
        BOMB.encode("utf-16"),
        BOMB.encode("utf-16-le"),
        b"<methodCall><!-- a --><methodName>a</methodName></methodCall>",
        b"\xff\xfe",
        b"<methodCall>",
        b"<methodCall><methodName>a</methodName><params><param><value><int>x</int></value></param></params></methodCall>",
        xmlrpc.client.dumps((1,), methodresponse=True).encode(),
    ],
)
def test_malformed_call_is_refused(body: bytes) -> None:
    with pytest.raises(BadXml):
        decode_call(body)


@given(st.binary(max_size=300))
def test_random_bytes_are_refused_as_a_call(body: bytes) -> None:
    with pytest.raises(BadXml):
        decode_call(body)


@pytest.mark.parametrize("found", [(1,), ([1, "two"],), (["1", "", 0],), ({"status": 1},)])
def test_malformed_answer_is_refused(found: tuple[object, ...]) -> None:
    with pytest.raises(BadXml):
        decode_answer(xmlrpc.client.dumps(found, methodresponse=True).encode())


@pytest.mark.parametrize("value", [2**40, None, object()])
def test_a_value_without_a_form_is_an_error(value: object) -> None:
    with pytest.raises(BadXml):
        encode_answer(1, "", value)


def test_a_date_of_the_parameter_server_is_read() -> None:
    value = datetime(2026, 1, 1)  # noqa: DTZ001 - XML-RPC has no zones
    assert decode_answer(xmlrpc.client.dumps(([1, "", value],), methodresponse=True).encode()) == value
