"""ROS 2 over Zenoh with a daemon: a node of zenoh-ros2-sdk in its own process, and one written from the documents.

The second one signs as rmw_zenoh_cpp does, by the hash of its token; the SDK draws its gids.
"""

import asyncio
import contextlib
import json
import struct
import sys
import time
from asyncio.subprocess import PIPE
from collections import Counter
from collections.abc import AsyncIterator
from dataclasses import dataclass, field, replace
from typing import Any

import xxhash
import zenoh
import zenoh.ext

from hostlink.components.zenoh.rmw_bridge import RmwBridge, ros2_bridged
from hostlink.components.zenoh.session import ZenohSession, opened
from hostlink.components.zenoh.settings import ZenohSettings
from hostlink.core.components import hosted
from hostlink.core.config import Config, LinkConfig
from tests.support.daemon import Daemon, daemon
from tests.support.fork_server import Child, Program, shared, start
from tests.support.process import free_port
from tests.support.waiting import TIMEOUT_S

PEER = shared(Program("rmw_peer", "../clients/rmw_peer.py"))
TWIST = "geometry_msgs/msg/Twist"
TWIST_KEY = "geometry_msgs::msg::dds_::Twist_/RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
STRING = "std_msgs/msg/String"
STRING_KEY = "std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


@dataclass
class Bridged:
    """A daemon that is a node of ROS 2, at this address of Zenoh's."""

    daemon: Daemon
    session: ZenohSession
    bridge: RmwBridge
    address: str


@contextlib.asynccontextmanager
async def bridged(config: Config | None = None, **settings: Any) -> AsyncIterator[Bridged]:
    """A daemon with ROS 2 that waits for silent devices; other daemons and nodes find it by its address alone."""
    patient = replace(config or Config(), link=LinkConfig(silence_timeout_s=None, idle_timeout_s=None))
    address = f"127.0.0.1:{free_port()}"
    zenoh_config = replace(
        ZenohSettings(ros2=True, listen=(f"tcp/{address}",), multicast=False, name="test-host"), **settings
    )
    async with (
        daemon(patient) as running,
        opened(zenoh_config, running.hub.isolation.around) as session,
        hosted(running.hub, "zenoh", Counter()) as host,
        ros2_bridged(host, session, zenoh_config) as bridge,
    ):
        yield Bridged(running, session, bridge, address)


@dataclass
class Ros2Peer:
    """`tests/clients/rmw_peer.py` while it runs."""

    process: Child
    lines: list[dict[str, Any]] = field(default_factory=list)

    async def send(self, op: str, **arguments: Any) -> None:
        """A command without an answer."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"op": op, **arguments}).encode() + b"\n")
        await self.process.stdin.drain()

    async def request(self, op: str, answer: str, **arguments: Any) -> Any:
        """A command, and what its answer has by this name."""
        await self.send(op, **arguments)
        return await self.read(answer)

    async def read(self, name: str) -> Any:
        """Read lines up to one with this name. Return its value."""
        assert self.process.stdout is not None
        async with asyncio.timeout(TIMEOUT_S):
            while line := await self.process.stdout.readline():
                self.lines.append(json.loads(line))
                if name in self.lines[-1]:
                    return self.lines[-1][name]
        raise EOFError(f"the peer ended: {self.lines[-5:]}")


@contextlib.asynccontextmanager
async def ros2_peer(address: str, *, mode: str = "peer") -> AsyncIterator[Ros2Peer]:
    """A node of zenoh-ros2-sdk that is connected to this address."""
    words = ("--connect", address, "--mode", mode)
    process = await start(*words, program=PEER, given=None, stdout=PIPE)
    peer = Ros2Peer(process)
    try:
        assert await peer.read("ready")
        yield peer
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()


class Talker:
    """A publisher as rmw_zenoh_cpp declares one: token, then data that is signed by the token's hash."""

    def __init__(self, session: Any, topic: str, type_key: str, *, is_latched: bool = False) -> None:
        """`type_key`: the two last parts of the key; `is_latched`: its durability is transient local, of depth 1."""
        qos = ":1:,1:,:,:,," if is_latched else "::,10:,:,:,,"
        self.key = f"0/{topic.strip('/')}/{type_key}"
        mangled = topic.replace("/", "%")
        token = f"@ros2_lv/0/{session.info.zid()}/0/1/MP/%/%/talker/{mangled}/{type_key}/{qos}"
        digest = xxhash.xxh3_128(token.encode())
        low, high = digest.intdigest() & (2**64 - 1), digest.intdigest() >> 64
        self.gid = struct.pack("<QQ", low, high)
        self.session, self.sequence_number = session, 0
        self._publisher = (
            zenoh.ext.declare_advanced_publisher(
                session,
                self.key,
                cache=zenoh.ext.CacheConfig(1),
                publisher_detection=True,
                sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5),
            )
            if is_latched
            else session.declare_publisher(self.key, congestion_control=zenoh.CongestionControl.BLOCK)
        )
        self._token = session.liveliness().declare_token(token)

    @property
    def has_subscribers(self) -> bool:
        """Whether a subscriber of the key is known in this session."""
        return bool(self._publisher.matching_status)

    def put(self, data: bytes, *, age_s: float = 0.0, attachment: bytes | None = None) -> None:
        """`age_s`: by how much the time of its source is earlier."""
        self.sequence_number += 1
        source_ns = time.time_ns() - int(age_s * 1e9)
        signed = struct.pack("<qqB", self.sequence_number, source_ns, 16) + self.gid
        self._publisher.put(data, attachment=signed if attachment is None else attachment)

    def drive(self, linear_m_s: float, *, age_s: float = 0.0) -> None:
        self.put(twist(linear_m_s), age_s=age_s)

    def close(self) -> None:
        """Withdraw the token; the session stays."""
        self._token.undeclare()


def twist(linear_m_s: float) -> bytes:
    """CDR."""
    return b"\0\1\0\0" + struct.pack("<6d", linear_m_s, 0, 0, 0, 0, 0)


@contextlib.asynccontextmanager
async def zenoh_session(*addresses: str) -> AsyncIterator[Any]:
    """A session of Zenoh in the test's own process, connected to these addresses."""
    config = zenoh.Config()
    for key, value in {
        "mode": "peer",
        "connect/endpoints": [f"tcp/{address}" for address in addresses],
        "scouting/multicast/enabled": False,
        "listen/endpoints": [],
        "timestamping/enabled": True,
    }.items():
        config.insert_json5(key, json.dumps(value))
    session = await asyncio.to_thread(zenoh.open, config)
    try:
        yield session
    finally:
        await asyncio.to_thread(session.close)


@contextlib.asynccontextmanager
async def router(address: str = "") -> AsyncIterator[tuple[str, asyncio.subprocess.Process]]:
    """A router of Zenoh in a process of its own, and its address."""
    address = address or f"127.0.0.1:{free_port()}"
    text = (
        "import json, sys, time, zenoh\n"
        "config = zenoh.Config()\n"
        "config.insert_json5('mode', json.dumps('router'))\n"
        f"config.insert_json5('listen/endpoints', json.dumps(['tcp/{address}']))\n"
        "config.insert_json5('scouting/multicast/enabled', 'false')\n"
        "with zenoh.open(config):\n"
        "    print('ready', flush=True)\n"
        "    time.sleep(600)\n"
    )
    process = await asyncio.create_subprocess_exec(sys.executable, "-c", text, stdout=PIPE)
    try:
        assert process.stdout is not None
        async with asyncio.timeout(TIMEOUT_S):
            assert await process.stdout.readline() == b"ready\n"
        yield address, process
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()
