"""FoxgloveSubscriptions: the channels of which one client of Foxglove's protocol receives the messages."""

from collections.abc import Iterable

from hostlink.api.foxglove_directory import Channel
from hostlink.api.foxglove_requests import WantedChannel
from hostlink.api.foxglove_time import FoxgloveTime
from hostlink.api.outgoing import ClientQueue
from hostlink.errors import BadRequest
from hostlink.hub.message import Message
from hostlink.hub.participant import Participant
from hostlink.hub.subscription import Subscription


class FoxgloveSubscriptions:
    """By the ids that the client chose, one for each channel; the payloads pass as they are."""

    def __init__(self, participant: Participant, queue: ClientQueue, time: FoxgloveTime) -> None:
        self._participant, self._queue, self._time = participant, queue, time
        self._subscriptions: dict[int, tuple[Channel, Subscription]] = {}
        self._of_channel: dict[int, int] = {}  # channel -> subscription

    def subscribe(self, wanted: WantedChannel, channel: Channel | None) -> None:
        """Send the messages of a channel from now on, the latched one first.

        Raises:
            BadRequest: there is no such channel, it or the id is in use, or there are too many subscriptions.
            WrongType: the topic has another type by now.
        """
        if channel is None:
            raise BadRequest(f"subscribe: there is no channel {wanted.channel_id}")
        if wanted.id in self._subscriptions:
            raise BadRequest(f"subscribe: the id {wanted.id} is in use")
        if channel.id in self._of_channel:
            raise BadRequest(f"subscribe: {channel.topic} is subscribed already")

        def receive(message: Message) -> None:
            if message.type is channel.type:
                self._queue.put_message(channel.topic, self._time.outgoing(message, wanted.id), message.at_s)

        subscription = self._participant.subscribe(channel.topic, receive, type_name=channel.type.name)
        self._subscriptions[wanted.id] = (channel, subscription)
        self._of_channel[channel.id] = wanted.id

    def unsubscribe(self, number: int) -> None:
        """Send no more of it; an id that is not there is no error."""
        channel, subscription = self._subscriptions.pop(number, (None, None))
        if channel is not None and subscription is not None:
            del self._of_channel[channel.id]
            self._queue.forget(channel.topic)
            subscription.close()

    def remove_channels(self, channel_ids: Iterable[int]) -> None:
        """The channels are no more."""
        for number in [self._of_channel[each] for each in channel_ids if each in self._of_channel]:
            self.unsubscribe(number)
