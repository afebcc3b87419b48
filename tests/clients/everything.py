"""Everything that roslibpy offers, done once against a daemon: python everything.py HOST PORT.

Prints "cut" when its connections are to be cut, and at the end what it has seen as one JSON object.
"""

import json
import logging
import queue
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import roslibpy

WAIT_S = 15


def until(is_so: Callable[[], object]) -> None:
    """Wait for something that a callback does."""
    deadline_s = time.monotonic() + WAIT_S
    while not is_so():
        if time.monotonic() > deadline_s:
            raise TimeoutError
        time.sleep(0.02)


def exchange(speaker: Any, listener: Any, message: dict[str, Any]) -> Any:
    """Say it until it is heard."""
    heard: queue.Queue[Any] = queue.Queue()
    listener.subscribe(heard.put)
    while heard.empty():
        speaker.publish(roslibpy.Message(message))
        time.sleep(0.05)
    listener.unsubscribe()
    speaker.unadvertise()
    return heard.get(timeout=WAIT_S)


def drive(ros: Any, other: Any) -> Any:
    """Drive the robot by the names of ROS, until its odometry has moved."""
    newest: list[Any] = []
    odom = roslibpy.Topic(other, "/robot_0/odom", "nav_msgs/Odometry")
    odom.subscribe(newest.append)
    velocity = roslibpy.Topic(ros, "/robot_0/cmd_vel_stamped", "geometry_msgs/TwistStamped")
    velocity.advertise()
    message = {"header": roslibpy.Header(), "twist": {"linear": {"x": 0.3}}}
    while not newest or newest[-1]["pose"]["pose"]["position"]["x"] < 0.05:
        velocity.publish(roslibpy.Message(message))
        time.sleep(0.1)
    odom.unsubscribe()
    velocity.unadvertise()
    return newest[-1]


def refused(ros: Any) -> list[str]:
    """Drive a locked robot: what roslibpy logs, which has no handler for a status."""
    lines: list[str] = []
    noting = logging.Handler()
    noting.emit = lambda record: lines.append(record.getMessage())
    logging.getLogger("roslibpy").addHandler(noting)
    roslibpy.Service(ros, "/robot_0/lock", "std_srvs/Trigger").call(roslibpy.ServiceRequest(), timeout=WAIT_S)
    velocity = roslibpy.Topic(ros, "/robot_0/cmd_vel", "geometry_msgs/Twist")
    for _ in range(3):
        velocity.publish(roslibpy.Message({"linear": {"x": 0.3}}))
    velocity.unadvertise()
    # Its answer follows what hostlink sends of the velocities.
    roslibpy.Service(ros, "/robot_0/unlock", "std_srvs/Trigger").call(roslibpy.ServiceRequest(), timeout=WAIT_S)
    logging.getLogger("roslibpy").removeHandler(noting)
    return lines


def topics(ros: Any, other: Any) -> dict[str, Any]:
    """Both ways, latched, throttled."""
    observed: dict[str, Any] = {}
    pair = [roslibpy.Topic(client, "/chat", "std_msgs/String") for client in (ros, other)]
    observed["text"] = exchange(*pair, {"data": "hällo"})["data"]
    pair = [roslibpy.Topic(client, "stamped", "std_msgs/Header") for client in (ros, other)]
    observed["stamp"] = exchange(*pair, dict(roslibpy.Header(frame_id="f", stamp=roslibpy.Time(5, 6))))["stamp"]
    pair = [roslibpy.Topic(client, "/png", "std_msgs/String", compression="png") for client in (ros, other)]
    observed["png"] = exchange(*pair, {"data": "plain"})["data"]
    latched = roslibpy.Topic(ros, "/latched", "std_msgs/String", latch=True)
    latched.publish(roslibpy.Message({"data": "kept"}))
    ros.get_topics()
    heard: queue.Queue[Any] = queue.Queue()
    roslibpy.Topic(other, "/latched", "std_msgs/String").subscribe(heard.put)
    observed["latched"] = heard.get(timeout=WAIT_S)["data"]
    numbers: list[int] = []
    slow = roslibpy.Topic(other, "/fast", "std_msgs/Int32", throttle_rate=300, queue_length=1)
    slow.subscribe(lambda message: numbers.append(message["data"]))
    other.get_topics()
    fast = roslibpy.Topic(ros, "/fast", "std_msgs/Int32")
    for number in range(10):
        fast.publish(roslibpy.Message({"data": number}))
    until(lambda: len(numbers) == 2)
    return {**observed, "throttled": numbers}


