"""Times for people: by the clock of this computer, with the offset to UTC. Files and JSON have UTC."""

from datetime import UTC, datetime

from hostlink.core.runtime.units import NS_PER_S


def now() -> datetime:
    """Return the time of this computer."""
    return datetime.now(UTC).astimezone()


def offset(at: datetime) -> str:
    """Return the offset of a local time: `UTC+1`, `UTC-3:30` or `UTC`."""
    sign, hours, minutes = f"{at:%z}"[:1], int(f"{at:%z}"[1:3]), f"{at:%z}"[3:5]
    rest = "" if minutes == "00" else f":{minutes}"
    return f"UTC{sign}{hours}{rest}" if hours or rest else "UTC"


def time_text(stamp: str, now: datetime) -> str:
    """Return a time of the daemon in seconds, for a table that has the offset of `now` in its head: `08:40:57`.

    It has its date before it if that is another one, and its offset behind it if that is another one.
    """
    at = datetime.fromisoformat(stamp).astimezone()
    own = offset(at)
    text = f"{at:%Y-%m-%d %H:%M:%S}".removeprefix(f"{now:%Y-%m-%d} ")
    return text if own == offset(now) else f"{text} {own}"


def wall_text(stamp_ns: int) -> str:
    """Return a wall time in seconds, with its date and offset: `2026-11-22 08:40:57 UTC+1`."""
    at = datetime.fromtimestamp(stamp_ns // NS_PER_S, UTC).astimezone()
    return f"{at:%Y-%m-%d %H:%M:%S} {offset(at)}"
