"""Requests of Foxglove's WebSocket protocol: the JSON messages that a client may send, as types. Pure."""

from typing import Annotated, Any

import msgspec

from hostlink.api.request import MAX_TEXT
from hostlink.errors import BadRequest

MAX_ITEMS = 1024  # in one request
MAX_SETTINGS = 16  # of parameters in one request; each is compared with all that there are
MAX_REASON = 300  # characters of what is wrong; it may name what the client sent
_Number = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]  # as a binary message has it
_Name = Annotated[str, msgspec.Meta(min_length=1, max_length=MAX_TEXT)]
_Text = Annotated[str, msgspec.Meta(max_length=MAX_TEXT)]
_Numbers = Annotated[list[_Number], msgspec.Meta(max_length=MAX_ITEMS)]
_Names = Annotated[list[_Name], msgspec.Meta(max_length=MAX_ITEMS)]


class WantedChannel(msgspec.Struct):
    """A subscription; the client chose its id."""

    id: _Number
    channel_id: _Number = msgspec.field(name="channelId")


class ClientChannel(msgspec.Struct):
    """A topic to which the client publishes; the client chose its id."""

    id: _Number
    topic: _Name
    encoding: _Text
    schema_name: _Name = msgspec.field(name="schemaName")


class ParameterSetting(msgspec.Struct):
    """A parameter; without a value it is to be removed."""

    name: _Name
    value: Any = msgspec.UNSET
    type: _Text | None = None


class Subscribe(msgspec.Struct, tag_field="op", tag="subscribe"):
    """Send the messages of channels."""

    subscriptions: Annotated[list[WantedChannel], msgspec.Meta(max_length=MAX_ITEMS)]


class Unsubscribe(msgspec.Struct, tag_field="op", tag="unsubscribe"):
    """Send them no more."""

    subscription_ids: _Numbers = msgspec.field(name="subscriptionIds")


class Advertise(msgspec.Struct, tag_field="op", tag="advertise"):
    """The client publishes to topics."""

    channels: Annotated[list[ClientChannel], msgspec.Meta(max_length=MAX_ITEMS)]


class Unadvertise(msgspec.Struct, tag_field="op", tag="unadvertise"):
    """It publishes to them no more."""

    channel_ids: _Numbers = msgspec.field(name="channelIds")


class GetParameters(msgspec.Struct, tag_field="op", tag="getParameters"):
    """Send the values of parameters; of none: of all."""

    names: _Names = msgspec.field(name="parameterNames")
    id: _Text | None = None


class SetParameters(msgspec.Struct, tag_field="op", tag="setParameters"):
    """Change parameters."""

    parameters: Annotated[list[ParameterSetting], msgspec.Meta(max_length=MAX_SETTINGS)]
    id: _Text | None = None


class WatchParameters(msgspec.Struct, tag_field="op", tag="subscribeParameterUpdates"):
    """Send the values of parameters whenever they change; of none: of all that there are."""

    names: _Names = msgspec.field(name="parameterNames")


class UnwatchParameters(msgspec.Struct, tag_field="op", tag="unsubscribeParameterUpdates"):
    """Send them no more; of none: of all."""

    names: _Names = msgspec.field(name="parameterNames")


class WatchGraph(msgspec.Struct, tag_field="op", tag="subscribeConnectionGraph"):
    """Send who publishes, subscribes and provides what."""


class UnwatchGraph(msgspec.Struct, tag_field="op", tag="unsubscribeConnectionGraph"):
    """Send it no more."""


JsonRequest = (
    Subscribe
    | Unsubscribe
    | Advertise
    | Unadvertise
    | GetParameters
    | SetParameters
    | WatchParameters
    | UnwatchParameters
    | WatchGraph
    | UnwatchGraph
)
_decoder: msgspec.json.Decoder[JsonRequest] = msgspec.json.Decoder(JsonRequest)


def decode_request(text: str) -> JsonRequest:
    """One JSON message of a client.

    Raises:
        BadRequest: it is no JSON, its op is unknown, or a field is missing or wrong.
    """
    try:
        return _decoder.decode(text)
    except (msgspec.DecodeError, UnicodeError) as error:
        raise BadRequest(str(error)[:MAX_REASON]) from None
    except RecursionError:
        raise BadRequest("no JSON: nested too deeply") from None
