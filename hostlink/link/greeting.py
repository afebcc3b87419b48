"""What begins a link where nothing connects: the first datagram of a device, and what makes a silent one send it."""

from hostlink.protocol.frame import HEADER, OVERHEAD_BYTES, SYNC, SYNC_WORD, TOPICS_REQUEST, byte_sum

INVITATION = TOPICS_REQUEST  # a device that was not requested its topics sends nothing
MAX_HEADS = 8  # that are tried: bytes that are none can look like many


def has_frame(data: bytes) -> bool:
    """Whether a whole frame stands in it, wherever it begins: what carries a UART's bytes cuts them anywhere."""
    at = -1
    for _ in range(MAX_HEADS):
        at = data.find(SYNC, at + 1)
        if at < 0:
            return False
        if _is_frame(data, at):
            return True
    return False


def _is_frame(data: bytes, at: int) -> bool:
    """Whether a whole frame begins there."""
    if len(data) < at + OVERHEAD_BYTES:
        return False
    sync, size, length_check, topic_id = HEADER.unpack_from(data, at)
    end = at + HEADER.size + size
    if sync != SYNC_WORD or length_check != ~(size + (size >> 8)) & 0xFF or len(data) <= end:
        return False
    payload = memoryview(data)[at + HEADER.size : end]
    return bool(data[end] == ~(topic_id + (topic_id >> 8) + byte_sum(payload)) & 0xFF)
