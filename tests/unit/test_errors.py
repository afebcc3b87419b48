"""The system's text of an error."""

import errno
import socket

import pytest

from hostlink.errors import system_text


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (ConnectionRefusedError(errno.ECONNREFUSED, "Connect call failed ('127.0.0.1', 1)"), "Connection refused"),
        (socket.gaierror(socket.EAI_NONAME, "Name or service not known"), "Name or service not known"),
        (OSError("Multiple exceptions: [Errno 111] ..."), "Multiple exceptions: [Errno 111] ..."),
    ],
)
def test_system_text_of_a_failed_connection_is_the_cause(error: OSError, text: str) -> None:
    assert system_text(error) == text
