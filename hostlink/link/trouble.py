"""Trouble: damage on the wire of one link, in its log."""

import structlog

from hostlink.protocol.session import Session

log = structlog.get_logger()

TROUBLE_INTERVAL_S = 10.0  # damage on the wire is counted, and logged this often


class Trouble:
    """Logs damage on the wire: at most one line in TROUBLE_INTERVAL_S, with what came since the last one."""

    __slots__ = ("_logged", "_logged_at_s")

    def __init__(self, now_s: float) -> None:
        self._logged_at_s = now_s
        self._logged: dict[str, int] = {}

    def report(self, session: Session, now_s: float) -> None:
        """Log what is new, if the last line is old enough."""
        if now_s < self._logged_at_s + TROUBLE_INTERVAL_S:
            return
        self._logged_at_s = now_s
        counts = session.counts
        total = {
            "skipped_bytes": counts.skipped_bytes,
            "unknown_ids": counts.unknown_ids,
            "refused_frames": counts.refused_frames,
            "malformed": counts.malformed,
            **session.rejected,
        }
        before = self._logged
        new = {name: count - before.get(name, 0) for name, count in total.items() if count > before.get(name, 0)}
        self._logged = total
        if new:
            log.warning("link.trouble", **new)
