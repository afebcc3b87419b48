"""ROSSERIAL: the protocol of rosserial devices, as listeners and links use it."""

from collections.abc import Callable
from functools import partial
from typing import ClassVar

from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.frame import (
    HEADER,
    MAX_PAYLOAD_BYTES,
    OVERHEAD_BYTES,
    SYNC,
    SYNC_WORD,
    TOPICS_REQUEST,
    Frame,
    Id,
    byte_sum,
)
from hostlink.core.protocol.rosserial.session import NAME, Session
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.protocol.rosserial.topic_table import MAX_TOPICS
from hostlink.core.protocol.session import DeviceProtocol, DeviceSession

MAX_HEADS = 8  # false frame starts that are examined, so that the work is bounded


class Rosserial(DeviceProtocol):
    """rosserial, as rosserial_arduino's ros_lib and hostlink's own library speak it."""

    name: ClassVar[str] = NAME
    invitation: ClassVar[bytes] = TOPICS_REQUEST  # a silent device of a datagram port answers it

    def session(
        self, catalog: Catalog, *, uart_bytes_s: int | None = None, max_topics: int = MAX_TOPICS, is_lossy: bool = False
    ) -> DeviceSession:
        """Create the session of a new connection."""
        check = partial(check_type, catalog)
        return Session(check=check, uart_bytes_s=uart_bytes_s, max_topics=max_topics, is_lossy=is_lossy)

    def is_greeting(self, data: bytes) -> bool:
        """Whether a datagram contains a whole frame."""
        return has_frame(data)

    def host_reader(self) -> Callable[[bytes], int]:
        """Return a reader of a captured host's bytes, which counts topic requests."""
        stream = FrameStream(limit_bytes=MAX_PAYLOAD_BYTES)
        return lambda data: sum(isinstance(each, Frame) and each.topic_id == Id.PUBLISHER for each in stream.feed(data))


ROSSERIAL = Rosserial()


def check_type(catalog: Catalog, info: DeviceEndpoint) -> int | None:
    """Return the fixed payload size of an endpoint; None if it varies or the type is unknown.

    Raises:
        WrongType: the md5 sum is wrong.
    """
    checks = {
        EndpointKind.PUBLISHER: catalog.check_message,
        EndpointKind.SUBSCRIBER: catalog.check_message,
        EndpointKind.SERVICE_SERVER_PUBLISHER: catalog.check_response,
        EndpointKind.SERVICE_SERVER_SUBSCRIBER: catalog.check_request,
        EndpointKind.SERVICE_CLIENT_PUBLISHER: catalog.check_request,
        EndpointKind.SERVICE_CLIENT_SUBSCRIBER: catalog.check_response,
    }
    found = checks[info.kind](info.name, info.type, info.md5)
    return None if found is None else found.fixed_bytes


def has_frame(data: bytes) -> bool:
    """Whether the data contains a whole frame at any offset. A UART bridge over UDP cuts the stream anywhere."""
    at = -1
    for _ in range(MAX_HEADS):
        at = data.find(SYNC, at + 1)
        if at < 0:
            return False
        if _is_frame(data, at):
            return True
    return False


def _is_frame(data: bytes, at: int) -> bool:
    """Whether a whole frame begins at the offset."""
    if len(data) < at + OVERHEAD_BYTES:
        return False
    sync, size, length_check, topic_id = HEADER.unpack_from(data, at)
    end = at + HEADER.size + size
    if sync != SYNC_WORD or length_check != ~(size + (size >> 8)) & 0xFF or len(data) <= end:
        return False
    payload = memoryview(data)[at + HEADER.size : end]
    return bool(data[end] == ~(topic_id + (topic_id >> 8) + byte_sum(payload)) & 0xFF)
