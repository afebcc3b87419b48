"""Endpoint and payload of the response to a device's service request."""

import pytest

from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.outbox import MAX_REPLIES
from hostlink.core.protocol.rosserial.frame import OVERHEAD_BYTES, Frame, encode
from hostlink.errors import DeviceBusy, FrameTooLarge, UnknownTopic
from tests.support.session_host import LED, Host

REQUESTS = DeviceEndpoint(EndpointKind.SERVICE_CLIENT_PUBLISHER, 125, "/ask", "my_srvs/Mine", "m", 512)
RESPONSES = DeviceEndpoint(EndpointKind.SERVICE_CLIENT_SUBSCRIBER, 100, "/ask", "my_srvs/Mine", "m", 64)


def second(info: DeviceEndpoint) -> DeviceEndpoint:
    return info._replace(id=info.id + 1)


def test_several_clients_of_one_service_are_distinguished_by_their_order() -> None:
    host = Host(second(REQUESTS), RESPONSES, REQUESTS, second(RESPONSES))
    assert host.session.response_endpoint(REQUESTS) == RESPONSES
    assert host.session.response_endpoint(second(REQUESTS)) == second(RESPONSES)


def test_request_without_response_endpoint_raises_unknown_topic() -> None:
    host = Host(REQUESTS, second(REQUESTS), RESPONSES)
    for request in (second(REQUESTS), REQUESTS._replace(id=130), REQUESTS._replace(name="/other")):
        with pytest.raises(UnknownTopic, match=f"no endpoint for responses named {request.name}"):
            host.session.response_endpoint(request)


@pytest.mark.parametrize(("buffer_bytes", "room_bytes"), [(64, 56), (0, 504), (-1, 504), (70000, 504), (8, 0)])
def test_response_with_unknown_layout_fills_the_buffer_with_zeros(buffer_bytes: int, room_bytes: int) -> None:
    """The frame has at most 512 bytes: on a slow line a stop would wait behind a longer one."""
    response = RESPONSES._replace(buffer_bytes=buffer_bytes)
    host = Host(REQUESTS, response)
    host.session.respond(response, None)
    assert host.sent() == [Frame(100, bytes(room_bytes))]
    assert host.session.room_bytes(response) >= room_bytes


def test_response_with_fixed_size_has_that_many_zeros() -> None:
    response = RESPONSES._replace(type="std_msgs/Bool")
    host = Host(REQUESTS, response)
    host.session.respond(response, None)
    assert host.sent() == [Frame(100, bytes(1))]


def test_no_response_is_longer_than_the_devices_buffer() -> None:
    host = Host(REQUESTS, RESPONSES)
    host.session.respond(RESPONSES, bytes(64 - OVERHEAD_BYTES))
    with pytest.raises(FrameTooLarge, match="/ask: frame of 65 bytes, the device takes 64"):
        host.session.respond(RESPONSES, bytes(65 - OVERHEAD_BYTES))
    with pytest.raises(FrameTooLarge, match="/ask: frame of 8 bytes, the device takes 7"):
        host.session.respond(RESPONSES._replace(buffer_bytes=7), None)
    assert len(host.sent()) == 1


def test_responses_are_bounded() -> None:
    host = Host(REQUESTS, RESPONSES)
    for _ in range(MAX_REPLIES):
        host.session.respond(RESPONSES, b"")
    with pytest.raises(DeviceBusy):
        host.session.respond(RESPONSES, b"")


def test_refused_or_undecodable_request_is_still_reported() -> None:
    """The device blocks until its request is answered, so a refused or undecodable request must be reported too."""
    refused = REQUESTS._replace(md5="wrong")
    sized = second(REQUESTS)._replace(type="std_msgs/Bool")
    host = Host(LED, refused, sized)
    assert host.receive(encode(125, b"what") + encode(126, b"ever")) == [
        events.ServiceRequested(refused, b"what"),
        events.ServiceRequested(sized, b"ever"),
    ]
    assert (host.session.is_refused(refused), host.session.is_refused(sized)) == (True, False)
