"""Post: how this daemon reaches the others of its fleet."""

from collections import Counter
from dataclasses import dataclass

from hostlink.graphs.zenoh.fleet_messages import Keys, Sender
from hostlink.graphs.zenoh.session import Session

GROUP = "fleet"  # of its participants in the hub


@dataclass(frozen=True, slots=True)
class Post:
    """`me`: as others know this daemon; `counts`: of what was refused or dropped, by cause."""

    session: Session
    keys: Keys
    me: Sender
    counts: Counter[str]
    may_drive: tuple[str, ...] = ("*",)  # patterns of the names of daemons whose programs may drive robots here

    def source(self, key: str) -> str:
        """Who has sent on a key, as the one in whose queue it waits."""
        return str(self.keys.sender(key))

    def source_of_addressed(self, key: str) -> str:
        """The same for a key with an addressee."""
        return str(self.keys.sender(key, is_addressed=True))
