"""Why a node of ROS is not connected: what is wrong with the header that it has sent."""

from hostlink.graphs.ros1.tcpros import ANY, Header
from hostlink.logs import printable
from hostlink.messages.message_type import MessageType, ServiceType

REQUIRED = ("callerid", "md5sum")


def refusal(header: Header, name: str, type_: MessageType | ServiceType) -> str | None:
    """The error that it is answered; None: the header is right for the topic or service `name`."""
    for field in REQUIRED:
        if field not in header:
            return f"missing field {field}"
    if header["md5sum"] not in (ANY, type_.md5):
        return f"{name} is a {type_.name} with md5 {type_.md5}, not {printable(header['md5sum'])}"
    return None
