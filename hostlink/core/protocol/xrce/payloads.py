"""Payloads: messages of an endpoint between CDR and the serialisation of ROS 1, which the hub carries."""

from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.cdr import Cdr, cdr_of
from hostlink.core.messages.message_type import MessageType
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind

_REQUESTS = frozenset({EndpointKind.SERVICE_CLIENT_PUBLISHER, EndpointKind.SERVICE_SERVER_SUBSCRIBER})
_TOPICS = frozenset({EndpointKind.PUBLISHER, EndpointKind.SUBSCRIBER})


class Payloads:
    """Translations of one connection's endpoints. A type without a definition has none: its bytes pass as they are."""

    __slots__ = ("_catalog", "_codecs")

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog
        self._codecs: dict[DeviceEndpoint, Cdr | None] = {}

    def check(self, endpoint: DeviceEndpoint) -> None:
        """Find the translation of an endpoint's messages.

        Raises:
            WrongType: ROS 2 has other fields in this type.
        """
        type_ = self._type_of(endpoint)
        self._codecs[endpoint] = None if type_ is None else cdr_of(type_)

    def forget(self) -> None:
        """Forget every endpoint."""
        self._codecs.clear()

    def is_raw(self, endpoint: DeviceEndpoint) -> bool:
        """Whether the messages of an endpoint are passed on as they are."""
        return self._codecs.get(endpoint) is None

    def from_device(self, endpoint: DeviceEndpoint, payload: bytes) -> bytes:
        """Translate a message of the device.

        Raises:
            BadPayload: it is not one of the endpoint's type.
        """
        codec = self._codecs.get(endpoint)
        return payload if codec is None else codec.to_ros1(payload)

    def to_device(self, endpoint: DeviceEndpoint, payload: bytes) -> bytes:
        """Translate a message to the device.

        Raises:
            BadPayload: it is not one of the endpoint's type.
        """
        codec = self._codecs.get(endpoint)
        return payload if codec is None else codec.from_ros1(payload)

    def _type_of(self, endpoint: DeviceEndpoint) -> MessageType | None:
        if endpoint.kind in _TOPICS:
            return self._catalog.message(endpoint.type)
        service = self._catalog.service(endpoint.type)
        if service is None:
            return None
        return service.request if endpoint.kind in _REQUESTS else service.response
