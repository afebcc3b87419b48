"""The connection of a robot that the daemon hands to its guard; tests/unit/core/hub/test_gates.py has the rules."""

import os
import socket

from hostlink.cli.serve import running
from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import Config, TcpConfig
from tests.support.fake_device import fake_device, robot_topics
from tests.support.memory_hub import RecordingGuard, twist_zeros
from tests.support.waiting import expect

CONFIG = Config(tcp=TcpConfig(host="127.0.0.1", port=0)).with_tables(api=ApiConfig(port=0))


async def test_guard_has_the_connection_of_a_robot_from_its_appearance_to_its_end() -> None:
    guard = RecordingGuard()
    async with running(CONFIG, guard=guard) as (_, addresses):
        async with fake_device(addresses.tcp, robot_topics()) as device:
            await expect(lambda: guard.watched == {1: (twist_zeros(100), 512)})
            descriptor = guard.connections[1]()
            assert descriptor is not None
            with socket.socket(fileno=os.dup(descriptor)) as same:
                assert same.getpeername() == device.address
        await expect(lambda: guard.released == [1])
