"""DeviceProtocol and DeviceSession: what a protocol gets that has no memory, no node and no ping."""

from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.rosserial.frame import SYNC
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL

CATALOG = Catalog()


def test_session_of_a_device_that_announces_itself_again_has_no_memory() -> None:
    session = ROSSERIAL.session(CATALOG)
    assert (session.memory_version, session.memory(), session.is_recalled, session.kept_bytes) == (0, "", False, 0)
    assert ROSSERIAL.resumed(CATALOG, "anything").protocol == session.protocol


def test_session_without_a_node_is_captured_by_the_name_of_its_protocol() -> None:
    session = ROSSERIAL.session(CATALOG)
    assert (session.node, session.captured_as) == ("", "rosserial")


def test_protocol_without_a_ping_answers_none_and_is_found_by_its_greeting() -> None:
    frame = SYNC + bytes(10)
    assert ROSSERIAL.answer_ping(frame) == b""
    assert not ROSSERIAL.is_of_other_host(frame)
    assert ROSSERIAL.is_in(frame) is ROSSERIAL.is_greeting(frame)