def services(ros: Any, other: Any) -> dict[str, Any]:
    """Call a service as server and as client, and make a call that fails."""

    def answer(request: Any, response: Any) -> bool:
        response["success"], response["message"] = request["data"], f"got {request['data']}"
        return True

    offer = roslibpy.Service(ros, "/add", "std_srvs/SetBool")
    offer.advertise(answer)
    ros.get_services()
    call = roslibpy.Service(other, "/add", "std_srvs/SetBool")
    observed = {"answer": dict(call.call(roslibpy.ServiceRequest({"data": True}), timeout=WAIT_S))}
    offer.unadvertise()
    ros.get_services()
    refused: queue.Queue[Any] = queue.Queue()
    call.call(roslibpy.ServiceRequest({"data": True}), callback=refused.put, errback=refused.put)
    return {**observed, "refused": str(refused.get(timeout=WAIT_S))}


def rosapi(ros: Any) -> dict[str, Any]:
    """Every look at the graph, and parameters."""
    servers: queue.Queue[Any] = queue.Queue()
    ros.get_action_servers(servers.put)
    observed = {
        "time": ros.get_time(),
        "topics": ros.get_topics(),
        "topic_type": ros.get_topic_type("/robot_0/odometry"),
        "topics_for_type": ros.get_topics_for_type("geometry_msgs/Twist"),
        "services": ros.get_services(),
        "service_type": ros.get_service_type("/rosapi/topics"),
        "services_for_type": ros.get_services_for_type("rosapi/Topics"),
        "request_details": ros.get_service_request_details("rosapi/GetParam"),
        "response_details": ros.get_service_response_details("rosapi/GetTime"),
        "message_details": ros.get_message_details("nav_msgs/Odometry"),
        "nodes": ros.get_nodes(),
        "node_details": ros.get_node_details("/robot_0"),
        "action_servers": servers.get(timeout=WAIT_S),
    }
    gain = roslibpy.Param(ros, "/gain")
    gain.set([1, 2.5])
    observed["param"], observed["get_param"], observed["params"] = gain.get(), ros.get_param("/gain"), ros.get_params()
    ros.set_param("/gain", "x")
    observed["set_param"] = gain.get()
    ros.delete_param("/gain")
    return {**observed, "deleted": gain.get()}


def reconnect(ros: Any) -> bool:
    """A subscription is there again after the connection was cut, by roslibpy's own doing."""
    poses: list[Any] = []
    roslibpy.Topic(ros, "/robot_0/odometry", "geometry_msgs/Pose2D").subscribe(poses.append)
    until(lambda: poses)
    closed = threading.Event()
    ros.on("close", lambda _: closed.set())
    sys.stdout.write("cut\n")
    sys.stdout.flush()
    closed.wait(WAIT_S)
    poses.clear()
    until(lambda: poses)
    return True


def main() -> None:
    host, port = sys.argv[1], int(sys.argv[2])
    ros, other = roslibpy.Ros(host=host, port=port), roslibpy.Ros(host=host, port=port)
    for client in (ros, other):
        client.run(timeout=WAIT_S)
    ros.authenticate("mac", "client", "dest", "rand", 0, "level", 1)
    observed = {"odom": drive(ros, other), "locked": refused(ros)}
    observed |= {**topics(ros, other), **services(ros, other), "api": rosapi(ros)}
    observed["reconnected"] = reconnect(ros)
    sys.stdout.write(json.dumps(observed, default=dict))
    sys.stdout.flush()
    ros.terminate()


if __name__ == "__main__":
    main()
