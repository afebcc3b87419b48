"""An independent ROS 2 node, as a process: rclpy alone, nothing of hostlink. It does what lines of JSON on its standard
input say, and writes what it receives as lines of JSON on its standard output.
"""

import array
import importlib
import json
import sys
import threading
import time
from typing import Any

import rclpy
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import get_parameter_value, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

_LOCK = threading.Lock()


def write(**fields: Any) -> None:
    with _LOCK:
        sys.stdout.write(json.dumps(fields) + "\n")
        sys.stdout.flush()


def load(type_name: str) -> Any:
    package, kind, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), name)


def plain(value: Any) -> Any:
    """A message as JSON has it, by rclpy's own fields."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return list(value)
    if isinstance(value, array.array) or hasattr(value, "tolist"):
        return [plain(item) for item in value.tolist()]
    return [plain(item) for item in value] if isinstance(value, list | tuple) else value


def fill(message: Any, fields: dict[str, Any]) -> Any:
    for name, value in fields.items():
        before = getattr(message, name)
        is_message = hasattr(before, "get_fields_and_field_types")
        setattr(message, name, fill(before, value) if is_message else value)
    return message


def qos(request: dict[str, Any]) -> QoSProfile:
    return QoSProfile(
        depth=10,
        reliability=ReliabilityPolicy.BEST_EFFORT if request.get("best_effort") else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if request.get("latched") else DurabilityPolicy.VOLATILE,
    )


class Peer:
    """One node."""

    def __init__(self, name: str, arguments: list[str]) -> None:
        rclpy.init(args=arguments)
        self.node = rclpy.create_node(name)
        self.publishers: dict[str, Any] = {}
        self.repeated: dict[str, threading.Event] = {}
        self.group = ReentrantCallbackGroup()

    def subscribe(self, request: dict[str, Any]) -> None:
        topic = request["topic"]

        def receive(message: Any) -> None:
            now_s = time.monotonic()
            write(event="message", topic=topic, msg=plain(message), at_s=now_s)

        self.node.create_subscription(load(request["type"]), topic, receive, qos(request))

    def publish(self, request: dict[str, Any]) -> None:
        """Once, or `rate_hz` times a second until `unpublish`; with `stamp`, that field is the time of sending."""
        topic, cls = request["topic"], load(request["type"])
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(cls, topic, qos(request))
        if request.get("await_subscriber"):
            while not self.publishers[topic].get_subscription_count():
                time.sleep(0.01)
        stop = self.repeated[topic] = threading.Event()
        threading.Thread(target=self._repeat, args=(request, cls, stop), daemon=True).start()

    def _repeat(self, request: dict[str, Any], cls: Any, stop: threading.Event) -> None:
        message = fill(cls(), request.get("msg", {}))
        publisher, rate_hz = self.publishers[request["topic"]], request.get("rate_hz", 0)
        due_s = time.monotonic()
        while not stop.is_set():
            if stamp := request.get("stamp"):
                setattr(message, stamp, time.monotonic())
            publisher.publish(message)
            if not rate_hz:
                return
            due_s += 1 / rate_hz
            time.sleep(max(0.0, due_s - time.monotonic()))

    def silence(self, request: dict[str, Any]) -> None:
        self.repeated[request["topic"]].set()

    def unpublish(self, request: dict[str, Any]) -> None:
        self.silence(request)
        self.node.destroy_publisher(self.publishers.pop(request["topic"]))

    def serve(self, request: dict[str, Any]) -> None:
        """A service that answers with the same fields, and writes down each request."""

        def answer(asked: Any, response: Any) -> Any:
            write(event="request", service=request["service"], msg=plain(asked))
            return fill(response, request.get("msg", {}))

        self.node.create_service(load(request["type"]), request["service"], answer, callback_group=self.group)

    def call(self, request: dict[str, Any]) -> None:
        cls = load(request["type"])
        client = self.node.create_client(cls, request["service"], callback_group=self.group)
        is_there = client.wait_for_service(timeout_sec=request.get("timeout_s", 10.0))
        if not is_there:
            write(event="no_service", service=request["service"])
            return
        pending = client.call_async(fill(cls.Request(), request.get("msg", {})))
        pending.add_done_callback(
            lambda future: write(event="response", service=request["service"], msg=plain(future.result()))
        )

    def graph(self, _: dict[str, Any]) -> None:
        write(
            event="graph",
            topics={name: types[0] for name, types in self.node.get_topic_names_and_types()},
            services={name: types[0] for name, types in self.node.get_service_names_and_types()},
            nodes=self.node.get_node_names(),
        )

    def ends(self, request: dict[str, Any]) -> None:
        """The publishers and subscribers of a topic: their types and policies."""
        node, topic = self.node, request["topic"]
        found = {
            kind: [
                [end.node_name, end.topic_type, end.qos_profile.reliability.name, end.qos_profile.durability.name]
                for end in ends
            ]
            for kind, ends in (
                ("publishers", node.get_publishers_info_by_topic(topic)),
                ("subscribers", node.get_subscriptions_info_by_topic(topic)),
            )
        }
        write(event="ends", topic=topic, **found)

    def param(self, request: dict[str, Any]) -> None:
        """Call and write as `ros2 param VERB NODE ...` does, by the sources of ros2param (ros2cli, Kilted)."""
        verb, node, names = request["verb"], request["node"], request.get("names", [])
        if verb == "list":
            names = self._called(ListParameters, node, ListParameters.Request()).result.names
            write(event="param", verb=verb, lines=sorted(names))
            return
        if verb == "describe":
            found = self._called(DescribeParameters, node, DescribeParameters.Request(names=names)).descriptors
            write(event="param", verb=verb, lines=[f"{each.name}: {each.type}" for each in found])
            return
        if verb == "get":
            found = self._called(GetParameters, node, GetParameters.Request(names=names)).values
            write(event="param", verb=verb, lines=[plain(parameter_value_to_python(value)) for value in found])
            return
        texts = request.get("values", [])
        values = [get_parameter_value(text) for text in texts] if verb != "delete" else [ParameterValue()] * len(names)
        parameters = [ParameterMessage(name=name, value=value) for name, value in zip(names, values, strict=True)]
        if request.get("atomic"):
            asked = SetParametersAtomically.Request(parameters=parameters)
            results = [self._called(SetParametersAtomically, node, asked).result]
        else:
            results = self._called(SetParameters, node, SetParameters.Request(parameters=parameters)).results
        write(event="param", verb=verb, lines=[each.reason or each.successful for each in results])

    def _called(self, cls: Any, node: str, request: Any) -> Any:
        """The response of a service that each node has for its parameters."""
        name = "".join(f"_{char.lower()}" if char.isupper() else char for char in cls.__name__).lstrip("_")
        client = self.node.create_client(cls, f"{node}/{name}", callback_group=self.group)
        client.wait_for_service(timeout_sec=10.0)
        done, pending = threading.Event(), client.call_async(request)
        pending.add_done_callback(lambda _: done.set())
        done.wait()
        self.node.destroy_client(client)
        return pending.result()


def main() -> None:
    peer = Peer(sys.argv[1], sys.argv[2:])
    executor = SingleThreadedExecutor()  # the other misses messages for up to a second: docs/ros2.md
    executor.add_node(peer.node)
    threading.Thread(target=executor.spin, daemon=True).start()
    write(event="ready")
    for line in sys.stdin:
        request = json.loads(line)
        threading.Thread(target=getattr(peer, request.pop("op")), args=(request,), daemon=True).start()


if __name__ == "__main__":
    main()
