"""XML-RPC as ROS 1 has it, and bodies that must not be read."""

import re
import xmlrpc.client
from datetime import datetime
from http.client import HTTPException, RemoteDisconnected

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.ros1.xml_rpc import (
    CALL_TIMEOUT_S,
    MAX_ANSWER_BYTES,
    BadXml,
    CallRefused,
    EarlyMaster,
    Unreachable,
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


# -- calls of the master before the daemon runs -----------------------------------------------------------------------


class FakeConnection:
    """HTTP connection to a master. `answers`: bodies, or errors, of one request after the other."""

    def __init__(self, answers: list[bytes | Exception]) -> None:
        self.answers, self.closed = answers, 0
        self.requests: list[tuple[str, str, bytes]] = []

    def request(self, method: str, path: str, body: bytes, headers: dict[str, str]) -> None:
        assert headers["Content-Type"] == "text/xml"
        self.requests.append((method, path, body))

    def getresponse(self) -> "FakeConnection":
        return self

    def read(self, most: int) -> bytes:
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer[:most]

    def close(self) -> None:
        self.closed += 1


def early_master(*answers: bytes | Exception, uri: str = "http://master:11311/") -> tuple[EarlyMaster, FakeConnection]:
    made, connection = EarlyMaster(uri, "/hostlink"), FakeConnection(list(answers))
    made._connection.close()
    made._connection = connection  # type: ignore[assignment]
    return made, connection


@pytest.mark.parametrize(
    ("uri", "host", "port", "path"),
    [
        ("http://robot:7/ros/", "robot", 7, "/ros/"),
        ("http://robot", "robot", 11311, "/"),
        ("http://[::1]:7", "::1", 7, "/"),
    ],
)
def test_address_of_the_master_has_a_default_port_and_path(uri: str, host: str, port: int, path: str) -> None:
    made = EarlyMaster(uri, "/hostlink")
    assert (made._connection.host, made._connection.port, made._path) == (host, port, path)
    assert made._connection.timeout == CALL_TIMEOUT_S
    made.close()


def test_early_call_has_the_name_of_the_node_and_returns_the_value() -> None:
    made, connection = early_master(encode_answer(1, "", ["/a"]), encode_answer(1, "", 0))
    assert made.call("getSystemState") == ["/a"]
    assert made.call("deleteParam", "/x") == 0
    ((method, path, first), (_, _, second)) = connection.requests
    assert (method, path, decode_call(first)) == ("POST", "/", ("getSystemState", ("/hostlink",)))
    assert decode_call(second) == ("deleteParam", ("/hostlink", "/x"))
    made.close()
    assert connection.closed == 1


@pytest.mark.parametrize("error", [RemoteDisconnected(), ConnectionResetError(), BrokenPipeError()])
def test_early_call_is_repeated_once_after_a_closed_connection(error: Exception) -> None:
    made, connection = early_master(error, encode_answer(1, "", 7))
    assert (made.call("getPid"), len(connection.requests), connection.closed) == (7, 2, 1)
    made, connection = early_master(error, error)
    with pytest.raises(Unreachable):
        made.call("getPid")
    assert len(connection.requests) == 2


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (TimeoutError(), f"no answer within {CALL_TIMEOUT_S:g} s"),
        (OSError(113, "No route to host"), "No route to host"),
        (OSError("of no number"), "of no number"),
        (HTTPException(), "HTTPException"),
        (b"no xml", "ExpatError"),
        (bytes(MAX_ANSWER_BYTES + 1), f"an answer of more than {MAX_ANSWER_BYTES} bytes"),
    ],
)
def test_early_call_without_an_answer_has_a_readable_reason(answer: bytes | Exception, reason: str) -> None:
    made, connection = early_master(answer)
    with pytest.raises(Unreachable, match=re.escape(reason)):
        made.call("getPid")
    assert (len(connection.requests), connection.closed) == (1, 1)


def test_early_call_that_the_master_refuses_keeps_the_connection() -> None:
    made, connection = early_master(encode_answer(-1, "unknown node", 0))
    with pytest.raises(CallRefused, match="unknown node"):
        made.call("lookupNode", "/x")
    assert connection.closed == 0
