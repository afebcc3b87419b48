"""A host's session and its clock, with a device that a test plays."""

from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.session import Session
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.errors import WrongType

SIZES = {"std_msgs/Bool": 1, "geometry_msgs/Pose2D": 24}
TIME = encode(Id.TIME, bytes(8))
ODOMETRY = DeviceEndpoint(EndpointKind.PUBLISHER, 125, "/odometry", "geometry_msgs/Pose2D", "m", 512)
LED = DeviceEndpoint(EndpointKind.SUBSCRIBER, 100, "/led", "std_msgs/Bool", "m", 64)
TEXT = DeviceEndpoint(EndpointKind.SUBSCRIBER, 101, "/text", "std_msgs/String", "m", 64)


def wire(*infos: DeviceEndpoint) -> bytes:
    return b"".join(encode(info.kind, encode_topic_info(info)) for info in infos)


def check(info: DeviceEndpoint) -> int | None:
    if info.md5 == "wrong":
        raise WrongType(info.name, "md5 right", "md5 wrong")
    return SIZES.get(info.type)


class Host:
    """A session and its clock."""

    def __init__(self, *infos: DeviceEndpoint, is_lossy: bool = False) -> None:
        self.session = Session(check=check, is_lossy=is_lossy)
        self.now_s = 100.0
        self.events = self.session.open(now_s=self.now_s)
        if infos:
            self.receive(TIME + wire(*infos) + TIME)
            self.sent()

    def receive(self, data: bytes, *, after_s: float = 0.01) -> list[events.Event]:
        self.now_s += after_s
        self.events = self.session.receive(data, now_s=self.now_s)
        return self.events

    def wait(self, seconds: float) -> list[events.Event]:
        """Tick whenever the session wants it."""
        until_s = self.now_s + seconds
        self.events = []
        while (deadline_s := self.session.deadline_s()) <= until_s:
            assert deadline_s > self.now_s - 1e-9
            self.now_s = max(self.now_s, deadline_s)
            self.events += self.session.tick(now_s=self.now_s)
        self.now_s = until_s
        return self.events

    def sent(self) -> list[Frame]:
        stream, found = FrameStream(), []
        while (outgoing := self.session.pop_frame(now_s=self.now_s, wall_ns=5)) is not None:
            found += [item for item in stream.feed(outgoing.frame) if isinstance(item, Frame)]
        return found

    def requests(self) -> list[str]:
        return [event.reason for event in self.events if isinstance(event, events.TopicsRequested)]
