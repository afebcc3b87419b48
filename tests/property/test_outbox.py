"""Outbox during an hour at full load."""

import pytest

from hostlink.core.protocol.outbox import RING_BYTES, Outbox
from hostlink.core.protocol.rosserial.session import CONTROL_FRAMES


@pytest.mark.slow
@pytest.mark.parametrize("uart_bytes_s", [960, 3840, 11520])
def test_outbox_at_full_load_is_exactly_as_fast_as_the_uart(uart_bytes_s: int) -> None:
    outbox = Outbox(CONTROL_FRAMES, uart_bytes_s=uart_bytes_s)
    now_s, sent_bytes = 0.0, 0
    while now_s < 3600:
        outbox.put_urgent(101, bytes(512))
        if outbox.pop_frame(now_s=now_s, wall_ns=0) is not None:
            sent_bytes += 512
        outbox.put_urgent(101, bytes(512))
        now_s += outbox.wait_s(now_s) or 0.0
    assert uart_bytes_s * 3600 <= sent_bytes <= RING_BYTES + uart_bytes_s * now_s + 512
