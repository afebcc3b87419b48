"""HubSource: subscription to a topic of the hub, as long as the other graph has use for it."""

from collections.abc import Callable

from hostlink.core.host import Participant, Receive
from hostlink.errors import HostlinkError


class HubSource:
    """Subscription to a topic of the hub by a participant of its own, which leaves when the topic is not read."""

    def __init__(
        self,
        join: Callable[[], Participant],
        topic: str,
        receive: Receive,
        on_refusal: Callable[[HostlinkError], None],
        *,
        type_name: str = "",
    ) -> None:
        """`on_refusal`: is called with the error of the hub, where the topic has another type."""
        self._join, self._topic, self._receive, self._on_refusal = join, topic, receive, on_refusal
        self._type_name = type_name
        self._participant: Participant | None = None

    @property
    def is_read(self) -> bool:
        """Whether it is subscribed to."""
        return self._participant is not None

    def set_read(self, is_read: bool) -> None:
        """Subscribe, or leave; a subscription that was refused is tried again."""
        if is_read == self.is_read:
            return
        if self._participant is not None:
            self._participant.leave()
            self._participant = None
            return
        self._participant = self._join()
        try:
            self._participant.subscribe(self._topic, self._receive, type_name=self._type_name)
        except HostlinkError as error:
            self.set_read(False)
            self._on_refusal(error)
