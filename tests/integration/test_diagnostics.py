"""/diagnostics, as roslibpy reads it."""

import asyncio
import threading
import time
from typing import Any
from urllib.parse import urlsplit

import pytest
import roslibpy

from hostlink.core.config import Config, LinkConfig, RobotConfig, SerialConfig
from hostlink.core.hub.diagnostics_topic import INTERVAL_S, TOPIC, TYPE, Level
from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.waiting import expect

OK, ERROR = int(Level.OK), int(Level.ERROR)


@pytest.mark.long
async def test_roslibpy_reads_it() -> None:
    config = Config(robots={"robot_0": RobotConfig()}, link=LinkConfig(), serial=(SerialConfig(path="/dev/none"),))
    async with daemon(config) as host, fake_device(host.tcp, robot_topics()) as device:
        await device.send(pose(1.0))
        await expect(lambda: host.hub.robots.find("robot_0").link is not None)
        await asyncio.sleep(1.5 * INTERVAL_S)
        assert host.hub.topics.find(TOPIC).messages == 0  # no client and no part of the daemon subscribes yet
        arrays = await asyncio.to_thread(_read_with_roslibpy, host.url)
    statuses = {status["name"]: status for array in arrays for status in array["status"]}
    assert statuses["hostlink: robot_0 link"]["hardware_id"] == "127.0.0.1"
    assert statuses["hostlink: daemon"]["level"] == OK
    assert statuses["hostlink: port /dev/none"]["level"] == ERROR
    assert abs(arrays[0]["header"]["stamp"]["secs"] - time.time()) < 60


def _read_with_roslibpy(url: str) -> list[dict[str, Any]]:
    address = urlsplit(url)
    ros = roslibpy.Ros(address.hostname, address.port)
    ros.run(timeout=10)
    arrays: list[dict[str, Any]] = []
    came = threading.Event()
    listener = roslibpy.Topic(ros, TOPIC, TYPE)
    listener.subscribe(lambda array: (arrays.append(array), came.set()))
    try:
        assert came.wait(10)
        return arrays
    finally:
        listener.unsubscribe()
        ros.close()
