"""Requests of hostile programs: rosbridge, WebSocket frames and HTTP, right and wrong. Bytes from dice, no socket."""

import json
import random
import struct
from typing import Any

import cbor2

from tests.support.chaos.names import (
    CLASHING_NAMES,
    HONEST,
    HONEST_ODOMETRY,
    HONEST_VELOCITY,
    HOSTILE_RAD_S,
    MESSAGE_TYPES,
    ROGUE_TOPICS,
    ROGUES,
    SERVICE_TYPES,
    SERVICES,
)

TEXT, BINARY, CLOSE, PING, PONG = 1, 2, 8, 9, 10
RIVAL_PRIORITY = 60  # below the honest program's
WRONG_VALUES: tuple[Any, ...] = (
    None, True, -1, 1e308, "", "\x00\x1b[2J", "x" * 2000, [], [[]], {}, {"op": {}}, 2**63, "\ud800", "é",
)  # fmt: skip
ROSAPI = (
    "topics", "topics_and_raw_types", "topics_for_type", "topic_type", "message_details", "services", "nodes",
    "node_details", "get_param_names", "get_param", "set_param", "delete_param", "get_time", "action_servers",
)  # fmt: skip
PATHS = (
    "/", "/healthz", "/readyz", "/metrics", "/api/robots", "/api/links", "/api/topics", "/api/clients", "/api/events",
    "/api/openapi.json", f"/api/robots/{HONEST}", f"/api/robots/{HONEST}/odometry", "/api/robots/rogue_0",
    f"/api/robots/{HONEST}/odometry/events", "/api/links/1/capture", "/api/links/1/capture/0", "/web/none.js",
    "/api/links/" + "9" * 4400 + "/capture", "/api/robots/%ff%00", "/api/robots/" + "a" * 7000, "/..%2f..%2fetc/passwd",
    "//", "/api/robots/rogue_0/velocity", "/api/robots/rogue_0/stop", "/api/robots/rogue_0/lock",
    "/api/robots/rogue_0/unlock", "/api/robots/rogue_0/odometry/reset", f"/api/robots/{HONEST}/stop", "/api/stop",
)  # fmt: skip
HANDSHAKE = (
    b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: c3R1Y2sgc3R1Y2sgc3R1Yw==\r\nSec-WebSocket-Version: 13\r\n"
)


# -- WebSocket --------------------------------------------------------------------------------------------------------


def ws_frame(data: bytes, kind: int = TEXT, *, is_last: bool = True, claim: int | None = None, flags: int = 0) -> bytes:
    """A client's frame, masked with zeros; `claim` is the length in its header."""
    size = len(data) if claim is None else claim
    head = bytes([(0x80 if is_last else 0) | flags | kind])
    if size < 126:
        head += bytes([0x80 | size])
    elif size < 1 << 16:
        head += bytes([0xFE]) + struct.pack(">H", size)
    else:
        head += bytes([0xFF]) + struct.pack(">Q", size)
    return head + bytes(4) + data


def operation(**fields: Any) -> bytes:
    """One rosbridge operation as a frame."""
    return ws_frame(json.dumps(fields).encode())


def draw_handshake(dice: random.Random) -> bytes:
    """Mostly what browsers send."""
    extra = dice.choice((
        b"", b"", b"", b"Sec-WebSocket-Protocol: rosbridge_v2\r\n", b"Sec-WebSocket-Protocol: nobody.knows\r\n",
        b"Sec-WebSocket-Extensions: permessage-deflate\r\n", b"Origin: http://127.0.0.1\r\n",
        b"X-Long: " + b"x" * 7000 + b"\r\n",
    ))  # fmt: skip
    return HANDSHAKE + extra + b"\r\n"


def draw_operation(dice: random.Random) -> bytes:
    """Draw an operation, valid in most cases. Only a rival drives or locks the honest robot."""
    fields = dice.choice(_OPERATIONS)(dice)
    while dice.random() < 0.2:
        key = dice.choice([*fields, "id", "msg", "args", "compression", "fragment_size"])
        fields[key] = dice.choice(WRONG_VALUES)
    if dice.random() < 0.1:
        return ws_frame(cbor2.dumps(_sayable(fields)), BINARY)
    text = json.dumps(fields)
    if dice.random() < 0.1:
        return b"".join(_pieces(text, dice))
    if dice.random() < 0.05:
        text = text[: dice.randrange(len(text))]
    return ws_frame(text.encode())


def _sayable(fields: dict[str, Any]) -> dict[str, Any]:
    return {key: "?" if value == "\ud800" else value for key, value in fields.items()}


