"""Latency of a message between a device and rclpy, compared with rclpy alone in the same run."""

import statistics

import pytest

from tools.bench_ros2 import MOST, measured

COUNT, LOST = 120, 3


@pytest.mark.alone
@pytest.mark.long
@pytest.mark.timeout(240)
async def test_a_message_is_as_quick_as_promised_both_ways() -> None:
    found = await measured(COUNT)
    yardstick_s = statistics.median(found["rclpy to rclpy"])
    for name in ("device to rclpy", "rclpy to device"):
        assert len(found[name]) >= COUNT - LOST, found
        assert statistics.median(found[name]) < MOST * yardstick_s, found
