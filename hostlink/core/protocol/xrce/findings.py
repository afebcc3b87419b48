"""Rules of micro-ROS: what the counts, numbers and times of a link, and the bytes outside messages, show. Pure.

Each threshold names its source. Codes and texts are in hostlink/core/diagnosis/findings.toml.
"""

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from hostlink.core.protocol import line_speed
from hostlink.core.protocol.line_speed import LineSpeed
from hostlink.core.protocol.link_evidence import LinkEvidence, explain_skipped, explain_unknown, explain_unreadable
from hostlink.core.protocol.xrce.framing import device_frame
from hostlink.core.protocol.xrce.wire import (
    KEYLESS,
    NO_STREAM,
    VENDOR,
    VERSION,
    ClientInfo,
    encode_client,
    encode_message,
)

RECENT_S: Final = 30.0  # of the counts
MIN_LOST: Final = 3  # datagrams: one may be lost by any radio
LOST_SHARE: Final = 0.01
MIN_RESENT: Final = 5
RESENT_SHARE: Final = 0.01  # of 2 % of lost datagrams, every second shows here
MIN_WAITS: Final = 3  # in RECENT_S; a board waits 0.1 s for its first HEARTBEAT
WAIT_SHARE: Final = 0.5  # of the time of the board's loop
MIN_ROUND_TRIPS: Final = 5
SLOW_TURN_S: Final = 0.05  # commands of 20 Hz come as fast: a board reads one message a turn
MIN_RESTARTS: Final = 3  # in RECENT_S
WRONG_SIZES: Final = 3
JUDGED_S: Final = 5.0  # a board asks five times until then
MIN_GREETINGS: Final = 3
NEVER_ASKED_S: Final = 30.0  # boards that can reconnect ask for the host every second, or more often
NAMES_MAX: Final = 3  # in one text
PINGS: Final = bytes.fromhex("7e01001000 80000000 02010800 000afffd02000000 cf12") * 8  # a board has no other frame


class OwnCounts(NamedTuple):
    """Counts of micro-ROS alone."""

    greetings: int  # pings and CREATE_CLIENT
    best_effort: int
    best_effort_lost: int
    reliable: int  # messages from the board, each counted once
    duplicates: int
    missing: int
    resent: int
    restarts: int
    waits: int
    unknown: int  # messages of a client that was not created here


class Facts(NamedTuple):
    """Knowledge of a session besides its counts."""

    is_serial: bool  # there is a line, with a baud rate
    clients: int = 0
    resumed: int = 0  # clients that went on after a restart of the host
    refuted: int = 0  # clients that were not the ones of the stored state
    pings: int = 0
    round_trip_s: float = 0.0
    least_round_trip_s: float = 0.0
    round_trips: int = 0
    too_large: str = ""  # about the last message to the board that was refused for its size
    raw: tuple[str, ...] = ()  # topics with their types, which have no definition
    references: tuple[str, ...] = ()  # topics whose types the board does not tell
    excess: int = 0  # endpoints that were refused because there are too many


def explain(facts: Facts, evidence: LinkEvidence) -> Mapping[str, str]:
    """Return what is wrong with a link of a micro-ROS board: details by the code of their finding."""
    own = OwnCounts(*evidence.own)
    details = {code: rule(facts, own, evidence) for code, rule in _RULES.items()}
    found = {code: detail for code, detail in details.items() if detail}
    if evidence.is_shared:
        return found
    return {**found, **(explain_skipped(evidence, guess_speed) if facts.is_serial else explain_unreadable(evidence))}


# -- the line ---------------------------------------------------------------------------------------------------------


def _usual() -> bytes:
    """Return what a board sends that hears no answer: pings, which are constant, and requests for a session."""
    keys = (0x1234ABCD, 0x5E77C01F, 0x60B19A42, 0x7C0533E8)
    clients = [ClientInfo(VERSION, VENDOR, key.to_bytes(4), 0x81, (), 508) for key in keys]
    messages = [encode_message(KEYLESS, b"", NO_STREAM, 0, encode_client(each)) for each in clients]
    return PINGS + b"".join(map(device_frame, messages))


USUAL: Final = _usual()


def guess_speed(sample: bytes, baud: int | None) -> LineSpeed | None:
    """Guess the baud rate of a micro-ROS board from skipped bytes; None if they do not show it."""
    return line_speed.guess_speed(sample, baud, USUAL)


def _unheard(_: Facts, own: OwnCounts, evidence: LinkEvidence) -> str:
    """Detect a board that only asks for the host: it does not hear the answers."""
    is_asking = own.greetings >= MIN_GREETINGS and own.greetings == evidence.recent.frames
    if evidence.negotiated_s is not None or evidence.age_s < JUDGED_S or not is_asking:
        return ""
    return f"it asked {own.greetings} times"


def _best_effort_lost(_: Facts, own: OwnCounts, __: LinkEvidence) -> str:
    lost, total = own.best_effort_lost, own.best_effort + own.best_effort_lost
    is_so = lost >= MIN_LOST and lost >= LOST_SHARE * total
    return f"{lost} of {total} messages ({lost / total:.1%}) in {RECENT_S:.0f} s" if is_so else ""


