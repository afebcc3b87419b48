"""DeviceEndpoint: one end of a topic or service, as a device announces it."""

from enum import IntEnum
from typing import NamedTuple

_TO_DEVICE = 0x10000  # above every id, which has 16 bits


class EndpointKind(IntEnum):
    """Role of the device at an endpoint. A service has one endpoint for requests and one for responses."""

    PUBLISHER = 0
    SUBSCRIBER = 1
    SERVICE_SERVER_PUBLISHER = 2  # responses of a service of the device
    SERVICE_SERVER_SUBSCRIBER = 3  # requests to it
    SERVICE_CLIENT_PUBLISHER = 4  # requests of the device to a service of the host
    SERVICE_CLIENT_SUBSCRIBER = 5  # responses to them


IS_TO_DEVICE = frozenset(
    {EndpointKind.SUBSCRIBER, EndpointKind.SERVICE_SERVER_SUBSCRIBER, EndpointKind.SERVICE_CLIENT_SUBSCRIBER}
)


def to_device_key(endpoint_id: int) -> int:
    """Return the `DeviceEndpoint.key` of an id that the host sends to: no id that the device sends from."""
    return endpoint_id | _TO_DEVICE


class DeviceEndpoint(NamedTuple):
    """One endpoint of a device.

    `md5` identifies the definition of the type with which the device's program was built; empty if it tells none.
    `buffer_bytes`: the device's whole buffer for this direction, into which message and overhead must fit; 0: unknown.
    """

    kind: EndpointKind
    id: int
    name: str
    type: str
    md5: str = ""
    buffer_bytes: int = 0

    @property
    def is_to_device(self) -> bool:
        """Whether messages of this endpoint go from the host to the device."""
        return self.kind in IS_TO_DEVICE

    @property
    def key(self) -> int:
        """Id and direction as one number: `id` for what the device sends, `to_device_key` for what it receives.

        A device numbers each direction by itself: one id may be a publisher's and a subscriber's.
        """
        return to_device_key(self.id) if self.kind in IS_TO_DEVICE else self.id
