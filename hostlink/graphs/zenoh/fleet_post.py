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