def _messages_resent(facts: Facts, own: OwnCounts, _: LinkEvidence) -> str:
    lost = own.resent if _is_slow(facts) else own.duplicates + own.missing + own.resent  # it is asked before it answers
    if lost < MIN_RESENT or lost < RESENT_SHARE * own.reliable:
        return ""
    round_trip = f"; an answer takes {facts.round_trip_s * 1000:.0f} ms" if facts.round_trips else ""
    again = f"{own.missing} were missing, {own.duplicates} came twice, {own.resent} were sent again"
    return f"{again}, of {own.reliable} messages in {RECENT_S:.0f} s{round_trip}"


# -- the board's program ----------------------------------------------------------------------------------------------


def _slow_loop(facts: Facts, _: OwnCounts, __: LinkEvidence) -> str:
    if not _is_slow(facts):
        return ""
    return f"an answer takes {facts.round_trip_s * 1000:.0f} ms, the fastest took {facts.least_round_trip_s * 1000:.0f}"


def _is_slow(facts: Facts) -> bool:
    return facts.round_trips >= MIN_ROUND_TRIPS and facts.round_trip_s - facts.least_round_trip_s >= SLOW_TURN_S


def _publishes_wait(facts: Facts, own: OwnCounts, evidence: LinkEvidence) -> str:
    """Detect a loop that waits for the acknowledgements of what it publishes."""
    found = [f"{own.waits} publishes waited for 0.1 s or longer"] if own.waits >= MIN_WAITS else []
    rate_hz = own.reliable / min(max(evidence.age_s, 1.0), RECENT_S)
    if facts.round_trips >= MIN_ROUND_TRIPS and rate_hz * facts.least_round_trip_s >= WAIT_SHARE:
        found.append(f"{rate_hz:.0f} messages/s of at least {facts.least_round_trip_s * 1000:.0f} ms each")
    return "; ".join(found)


def _created_again(_: Facts, own: OwnCounts, __: LinkEvidence) -> str:
    return f"{own.restarts} times in {RECENT_S:.0f} s" if own.restarts >= MIN_RESTARTS else ""


def _session_unknown(facts: Facts, own: OwnCounts, evidence: LinkEvidence) -> str:
    if facts.clients:
        return ""
    if facts.refuted:
        return "its numbers or messages are not those of the board whose session was kept"
    return explain_unknown(own.unknown, evidence.age_s)


def _no_reconnect(facts: Facts, own: OwnCounts, evidence: LinkEvidence) -> str:
    waited_s = evidence.negotiated_s or 0.0
    is_so = facts.resumed and not facts.pings and not own.restarts and waited_s >= NEVER_ASKED_S
    return f"not asked in {waited_s:.0f} s" if is_so else ""


def _too_many_endpoints(facts: Facts, _: OwnCounts, __: LinkEvidence) -> str:
    return f"{facts.excess} were refused" if facts.excess else ""


# -- topics and types -------------------------------------------------------------------------------------------------


def _best_effort_too_long(facts: Facts, _: OwnCounts, evidence: LinkEvidence) -> str:
    return _joined([each for each in evidence.too_small if each != facts.too_large])


def _message_too_long(facts: Facts, _: OwnCounts, __: LinkEvidence) -> str:
    return facts.too_large


def _type_changed(_: Facts, __: OwnCounts, evidence: LinkEvidence) -> str:
    return _joined(evidence.refused)


def _type_differs(_: Facts, __: OwnCounts, evidence: LinkEvidence) -> str:
    count = evidence.recent.wrong_sizes
    return f"{count} messages" if count >= WRONG_SIZES else ""


def _type_unknown(facts: Facts, _: OwnCounts, __: LinkEvidence) -> str:
    return _joined(facts.raw)


def _by_reference(facts: Facts, _: OwnCounts, __: LinkEvidence) -> str:
    return _joined(facts.references)


def _joined(texts: list[str] | tuple[str, ...]) -> str:
    more = len(texts) - NAMES_MAX
    return "; ".join([*texts[:NAMES_MAX], *([f"and {more} more"] if more > 0 else [])])


_RULES: Final[dict[str, Callable[[Facts, OwnCounts, LinkEvidence], str]]] = {
    "unheard": _unheard,
    "session_unknown": _session_unknown,
    "created_again": _created_again,
    "no_reconnect": _no_reconnect,
    "too_many_endpoints": _too_many_endpoints,
    "best_effort_too_long": _best_effort_too_long,
    "message_too_long": _message_too_long,
    "type_changed": _type_changed,
    "type_differs": _type_differs,
    "type_unknown": _type_unknown,
    "types_by_reference": _by_reference,
    "best_effort_lost": _best_effort_lost,
    "messages_resent": _messages_resent,
    "publishes_wait": _publishes_wait,
    "slow_loop": _slow_loop,
}
