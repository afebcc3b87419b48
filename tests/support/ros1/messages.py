"""Definitions and payloads as ROS 1 reads them, on the system's Python: one JSON object in, one out.

In: "messages" and "services", the definition of each by its name; "payloads", by the name of a message its definition
with all that it contains, and payloads. Out: "md5" by genmsg, of each; "generated", by rospy's generator: the md5 sum
of the class and the payloads as it writes them again.
"""

import io
import json
import sys

import genpy.dynamic
import genpy.rostime
from genmsg import MsgContext, gentools, msg_loader


def md5_sums(messages, services):
    context = MsgContext.create_default()
    specs = {name: msg_loader.load_msg_from_string(context, text, name) for name, text in messages.items()}
    sums = {name: gentools.compute_md5(context, spec) for name, spec in specs.items()}
    for name, text in services.items():
        spec = msg_loader.load_srv_from_string(context, text, name)
        sums[name] = gentools.compute_md5(context, spec)
        sums[name + "Request"] = gentools.compute_md5(context, spec.request)
        sums[name + "Response"] = gentools.compute_md5(context, spec.response)
    return sums


def generated(name, definition, payloads):
    made = genpy.dynamic.generate_dynamic(name, definition)[name]
    again = []
    for payload in payloads:
        out = io.BytesIO()
        made().deserialize(bytes.fromhex(payload)).serialize(out)
        again.append(out.getvalue().hex())
    return {"md5": made._md5sum, "payloads": again}


genpy.rostime.TVal.canon = lambda _: None  # a device's nanoseconds may be more than a second
request = json.load(sys.stdin)
answer = {
    "md5": md5_sums(request["messages"], request["services"]),
    "generated": {name: generated(name, *each) for name, each in request["payloads"].items()},
}
json.dump(answer, sys.stdout)
