"""A node of ROS 2 over Zenoh by zenoh-ros2-sdk, an implementation of rmw_zenoh's protocol that is not hostlink's.

It reads commands as JSON lines and writes what happens as JSON lines. Definitions are those of rosbags, as files: the
SDK would fetch them from the internet.
"""

import argparse
import dataclasses
import json
import os
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2ServiceServer, ROS2Subscriber
from zenoh_ros2_sdk.discovery import get_topic_names_and_types
from zenoh_ros2_sdk.message_registry import get_registry
from zenoh_ros2_sdk.qos import QosDurability, QosProfile
from zenoh_ros2_sdk.session import ZenohSession
from zenoh_ros2_sdk.utils import compute_service_type_hash, get_type_hash, load_dependencies_recursive

SERVICES = {"std_srvs/srv/SetBool": ("bool data\n", "bool success\nstring message\n")}
STORE = get_typestore(Stores.ROS2_KILTED)


def write_definitions(folder: Path) -> None:
    """Every type of the distribution as a file."""
    for name in STORE.fielddefs:
        package, _, base = name.split("/")
        path = folder / package / "msg" / f"{base}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(STORE.generate_msgdef(name, ros_version=2)[0].partition("=" * 80)[0])
    for name, parts in SERVICES.items():
        package, _, base = name.split("/")
        path = folder / package / "srv" / f"{base}.srv"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("---\n".join(parts))


def made(name: str, fields: dict[str, Any]) -> Any:
    """A message of the SDK's own store; what is left out is zero."""
    store = ZenohSession.get_instance().store
    values = {}
    for key, desc in store.fielddefs[name][1]:
        value = fields.get(key)
        if desc[0] == Nodetype.NAME:
            values[key] = made(desc[1], value or {})
        elif desc[0] == Nodetype.BASE:
            values[key] = value if value is not None else "" if desc[1][0] == "string" else 0
        elif desc[1][0][0] == Nodetype.NAME:
            values[key] = [made(desc[1][0][1], each) for each in value or []]
        elif desc[1][0][1][0] == "string":
            values[key] = value or []
        else:
            length = desc[1][1] if desc[0] == Nodetype.ARRAY else 0
            values[key] = np.array(value or [0] * length, dtype=desc[1][0][1][0])
    return store.types[name](**values)


def plain(value: Any) -> Any:
    """For JSON."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {each.name: plain(getattr(value, each.name)) for each in dataclasses.fields(value) if each.init}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [plain(each) for each in value] if isinstance(value, list) else value


class Peer:
    """Publishers and subscriptions of one process."""

    def __init__(self, domain: int) -> None:
        self.domain = domain
        self.lock = threading.Lock()
        self.publishers: dict[str, Any] = {}
        self.streams: dict[str, threading.Event] = {}
        self.kept: list[Any] = []

    def write(self, **facts: Any) -> None:
        """Write one line of JSON."""
        with self.lock:
            sys.stdout.write(json.dumps(facts) + "\n")
            sys.stdout.flush()

    def publisher(self, topic: str, type_name: str, *, is_latched: bool = False) -> Any:
        """Return the publisher of a topic and type; it is made at its first use."""
        key = f"{topic} {type_name}"
        if key not in self.publishers:
            qos = QosProfile(durability=QosDurability.TRANSIENT_LOCAL) if is_latched else None
            self.publishers[key] = ROS2Publisher(topic, type_name, domain_id=self.domain, qos=qos)
        return self.publishers[key]

    def advertise(self, topic: str, type: str) -> None:  # noqa: A002 - the word of the command
        self.publisher(topic, type)
        self.write(advertised=topic)

    def publish(self, topic: str, type: str, fields: dict[str, Any]) -> None:  # noqa: A002
        publisher = self.publisher(topic, type)
        message = made(type, fields)
        publisher.publish(
            **{each.name: getattr(message, each.name) for each in dataclasses.fields(message) if each.init}
        )

    def stream(self, topic: str, type: str, fields: dict[str, Any], hz: float) -> None:  # noqa: A002
        """Publish again and again; 0 Hz: as fast as it can."""
        publisher, message, end = self.publisher(topic, type), made(type, fields), threading.Event()
        values = {each.name: getattr(message, each.name) for each in dataclasses.fields(message) if each.init}
        self.streams[topic] = end

        def run() -> None:
            while not end.is_set():
                publisher.publish(**values)
                if hz:
                    time.sleep(1 / hz)

        threading.Thread(target=run, daemon=True).start()
        self.write(streaming=topic)

    def end_stream(self, topic: str) -> None:
        self.streams.pop(topic).set()
        self.write(ended=topic)

    def unadvertise(self, topic: str, type: str) -> None:  # noqa: A002
        self.publishers.pop(f"{topic} {type}").close()
        self.write(unadvertised=topic)

    def echo(self, topic: str, type: str, is_latched: bool = False) -> None:  # noqa: A002
        qos = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1) if is_latched else None
        self.kept.append(
            ROS2Subscriber(
                topic,
                type,
                lambda message: self.write(topic=topic, message=plain(message)),
                domain_id=self.domain,
                qos=qos,
            )
        )
        self.write(subscribed=topic)

    def call(self, service: str, type: str, fields: dict[str, Any]) -> None:  # noqa: A002
        client = ROS2ServiceClient(service, type, domain_id=self.domain, timeout=10.0)
        answer = client.call(**fields)
        self.write(answer=None if answer is None else plain(answer))
        client.close()

    def serve(self, service: str) -> None:
        def answer(request: Any) -> Any:
            return server.response_msg_class(success=request.data, message="from ros 2")

        server = ROS2ServiceServer(service, "std_srvs/srv/SetBool", answer, domain_id=self.domain)
        self.kept.append(server)
        self.write(serving=service)

    def topics(self) -> None:
        self.write(topics=dict(get_topic_names_and_types(self.domain, timeout=2.0)))

    def tokens(self) -> None:
        replies = ZenohSession.get_instance().liveliness.get(f"@ros2_lv/{self.domain}/**", timeout=2.0)
        self.write(tokens=[str(reply.ok.key_expr) for reply in replies if reply.ok is not None])

    def hashes(self, types: list[str]) -> None:
        registry = get_registry()
        found = {}
        for name in types:
            text = registry.get_msg_file_path(name).read_text()
            found[name] = get_type_hash(name, text, load_dependencies_recursive(name, text, registry))
        services = {name: compute_service_type_hash(name, *parts) for name, parts in SERVICES.items()}
        self.write(hashes=found | services)


def main() -> None:
    """Until standard input ends."""
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--connect", required=True)
    arguments.add_argument("--domain", type=int, default=0)
    arguments.add_argument("--mode", default="peer")
    given = arguments.parse_args()
    host, _, port = given.connect.rpartition(":")
    os.environ["ZENOH_CONFIG_OVERRIDE"] = f'mode="{given.mode}";scouting/multicast/enabled=false'
    with tempfile.TemporaryDirectory() as folder:
        write_definitions(Path(folder))
        get_registry(folder)
        ZenohSession.get_instance(host, int(port))
        peer = Peer(given.domain)
        peer.write(ready=True)
        for line in sys.stdin:
            command = json.loads(line)
            getattr(peer, command.pop("op"))(**command)
        os._exit(0)  # sessions of Zenoh have threads that outlive it


if __name__ == "__main__":
    main()
