"""A rospy program for the tests, on the system's Python: it does what its first word names, one JSON object a line.

listen TOPIC TYPE            every message: its fields, and when it came
talk TOPIC TYPE YAML HZ      publish; HZ 0: once, latched; -1: as fast as it can
drive TOPIC SPEED HZ         velocities; a line on standard input is the next speed
serve SERVICE TYPE YAML      answer every call so
call SERVICE TYPE YAML       call it once
send TOPIC HZ COUNT          Float64s, each with the time at which it was published
receive TOPIC COUNT          how long each of them took, in milliseconds
idle                         nothing
"""

import json
import sys
import threading
import time

import genpy
import roslib.message
import rospy
import std_msgs.msg
import yaml
from geometry_msgs.msg import Twist


def report(event, **facts):
    sys.stdout.write(json.dumps({"event": event, **facts}) + "\n")
    sys.stdout.flush()


def fields_of(message):
    return yaml.safe_load(str(message)) or {}


def message_class(name):
    return roslib.message.get_message_class(name)


def filled(made, text):
    genpy.message.fill_message_args(made, [yaml.safe_load(text) or {}])
    return made


def listen(topic, type_name):
    rospy.Subscriber(
        topic,
        message_class(type_name),
        lambda message: report(
            "message", fields=fields_of(message), at_s=time.time(), by=message._connection_header["callerid"]
        ),
    )
    report("ready")
    rospy.spin()


def talk(topic, type_name, text, hz):
    kind = message_class(type_name)
    publisher = rospy.Publisher(topic, kind, queue_size=100, latch=float(hz) == 0, tcp_nodelay=True)
    made = filled(kind(), text)
    report("ready")
    if float(hz) == 0:
        publisher.publish(made)
        rospy.spin()
    while not rospy.is_shutdown():
        publisher.publish(made)
        if float(hz) > 0:
            time.sleep(1 / float(hz))


def drive(topic, speed, hz):
    publisher = rospy.Publisher(topic, Twist, queue_size=1, tcp_nodelay=True)
    wanted = [float(speed)]

    def read():
        for line in sys.stdin:
            wanted[0] = float(line)

    threading.Thread(target=read, daemon=True).start()
    report("ready")
    while not rospy.is_shutdown():
        twist = Twist()
        twist.linear.x = wanted[0]
        publisher.publish(twist)
        time.sleep(1 / float(hz))


def serve(service, type_name, text):
    kind = roslib.message.get_service_class(type_name)

    def answer(request):
        report("called", fields=fields_of(request))
        return filled(kind._response_class(), text)

    rospy.Service(service, kind, answer)
    report("ready")
    rospy.spin()


def call(service, type_name, text):
    kind = roslib.message.get_service_class(type_name)
    report("ready")
    rospy.wait_for_service(service, timeout=10)
    began_s = time.time()
    try:
        answer = rospy.ServiceProxy(service, kind)(filled(kind._request_class(), text))
        report("answered", fields=fields_of(answer), seconds=time.time() - began_s)
    except rospy.ServiceException as error:
        report("failed", reason=str(error))


def send(topic, hz, count):
    publisher = rospy.Publisher(topic, std_msgs.msg.Float64, queue_size=10, tcp_nodelay=True)
    report("ready")
    while not publisher.get_num_connections():
        time.sleep(0.05)
    time.sleep(0.5)
    for _ in range(int(count)):
        publisher.publish(time.time())
        time.sleep(1 / float(hz))
    report("sent")
    rospy.spin()


def receive(topic, count):
    found = []
    has_all = threading.Event()

    def note(message):
        found.append((time.time() - message.data) * 1000)
        if len(found) >= int(count):
            has_all.set()

    rospy.Subscriber(topic, std_msgs.msg.Float64, note, tcp_nodelay=True)
    report("ready")
    has_all.wait()
    report("measured", ms=found)


def idle():
    report("ready")
    rospy.spin()


def main():
    word, *arguments = sys.argv[1:]
    name = arguments.pop() if arguments and arguments[-1].startswith("name=") else "name=" + word
    rospy.init_node(name[5:], anonymous=name == "name=" + word, disable_signals=False)
    {f.__name__: f for f in (listen, talk, drive, serve, call, send, receive, idle)}[word](*arguments)


if __name__ == "__main__":
    main()
