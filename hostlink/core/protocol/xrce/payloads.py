"""Payloads: messages of an endpoint between what the board sends and takes, and what the hub carries.

A board sends CDR without encapsulation. The hub carries messages of a known type as ROS 1 serialises them, and those of
another type as CDR with encapsulation, as every reader of CDR expects them.
"""

from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.cdr import ENCAPSULATION, Cdr, cdr_of, without_encapsulation
from hostlink.core.messages.message_type import MessageType
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind

_REQUESTS = frozenset({EndpointKind.SERVICE_CLIENT_PUBLISHER, EndpointKind.SERVICE_SERVER_SUBSCRIBER})
_TOPICS = frozenset({EndpointKind.PUBLISHER, EndpointKind.SUBSCRIBER})


class Payloads:
    """Translations of one connection's endpoints. A type without a definition has none: its bytes stay CDR."""

    __slots__ = ("_catalog", "_codecs")

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog
        self._codecs: dict[DeviceEndpoint, Cdr | None] = {}

    def check(self, endpoint: DeviceEndpoint) -> None:
        """Find the translation of an endpoint's messages.

        Raises:
            WrongType: ROS 2 has other fields in this type.
        """
        self._codecs[endpoint] = self._codec_for(endpoint)

    def forget(self) -> None:
        """Forget every endpoint."""
        self._codecs.clear()

    def is_raw(self, endpoint: DeviceEndpoint) -> bool:
        """Whether the messages of an endpoint are passed on as CDR."""
        return self._codecs.get(endpoint) is None

    def from_device(self, endpoint: DeviceEndpoint, payload: bytes) -> bytes:
        """Translate a message of the device.

        Raises:
            BadPayload: it is not one of the endpoint's type.
        """
        codec = self._codec_of(endpoint)
        if codec is not None:
            return codec.to_ros1(payload)
        return ENCAPSULATION + payload if endpoint.kind in _TOPICS else payload

    def to_device(self, endpoint: DeviceEndpoint, payload: bytes) -> bytes:
        """Translate a message to the device.

        Raises:
            BadPayload: it is not one of the endpoint's type, or not CDR if the type has no definition.
        """
        codec = self._codec_of(endpoint)
        if codec is not None:
            return codec.from_ros1(payload)
        return without_encapsulation(endpoint.type, payload) if endpoint.kind in _TOPICS else payload

    def _codec_of(self, endpoint: DeviceEndpoint) -> Cdr | None:
        """Return the translation of an endpoint, also of one before the last announcement, which takes a last zero."""
        try:
            return self._codecs[endpoint]
        except KeyError:
            return self._codec_for(endpoint)

    def _codec_for(self, endpoint: DeviceEndpoint) -> Cdr | None:
        type_ = self._type_of(endpoint)
        return None if type_ is None else cdr_of(type_)

    def _type_of(self, endpoint: DeviceEndpoint) -> MessageType | None:
        if endpoint.kind in _TOPICS:
            return self._catalog.message(endpoint.type)
        service = self._catalog.service(endpoint.type)
        if service is None:
            return None
        return service.request if endpoint.kind in _REQUESTS else service.response
