"""Requests that no browser sends, drawn at random: every path and header with bytes, sizes and numbers out of order."""

import random

PATHS = (
    "/", "/web/{}", "/api/robots", "/api/robots/{}", "/api/robots/{}/odometry", "/api/robots/{}/velocity",
    "/api/robots/{}/stop", "/api/stop", "/api/robots/{}/lock", "/api/robots/{}/unlock", "/api/robots/{}/odometry/reset",
    "/api/links", "/api/links/{}/capture", "/api/links/{}/capture/{}", "/api/topics", "/api/clients", "/api/events",
    "/api/robots/{}/odometry/events", "/metrics", "/api/openapi.json", "/healthz", "/readyz",
)  # fmt: skip
HEADERS = (
    "Host", "Origin", "Authorization", "User-Agent", "Content-Type", "Content-Length", "Transfer-Encoding", "Upgrade",
    "Connection", "Sec-WebSocket-Key", "Sec-WebSocket-Version", "Sec-WebSocket-Protocol", "Sec-WebSocket-Extensions",
    "Expect", "Cookie", "Accept", "Accept-Encoding", "Content-Encoding", "Range", "X-Forwarded-For", "Keep-Alive",
    "Access-Control-Request-Method", "Access-Control-Request-Headers", "TE",
)  # fmt: skip
METHODS = (b"GET", b"GET", b"GET", b"PUT", b"POST", b"OPTIONS", b"HEAD", b"DELETE", b"CONNECT", b"FOO")
VALUES = (
    b"\xff", b"\xff\xfe", b"", b" ", b"9" * 4400, b"-1", b"0-0", b"9" * 4400 + b"-" + b"9" * 4400, b"\xd9\xa1",
    b"%ff", b"%00", b"%zz", b"..%2f..", b"a" * 9000, b"chunked", b"websocket", b"Upgrade", b"100-continue", b"gzip",
    b"[::1", b"http://[", b"http://a]:9", b"http://\xff:9/", b"1e9", b"+5", b"5,5", b"Bearer \xff\xff", b"Basic :",
    b"127.0.0.1", b"localhost:9090", b"robot_0", b"13", b"\xe2\x80\xaerobot", b"\x1b[2J", b"\xed\xa0\x80", b"close",
)  # fmt: skip
BODIES = (
    b"", b'{"linear":0,"angular":0}', b'{"linear":' + b"9" * 5000 + b',"angular":0}', b"\xff" * 10, b"[" * 100_000,
    b'{"reason":"\\ud800"}', b'{"linear":1e400,"angular":0}', b'{"linear":0,"angular":0,"priority":' + b"9" * 4400,
)  # fmt: skip
CHUNKS = (b"zz\r\n", b"f" * 18 + b"\r\nabc", b"5\r\nabc", b"1;" + b"x" * 10_000, b"3\r\nabc\r\n0\r\n\r\n")
UPGRADE = (
    b"Upgrade: websocket", b"Connection: Upgrade", b"Sec-WebSocket-Key: c3R1Y2sgc3R1Y2sgc3R1Yw==",
    b"Sec-WebSocket-Version: 13",
)  # fmt: skip


def draw_value(draw: random.Random) -> bytes:
    """Something for a header, a path or a query; without the end of a line."""
    noise = draw.randbytes(draw.randrange(12)).replace(b"\n", b"").replace(b"\r", b"")
    return draw.choice((*VALUES, noise))


def draw_request(draw: random.Random) -> bytes:
    """One request, or what looks a little like one; several of them may come at once."""
    path = draw.choice(PATHS).encode()
    while b"{}" in path:
        path = path.replace(b"{}", draw.choice((draw_value(draw), b"robot_0", b"1")), 1)
    if draw.random() < 0.3:
        path += b"?" + draw.choice((b"token=" + draw_value(draw), draw_value(draw), b"a=1&" * 1000))
    head, body = _draw_headers(draw), b""
    if draw.random() < 0.5:
        length, body = _draw_body(draw)
        head.append(length)
    draw.shuffle(head)
    request = draw.choice((*METHODS, draw_value(draw))) + b" " + path + b" HTTP/1.1\r\n" + b"\r\n".join(head)
    request += b"\r\n\r\n" + body
    return request * draw.choice((1, 1, 1, 40)) if draw.random() < 0.9 else request[: draw.randrange(len(request))]


def _draw_headers(draw: random.Random) -> list[bytes]:
    head = [b"Host: 127.0.0.1"] if draw.random() < 0.9 else []
    head += [draw.choice(HEADERS).encode() + b": " + draw_value(draw) for _ in range(draw.randrange(4))]
    return head + (list(UPGRADE) if draw.random() < 0.2 else [])


def _draw_body(draw: random.Random) -> tuple[bytes, bytes]:
    if draw.random() < 0.7:
        body = draw.choice(BODIES)
        return b"Content-Length: %d" % len(body), body
    return b"Transfer-Encoding: chunked", draw.choice(CHUNKS)