def _pieces(text: str, dice: random.Random) -> list[bytes]:
    """rosbridge's own fragments; one may be missing or come twice."""
    size = max(1, len(text) // dice.randint(1, 8))
    parts = [text[at : at + size] for at in range(0, len(text), size)]
    made = [operation(op="fragment", id="f", data=part, num=at, total=len(parts)) for at, part in enumerate(parts)]
    return dice.choice((made, made[:-1], made + made[:1], made[::-1]))


def _topic(dice: random.Random) -> str:
    new = f"/new_{dice.randrange(99)}"
    return dice.choice((*ROGUE_TOPICS, "/chat", "/rogue_0/odom", "/honest/odom", "/tf", new))


def _type(dice: random.Random) -> str:
    return dice.choice(MESSAGE_TYPES)


def _subscribe(dice: random.Random) -> dict[str, Any]:
    made: dict[str, Any] = {"op": "subscribe", "topic": dice.choice((*CLASHING_NAMES, _topic(dice)))}
    if dice.random() < 0.5:
        made |= {"compression": dice.choice(("none", "png", "cbor", "cbor-raw", "lzw"))}
    if dice.random() < 0.5:
        made |= {"throttle_rate": dice.choice((0, 100, 10**9)), "queue_length": dice.choice((0, 1, 10**6))}
    return made | ({"fragment_size": dice.choice((1, 100, 10**6))} if dice.random() < 0.2 else {})


def _publish(dice: random.Random) -> dict[str, Any]:
    message: dict[str, Any] = dice.choice((
        {}, {"data": "x" * dice.choice((1, 1000, 300_000))}, {"linear": {"x": 0.3}, "angular": {"z": HOSTILE_RAD_S}},
        {"data": [1] * 1000}, {"header": {"stamp": {"secs": -1}}}, {"x": 1.0}, {"nobody": {"knows": []}},
    ))  # fmt: skip
    return {"op": "publish", "topic": _topic(dice), "type": _type(dice), "msg": message}


def _call(dice: random.Random) -> dict[str, Any]:
    service = dice.choice((*SERVICES[:2], "/none", *(f"/rosapi/{name}" for name in ROSAPI)))
    arguments = dice.choice(({}, [], ["x"], {"topic": "/tf"}, {"type": "geometry_msgs/Twist"}, {"name": "gain"}))
    return {"op": "call_service", "service": service, "args": arguments, "id": str(dice.randrange(9))}


_OPERATIONS = (
    _subscribe,
    _subscribe,
    _publish,
    _publish,
    _call,
    _call,
    lambda dice: {"op": "advertise", "topic": _topic(dice), "type": _type(dice), "latch": dice.random() < 0.3},
    lambda dice: {"op": "unadvertise", "topic": _topic(dice)},
    lambda dice: {"op": "unsubscribe", "topic": _topic(dice)},
    lambda dice: {"op": "advertise_service", "service": dice.choice(SERVICES), "type": dice.choice(SERVICE_TYPES)},
    lambda dice: {"op": "unadvertise_service", "service": dice.choice(SERVICES)},
    lambda dice: {"op": "service_response", "service": dice.choice(SERVICES), "id": "1", "values": {}, "result": True},
    lambda dice: {"op": "set_level", "level": dice.choice(("info", "none", "loud"))},
    lambda dice: {"op": "drive", "robot": "rogue_0", "linear": dice.random(), "angular": HOSTILE_RAD_S, "id": 1},
    lambda dice: {"op": dice.choice(("send_action_goal", "auth", "status", "x" * 500)), "action": "a"},
)


def draw_broken(dice: random.Random) -> bytes:
    """Frames that no WebSocket has, or that never end."""
    noise = dice.randbytes(dice.choice((3, 300)))
    return dice.choice((
        ws_frame(b"x" * 100, claim=1 << 62),
        ws_frame(b"x", claim=2 << 20),
        ws_frame(b"{", is_last=False) + ws_frame(b"x" * 50_000, 0, is_last=False),
        ws_frame(b"\xff\xfe\xfd"),
        ws_frame(noise, flags=0x40),
        ws_frame(noise, 3),
        ws_frame(noise, CLOSE),
        ws_frame(b"", PING) * 500,
        ws_frame(b"x" * 200, PING),
        ws_frame(b'{"op":' * 5000),
        b"\x81\x05hello",
        noise,
    ))  # fmt: skip


# -- what programs of a purpose send ----------------------------------------------------------------------------------


def flood_subscriptions(dice: random.Random) -> bytes:
    """Return subscriptions of flooded topics."""
    topics = dice.sample([*ROGUE_TOPICS, "/rosout", "/tf", HONEST_ODOMETRY, "/rogue_0/odometry"], dice.randint(1, 6))
    compression = dice.choice(("none", "none", "cbor", "cbor-raw", "png"))
    return b"".join(operation(op="subscribe", topic=topic, compression=compression) for topic in topics)


def publication(dice: random.Random) -> bytes:
    """Return a publication to a topic of a hostile device, or to one that the daemon derives."""
    leaf = dice.choice(("velocity_commands", "cmd_vel", "cmd_vel_stamped", "data", "odom"))
    name = f"/rogue_{dice.randrange(ROGUES)}/{leaf}"
    twist = {"linear": {"x": dice.uniform(-1, 1)}, "angular": {"z": HOSTILE_RAD_S}}
    type_name = dice.choice(("geometry_msgs/Twist", "geometry_msgs/TwistStamped", *MESSAGE_TYPES))
    message = {"twist": twist} if type_name.endswith("Stamped") else twist if type_name.endswith("Twist") else {}
    return operation(op="publish", topic=name, type=type_name, msg=message)


def rival_frame(dice: random.Random) -> bytes:
    """Drive the honest robot at a lower priority, by any of its topics."""
    velocity = {"linear": dice.uniform(-1, 1), "angular": HOSTILE_RAD_S}
    if dice.random() < 0.3:
        return operation(op="drive", robot=HONEST, priority=dice.choice((0, RIVAL_PRIORITY)), id=1, **velocity)
    topic = dice.choice((HONEST_VELOCITY, f"/{HONEST}/cmd_vel", HONEST_VELOCITY[1:]))
    twist = {"linear": {"x": velocity["linear"]}, "angular": {"z": HOSTILE_RAD_S}}
    return operation(op="publish", topic=topic, type="geometry_msgs/Twist", msg=twist, priority=RIVAL_PRIORITY)


def rival_request(dice: random.Random) -> bytes:
    """Drive the honest robot at a lower priority, by REST."""
    body = json.dumps({"linear": dice.uniform(-1, 1), "angular": HOSTILE_RAD_S, "priority": RIVAL_PRIORITY})
    return http("PUT", f"/api/robots/{HONEST}/velocity", body.encode())


# -- HTTP -------------------------------------------------------------------------------------------------------------


def http(method: str, path: str, body: bytes = b"", headers: bytes = b"") -> bytes:
    """A request as curl sends it."""
    length = b"Content-Length: %d\r\n" % len(body) if body or method in ("PUT", "POST") else b""
    return f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n".encode() + headers + length + b"\r\n" + body


def draw_http(dice: random.Random) -> bytes:
    """Right, wrong, cut or strange."""
    path = dice.choice(PATHS)
    method = dice.choice(("GET", "GET", "GET", "POST", "PUT", "DELETE", "OPTIONS", "HEAD", "BREW", "get"))
    if HONEST in path and path.endswith("/stop"):
        method = "GET"  # every program may stop a robot, but a robot that never moves shows no fault
    if path == "/api/stop" and method == "POST":
        method = "GET"
    body = dice.choice((b"", b"{}", b'{"linear": 0.1, "angular": -0.75}', b"[" * 5000, b"\xff" * 20, b"x" * 200_000))
    header = dice.choice((
        b"", b"", b"", b"Origin: http://\xff\r\n", b"Origin: http://[\r\n", b"Origin: null\r\n",
        b"Expect: 100-continue\r\n",
        b"Transfer-Encoding: chunked\r\n", b"Content-Length: 99999999\r\n", b"Authorization: Bearer \xff\r\n",
        b"X: " + b"y" * 9000 + b"\r\n", b"Cookie: a=b\r\n" * 200, b"Upgrade: websocket\r\nConnection: Upgrade\r\n",
        b"Range: bytes=0-\r\n", b"Content-Encoding: gzip\r\n",
    ))  # fmt: skip
    made = http(method, path, body, header)
    if dice.random() < 0.1:
        made = made.replace(b"Host: 127.0.0.1", dice.choice((b"Host: \xff", b"Host: evil.example", b"Host:", b"X: y")))
    if dice.random() < 0.15:
        made = made[: dice.randrange(1, min(len(made), 400))]
    return dice.randbytes(60) if dice.random() < 0.03 else made


def draw_half(dice: random.Random) -> bytes:
    """Draw the beginning of a request that is never completed; possibly empty."""
    half_body = http("PUT", "/api/stop", b"x" * 50)[:-30]
    return dice.choice((b"", b"", b"G", b"GET / HTTP/1.1\r\nHost: 127.0", HANDSHAKE, half_body))


# -- providers of services --------------------------------------------------------------------------------------------


def provider_answer(manner: str, service: str, call_id: object) -> bytes | None:
    """Return the answer of a program that provides a service to devices; None: no answer."""
    values: Any = {
        "long": {"success": True, "message": "y" * 3000},
        "right": {"success": True, "message": "yes"},
        "other": {"sum": [1, 2, 3], "message": {"no": "text"}},
        "list": [1, 2],
    }.get(manner)
    if manner == "never":
        return None
    is_right = manner != "refused"
    return operation(op="service_response", service=service, id=call_id, values=values, result=is_right)


MANNERS = ("long", "right", "other", "list", "refused", "never", "leaves")
