"""Frames of hostile programs in Foxglove's protocol, valid and invalid. Bytes from dice, without a socket.

Ids of services are the daemon's; those that are drawn here are unknown, because only a rival locks the honest robot.
"""

import json
import random
import struct
from typing import Any

from tests.support.chaos.names import MESSAGE_TYPES, ROGUE_TOPICS
from tests.support.chaos.requests import BINARY, HANDSHAKE, WRONG_VALUES, ws_frame

PROTOCOLS = ("foxglove.websocket.v1", "foxglove.sdk.v1")
CHANNELS = 200  # the daemon numbers its channels from 1 on
OWN_CHANNELS = 20
UNKNOWN_SERVICE_ID = 1 << 20
_PUBLISHED, _CALL = 1, 2


def handshake(dice: random.Random) -> bytes:
    """Return the handshake of Foxglove's apps."""
    return HANDSHAKE + f"Sec-WebSocket-Protocol: {dice.choice(PROTOCOLS)}\r\n\r\n".encode()


def draw_request(dice: random.Random) -> bytes:
    """Valid in most cases."""
    if dice.random() < 0.4:
        return ws_frame(dice.choice((_message, _message, _message, _call, _noise))(dice), BINARY)
    fields = dice.choice(_REQUESTS)(dice)
    while dice.random() < 0.2:
        fields[dice.choice(list(fields))] = dice.choice(WRONG_VALUES)
    text = json.dumps(fields)
    return ws_frame(text[: dice.randrange(len(text))].encode() if dice.random() < 0.05 else text.encode())


def _message(dice: random.Random) -> bytes:
    """Return a message on a channel that may be advertised; 48 zeros are a Twist of zeros."""
    payload = dice.choice((bytes(48), b"\x02\0\0\0on", dice.randbytes(dice.choice((0, 24, 300))), bytes(100_000)))
    return struct.pack("<BI", _PUBLISHED, dice.randrange(OWN_CHANNELS)) + payload


def _call(dice: random.Random) -> bytes:
    encoding = dice.choice((b"ros1", b"json", b""))
    length = dice.choice((len(encoding), len(encoding), 1 << 31))
    return struct.pack("<BIII", _CALL, UNKNOWN_SERVICE_ID, dice.randrange(9), length) + encoding


def _noise(dice: random.Random) -> bytes:
    return dice.randbytes(dice.choice((0, 1, 4, 300)))


def _subscribe(dice: random.Random) -> dict[str, Any]:
    count = dice.choice((1, 10, 150))
    ids = [{"id": dice.randrange(1000), "channelId": dice.randrange(1, CHANNELS)} for _ in range(count)]
    return {"op": "subscribe", "subscriptions": ids}


def _advertise(dice: random.Random) -> dict[str, Any]:
    channels = [
        {
            "id": dice.randrange(OWN_CHANNELS),
            "topic": dice.choice((*ROGUE_TOPICS, "/chat", "/rogue_0/cmd_vel", f"/new_{dice.randrange(99)}", "~", "")),
            "encoding": dice.choice(("ros1", "ros1", "ros1", "json")),
            "schemaName": dice.choice(MESSAGE_TYPES),
        }
        for _ in range(dice.choice((1, 3, OWN_CHANNELS)))
    ]
    return {"op": "advertise", "channels": channels}


_REQUESTS = (
    _subscribe,
    _subscribe,
    _advertise,
    _advertise,
    lambda dice: {"op": "unsubscribe", "subscriptionIds": [dice.randrange(1000) for _ in range(50)]},
    lambda dice: {"op": "unadvertise", "channelIds": [dice.randrange(OWN_CHANNELS)]},
    lambda dice: {"op": "getParameters", "parameterNames": dice.choice(([], ["/gain"], ["x" * 300])), "id": "1"},
    lambda dice: {"op": "setParameters", "parameters": [{"name": f"/gain_{dice.randrange(99)}", "value": 0.5}]},
    lambda dice: {"op": "subscribeParameterUpdates", "parameterNames": dice.choice(([], ["/gain"]))},
    lambda dice: {"op": "unsubscribeParameterUpdates", "parameterNames": dice.choice(([], ["/gain"]))},
    lambda dice: {"op": dice.choice(("subscribeConnectionGraph", "unsubscribeConnectionGraph"))},
    lambda dice: {"op": dice.choice(("fetchAsset", "status", "x" * 500)), "uri": "package://a"},
)
