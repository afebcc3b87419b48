"""FleetTokens: which other daemons have a liveliness token; found anew after something was dropped."""

from collections.abc import Callable

from hostlink.graphs.zenoh.fleet_post import Post
from hostlink.graphs.zenoh.session import Declaration, Token

FIND_INTERVAL_S = 5.0  # between two searches for daemons whose tokens may have been dropped


class FleetTokens:
    """One subscription, with the tokens that are there already."""

    def __init__(self, post: Post, receive: Callable[[Token], None]) -> None:
        self._post, self._receive = post, receive
        self._subscription: Declaration | None = None
        self._dropped = 0
        self._found_at_s = 0.0

    def find(self, now_s: float) -> None:
        """Learn of all daemons that live, and follow who comes and goes."""
        self.close()
        self._dropped, self._found_at_s = self._post.session.counts["dropped"], now_s
        self._subscription = self._post.session.subscribe_tokens(f"{self._post.keys.fleet}/alive/*/*", self._receive)

    def tick(self, now_s: float) -> None:
        """Find them again if something was dropped: it may have been a token."""
        if self._dropped != self._post.session.counts["dropped"] and now_s >= self._found_at_s + FIND_INTERVAL_S:
            self.find(now_s)

    def close(self) -> None:
        """Follow nobody any more."""
        if self._subscription is not None:
            self._subscription.close()
