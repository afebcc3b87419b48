"""ForeignServices: the services of all other nodes of ROS, provided here as they come and go."""

import asyncio

from hostlink.errors import HostlinkError
from hostlink.graphs.ros1.foreign_service import ForeignService, find_type
from hostlink.graphs.ros1.name_map import NameMap
from hostlink.graphs.ros1.parts import Parts, Spawned
from hostlink.graphs.ros1.tcpros import BadHeader
from hostlink.graphs.ros1.xml_rpc import Refused, Unreachable
from hostlink.logs import printable

MAX_SERVICES = 512
AT_ONCE = 4  # nodes whose types are requested
OF_EVERY_NODE = ("/get_loggers", "/set_logger_level")  # nobody calls them from here
RETRY_S = 10.0  # until a node that did not announce its type is tried again
_FAILURES = (Unreachable, Refused, BadHeader, HostlinkError, OSError, EOFError)


class ForeignServices:
    """By their names in ROS, each with the nodes that provide it: when those change, it is another service."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        self._services: dict[tuple[str, str], ForeignService] = {}
        self._tasks: dict[tuple[str, str], Spawned] = {}
        self._room = asyncio.Semaphore(AT_ONCE)

    def update(self, found: dict[str, str], names: NameMap) -> None:
        """`found`: the node that provides each service, by the service's name."""
        wanted = {
            (name, node)
            for name, node in found.items()
            if node != self._parts.node and not name.endswith(OF_EVERY_NODE)
        }
        for key in self._tasks.keys() - wanted:
            self._tasks.pop(key).cancel()
            self._close(key)
        for key in sorted(wanted - self._tasks.keys()):
            if len(self._tasks) >= MAX_SERVICES:
                self._parts.counts.crowded_out += 1
                break
            work = self._provide(key, names.to_hub(key[0]))
            self._tasks[key] = self._parts.spawn(work, name=f"ROS 1 service {printable(key[0])}")

    def close(self) -> None:
        """None is provided any more."""
        for key, task in self._tasks.items():
            task.cancel()
            self._close(key)
        self._tasks.clear()

    async def _provide(self, key: tuple[str, str], service: str) -> None:
        """Find its type, and provide it; try again until that is done."""
        name, node = key
        while True:
            try:
                async with self._room:
                    type_name, md5 = await find_type(self._parts, name)
                type_ = self._parts.hub.catalog.service(type_name)
                if type_ is not None and type_.md5 == md5:
                    self._services[key] = ForeignService(self._parts, service, name, type_)
                    return
                reason = f"no definition of {printable(type_name)} with md5 {printable(md5)}"
            except _FAILURES as error:
                reason = printable(str(error) or type(error).__name__, 200)
            self._parts.log_once("ros1.service_unusable", service=printable(name), node=printable(node), reason=reason)
            await asyncio.sleep(RETRY_S)

    def _close(self, key: tuple[str, str]) -> None:
        service = self._services.pop(key, None)
        if service is not None:
            service.close()
