"""Memories: what the sessions of devices need to go on where they ended, also after a restart of the daemon.

A device that never announces itself again would otherwise be deaf for ever: micro-ROS boards without code to reconnect.
"""

import asyncio
from collections.abc import Callable

import structlog

from hostlink.core.link.link import Link
from hostlink.core.protocol.session import DeviceProtocol
from hostlink.core.runtime.logs import printable

log = structlog.get_logger()

MOST = 256  # devices; the ones whose memory changed least recently are forgotten
MOST_CHARS = 256 * 1024  # of one device: as many topics as it may have, described in XML
MOST_CHARS_TOGETHER = 3_000_000  # the file of a daemon has at most 4 MB, with escapes
MOST_LOGGED = 4 * MOST  # devices of which it is known that they were logged
ADVICE = "micro-ROS boards without code to reconnect must be reset after a restart of the daemon"
TCP = "tcp"  # a connection ends with the daemon, and the next one is of another port

Texts = dict[str, str]


class Memories:
    """The memories by protocol and place: the port of a device, or the address and port that it sends from."""

    def __init__(self) -> None:
        self.on_change: Callable[[], None] = lambda: None
        self.texts: Texts = {}  # the one that changed last is the last
        self.links: dict[int, Link] = {}  # of devices that may be remembered
        self.has_links = asyncio.Event()
        self._versions: dict[int, int] = {}  # of each link, as noted
        self._chars = 0  # of all texts
        self._logged: set[str] = set()  # keys of devices that were reported as not remembered

    def restore(self, texts: Texts) -> None:
        """Remember what was kept before this start."""
        self.texts = dict(list(texts.items())[-MOST:])
        self._chars = sum(map(len, self.texts.values()))

    def of(self, protocol: DeviceProtocol, kind: str, peer: str, address: str) -> str:
        """Return the memory of the device at a place; empty if there is none."""
        return self.texts.get(_key(protocol.name, kind, peer, address), "")

    def has(self, protocol: DeviceProtocol, kind: str, peer: str, address: str = "") -> bool:
        """Whether there is a memory of the device at a place."""
        return _key(protocol.name, kind, peer, address) in self.texts

    def peers(self, protocol: DeviceProtocol, kind: str) -> list[str]:
        """Return the places on one kind of transport of which there is a memory."""
        start = _key(protocol.name, kind, "", "")
        return [key.removeprefix(start) for key in self.texts if key.startswith(start)]

    def forget(self, protocol: DeviceProtocol, kind: str, peer: str, address: str = "") -> None:
        """Forget the device at a place: it begins anew, or another one is there."""
        text = self.texts.pop(_key(protocol.name, kind, peer, address), None)
        if text is not None:
            self._chars -= len(text)
            self.on_change()

    def join(self, link: Link) -> None:
        """Look at this link from now on."""
        self.links[link.number] = link
        self.has_links.set()

    def note(self) -> None:
        """Note what has changed in the sessions of all links."""
        for link in self.links.values():
            self._note(link)

    def leave(self, link: Link) -> None:
        """Note the last memory of a link that has ended, with its last numbers: those before are older."""
        if self.links.pop(link.number, None) is not None:
            self._versions[link.number] = -1
            self._note(link)
            self._versions.pop(link.number, None)
            if not self.links:
                self.has_links.clear()

    def _note(self, link: Link) -> None:
        session = link.session
        version = session.memory_version
        if version != self._versions.get(link.number, 0) and link.kind != TCP:
            self._versions[link.number] = version
            self._put(_key(session.protocol, link.kind, link.peer, link.address), session.memory())

    def _put(self, key: str, text: str) -> None:
        before = self.texts.pop(key, "")
        self._chars -= len(before)
        if len(text) > MOST_CHARS:
            self._log_forgotten(key, f"its objects take {len(text)} characters, the limit is {MOST_CHARS}")
        elif text:
            self.texts[key] = text
            self._chars += len(text)
            while len(self.texts) > MOST or self._chars > MOST_CHARS_TOGETHER:
                self._forget_oldest()
        if text != before:
            self.on_change()

    def _forget_oldest(self) -> None:
        oldest = next(iter(self.texts))
        self._chars -= len(self.texts.pop(oldest))
        limit = f"{MOST} devices and {MOST_CHARS_TOGETHER} characters"
        self._log_forgotten(oldest, f"others changed later, and the limit of all together is {limit}")

    def _log_forgotten(self, key: str, reason: str) -> None:
        """Log a device that is not remembered, once."""
        if key not in self._logged:
            if len(self._logged) >= MOST_LOGGED:
                self._logged.clear()
            self._logged.add(key)
            log.warning("boards.forgotten", board=printable(key), reason=reason, advice=ADVICE)


def _key(protocol: str, kind: str, peer: str, address: str) -> str:
    """Return the key of a place. The name of a serial port stays when the path of its device changes."""
    return f"{protocol} {kind} {address if kind == 'serial' else peer}"
