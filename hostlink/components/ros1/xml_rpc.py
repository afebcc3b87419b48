"""XML-RPC as ROS 1 has it: calls, and answers of a status, a text and a value; blocking calls of the master."""

import http.client
import urllib.parse
import xmlrpc.client
from typing import Any

from hostlink.errors import system_text

SUCCESS, ERROR = 1, -1
MASTER_PORT = 11311  # of a master whose address names none
CALL_TIMEOUT_S = 3.0  # of a call
MAX_ANSWER_BYTES = 4 * 1024 * 1024  # the state of a graph of ten thousand topics
HEADERS = {"Content-Type": "text/xml", "Accept-Encoding": "identity"}

_NOT_IN_XML_RPC = ("\0", "<!")  # UTF-16, and what defines or hides something: no node of ROS sends it


class BadXml(Exception):
    """Body that is not a call or an answer of ROS."""


class CallRefused(Exception):
    """Answer with another status than success."""


class Unreachable(Exception):
    """No answer, a late one, or one that is not XML-RPC."""


def encode_call(method: str, arguments: tuple[Any, ...]) -> bytes:
    """Encode the body of a request.

    Raises:
        BadXml: an argument has no form in XML-RPC.
    """
    return _dumps(arguments, methodname=method)


def decode_call(body: bytes) -> tuple[str, tuple[Any, ...]]:
    """Decode method and arguments of a request.

    Raises:
        BadXml: the body is not a call.
    """
    arguments, method = _loads(body)
    if method is None:
        raise BadXml("no call")
    return method, arguments


def encode_answer(status: int, text: str, value: object) -> bytes:
    """Encode the body of an answer.

    Raises:
        BadXml: the value has no form in XML-RPC.
    """
    return _dumps(([status, text, value],), methodresponse=True)


def encode_fault(text: str) -> bytes:
    """Encode the answer to a malformed call."""
    return _dumps(xmlrpc.client.Fault(ERROR, text), methodresponse=True)


def decode_answer(body: bytes) -> Any:
    """Decode the value of an answer.

    Raises:
        CallRefused: its status is not success, or it is a fault.
        BadXml: the body is not an answer.
    """
    try:
        found, _ = _loads(body)
    except xmlrpc.client.Fault as fault:
        raise CallRefused(str(fault.faultString)) from fault
    match found:
        case ([int(status), text, value],):
            if status != SUCCESS:
                raise CallRefused(str(text))
            return value
    raise BadXml("no answer of a status, a text and a value")


def _dumps(content: Any, **options: Any) -> bytes:
    try:
        return xmlrpc.client.dumps(content, **options).encode()
    except (TypeError, OverflowError, RecursionError) as error:
        raise BadXml(str(error)) from error


def _loads(body: bytes) -> tuple[tuple[Any, ...], str | None]:
    """Parse a body. Entities are refused: they could turn a kilobyte into a gigabyte."""
    try:
        text = body.decode()
    except UnicodeDecodeError as error:
        raise BadXml("no UTF-8") from error
    if any(each in text for each in _NOT_IN_XML_RPC):
        raise BadXml("a document type, a comment, or no UTF-8")
    try:
        return xmlrpc.client.loads(text, use_builtin_types=True)
    except xmlrpc.client.Fault:
        raise
    except Exception as error:  # expat and the unmarshaller raise a dozen kinds for a malformed body
        raise BadXml(f"{type(error).__name__}: {error}") from error


class EarlyMaster:
    """Blocking calls of the master before the daemon runs, without the HTTP client that takes long to import."""

    def __init__(self, uri: str, node: str) -> None:
        where = urllib.parse.urlsplit(uri)
        host, port = where.hostname or "", where.port or MASTER_PORT
        self._connection = http.client.HTTPConnection(host, port, timeout=CALL_TIMEOUT_S)
        self._path, self._node = where.path or "/", node

    def close(self) -> None:
        self._connection.close()

    def call(self, method: str, *arguments: object) -> Any:
        """Return the value of the answer.

        Raises:
            Unreachable: the master did not answer.
            CallRefused: the master could not do it.
            BadXml: an argument has no form in XML-RPC.
        """
        body = encode_call(method, (self._node, *arguments))
        try:
            try:
                answer = self._post(body)
            except (http.client.RemoteDisconnected, ConnectionResetError, BrokenPipeError):  # closed after the last one
                self._connection.close()
                answer = self._post(body)
            return decode_answer(answer)
        except (http.client.HTTPException, OSError, BadXml, ValueError) as error:
            self._connection.close()
            raise Unreachable(reason_of(error)) from error

    def _post(self, body: bytes) -> bytes:
        self._connection.request("POST", self._path, body, HEADERS)
        answer = self._connection.getresponse().read(MAX_ANSWER_BYTES + 1)
        if len(answer) > MAX_ANSWER_BYTES:
            raise BadXml(f"an answer of more than {MAX_ANSWER_BYTES} bytes")
        return answer


def reason_of(error: Exception) -> str:
    """Return a reason that a person can read."""
    error = getattr(error, "os_error", error)  # of a ClientConnectorError, which has the number of it alone
    if isinstance(error, TimeoutError):
        return f"no answer within {CALL_TIMEOUT_S:g} s"
    return system_text(error) if isinstance(error, OSError) else str(error) or type(error).__name__
