"""RemoteGraph: the nodes and endpoints of ROS 2 that live elsewhere, by their tokens. Pure.

Publishers are found by the gid of what they send. rmw_zenoh makes it of the token; another implementation may draw it,
and then it is bound to a token of the same topic that nobody has signed for.
"""

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

from hostlink.graphs.zenoh.rmw_protocol import EndpointToken, Kind, NodeToken, gid_of, parse_token
from hostlink.robot.admission import Freshness

_NS_PER_S: Final = 1_000_000_000
MAX_TOKENS: Final = 8192
MAX_TOKENS_OF_SESSION: Final = 2048  # of one process; a node of ROS 2 has ten or more

Subject = tuple[str, str]  # of messages: the topic, and its type


@dataclass(slots=True)
class RemotePublisher:
    """A publisher and its token; `drawn_gid`: by which it signs, if not by that of its token."""

    token: EndpointToken
    key: str
    gid: bytes
    drawn_gid: bytes | None = None
    has_signed: bool = False  # by the gid of its token

    @property
    def subject(self) -> Subject:
        """What it publishes."""
        return self.token.name, self.token.type_name


@dataclass(frozen=True, slots=True)
class Removed:
    """A token that is gone. `unsure`: publishers who drew their gids, any of whom may be the one that is gone."""

    token: NodeToken | EndpointToken
    publisher: RemotePublisher | None = None
    unsure: tuple[RemotePublisher, ...] = ()


@dataclass(slots=True)
class RemoteGraph:
    """Tokens of one domain, without those of hostlink's own nodes. `counts`: `malformed_tokens`, `crowded_tokens`."""

    domain: int
    counts: Counter[str]
    _tokens: dict[str, NodeToken | EndpointToken] = field(default_factory=dict)
    _of_session: Counter[str] = field(default_factory=Counter)
    _by_gid: dict[bytes, RemotePublisher] = field(default_factory=dict)
    _of_subject: dict[Subject, dict[str, RemotePublisher]] = field(default_factory=dict)

    def add(self, key: str) -> NodeToken | EndpointToken | None:
        """A token has come; None: it is known, no token of this graph, or one too many."""
        if key in self._tokens:
            return None
        token = parse_token(key)
        node = token.node if isinstance(token, EndpointToken) else token
        if token is None or node is None or node.domain != self.domain:
            self.counts["malformed_tokens"] += 1
            return None
        if node.is_hostlink:
            return None
        if len(self._tokens) >= MAX_TOKENS or self._of_session[node.session] >= MAX_TOKENS_OF_SESSION:
            self.counts["crowded_tokens"] += 1
            return None
        self._tokens[key] = token
        self._of_session[node.session] += 1
        if isinstance(token, EndpointToken) and token.kind is Kind.PUBLISHER:
            publisher = RemotePublisher(token, key, gid_of(key))
            mistaken = self._by_gid.get(publisher.gid)
            if mistaken is not None:  # it signed before its token came, and passed for one that draws its gids
                self._free(mistaken)
            self._by_gid[publisher.gid] = publisher
            self._of_subject.setdefault(publisher.subject, {})[key] = publisher
        return token

    def remove(self, key: str) -> Removed | None:
        """A token has gone; None: it was not known."""
        token = self._tokens.pop(key, None)
        if token is None:
            return None
        session = token.node.session if isinstance(token, EndpointToken) else token.session
        self._of_session[session] -= 1
        if not self._of_session[session]:
            del self._of_session[session]
        if not isinstance(token, EndpointToken) or token.kind is not Kind.PUBLISHER:
            return Removed(token)
        publisher = self._by_gid[gid_of(key)]
        self._forget(publisher)
        return Removed(token, publisher, self._unbind(publisher))

    def clear(self) -> None:
        """Nobody is there any more."""
        for key in list(self._tokens):
            self.remove(key)

    def publisher(self, gid: bytes, subject: Subject) -> RemotePublisher | None:
        """Who has signed a message of this subject; None: nobody in the graph."""
        found = self._by_gid.get(gid)
        if found is not None and found.subject == subject:
            if gid == found.gid and not found.has_signed:
                found.has_signed = True
                self._free(found)
            return found
        return None if found is not None else self._bind(gid, subject)

    def is_known(self, gid: bytes) -> bool:
        """Whether it is the gid of a token, or bound to one."""
        return gid in self._by_gid

    def publishers(self, subject: Subject) -> list[RemotePublisher]:
        """All of a subject."""
        return list(self._of_subject.get(subject, {}).values())

    def endpoints(self, kind: Kind) -> list[EndpointToken]:
        """All of a kind."""
        return [each for each in self._tokens.values() if isinstance(each, EndpointToken) and each.kind is kind]

    def __len__(self) -> int:
        return len(self._tokens)

    def _bind(self, gid: bytes, subject: Subject) -> RemotePublisher | None:
        """Bind a gid that somebody drew to a publisher that has signed nothing."""
        for publisher in self._of_subject.get(subject, {}).values():
            if not publisher.has_signed and publisher.drawn_gid is None:
                publisher.drawn_gid = gid
                self._by_gid[gid] = publisher
                return publisher
        return None

    def _unbind(self, gone: RemotePublisher) -> tuple[RemotePublisher, ...]:
        """Which of those that drew their gids is gone is not known, unless it has signed by its token's."""
        if gone.has_signed:
            return ()
        unsure = tuple(each for each in self.publishers(gone.subject) if each.drawn_gid is not None)
        for each in unsure:
            self._free(each)
        return unsure

    def _free(self, publisher: RemotePublisher) -> None:
        if publisher.drawn_gid is not None:
            self._by_gid.pop(publisher.drawn_gid, None)
            publisher.drawn_gid = None

    def _forget(self, publisher: RemotePublisher) -> None:
        self._free(publisher)
        del self._by_gid[publisher.gid]
        of_subject = self._of_subject[publisher.subject]
        del of_subject[publisher.key]
        if not of_subject:
            del self._of_subject[publisher.subject]


class SourceClock:
    """How late the messages of one publisher are, by the wall clock of who sent them.

    A wall clock that is set back is no delay: a message that waits never has an earlier time.
    """

    def __init__(self) -> None:
        self._freshness = Freshness()
        self._newest = (0, 0)  # number and time of the newest message

    def late_s(self, sequence_number: int, source_ns: int, now_s: float) -> float:
        """Seconds that a message waited longer on its way than the quickest before it."""
        number, time_ns = self._newest
        if sequence_number > number and source_ns < time_ns:
            self._freshness = Freshness()
        self._newest = max(self._newest, (sequence_number, source_ns))
        return self._freshness.late_s(source_ns / _NS_PER_S, now_s)
