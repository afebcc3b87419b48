"""ScriptedDevice: a device in memory that announces any topics, each time that they are requested."""

import asyncio
import contextlib
from collections.abc import Sequence

from hostlink.core.hub.hub import Hub
from hostlink.core.link.link import Link
from hostlink.core.protocol.endpoint import DeviceEndpoint
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.rosserial.stream import FrameStream
from tests.support.memory_transport import memory_pair

ANNOUNCED_S = 0.1


class ScriptedDevice:
    """One connection to a hub that runs, in the loop that runs it."""

    def __init__(self, hub: Hub, infos: Sequence[DeviceEndpoint], *, address: str, peer: str | None = None) -> None:
        host_end, self._end = memory_pair(address=address)
        if peer is not None:
            host_end.peer = peer
        self.infos = list(infos)
        self.heard: list[tuple[float, Frame]] = []
        self.link: Link = hub.links.open(host_end, ROSSERIAL)
        self._stream = FrameStream()
        hub.spawn(hub.links.serve(self.link), name=f"link of {address}")
        self.task = asyncio.get_running_loop().create_task(self._listen(), name=f"device at {address}")

    def payloads(self, topic_id: int) -> list[bytes]:
        """Return the payloads that arrived on one of the device's topics."""
        return [frame.payload for _, frame in self.heard if frame.topic_id == topic_id]

    async def send(self, topic_id: int, payload: bytes) -> None:
        """Send a frame, if the host still receives it."""
        with contextlib.suppress(OSError):
            await self._end.send(encode(topic_id, payload))

    def write(self, data: bytes) -> None:
        """Send any bytes without waiting."""
        self._end.write(data)

    async def announce(self) -> None:
        """Announce them, requested or not. A device without any says nothing: its connection is dead."""
        for info in self.infos:
            await self.send(info.kind, encode_topic_info(info))
        if self.infos:
            await self.send(Id.TIME, bytes(8))

    async def is_announced(self) -> None:
        """Wait until the host has identified it after a connection."""
        await asyncio.sleep(ANNOUNCED_S)

    async def aclose(self) -> None:
        """Close the connection."""
        await self._end.aclose()
        await self.task

    async def _listen(self) -> None:
        with contextlib.suppress(OSError):
            while data := await self._end.receive():
                for frame in self._stream.feed(data):
                    assert isinstance(frame, Frame)
                    self.heard.append((asyncio.get_running_loop().time(), frame))
                    if frame.topic_id == Id.PUBLISHER:
                        await self.announce()
