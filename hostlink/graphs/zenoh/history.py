"""Messages that publishers keep for those who subscribe later, as rmw_zenoh does for transient local durability."""

from typing import Any

HEARTBEAT_S = 0.5  # while something is kept: a subscriber notices that it has missed it


def declare_keeping_publisher(session: Any, kept: int, key: str, **quality: Any) -> Any:
    """Declare a publisher that sends the newest messages, as many as are `kept`, to each who comes."""
    from zenoh import ext  # noqa: PLC0415 - an optional dependency

    return ext.declare_advanced_publisher(
        session,
        key,
        cache=ext.CacheConfig(kept),
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT_S),
        publisher_detection=True,
        **quality,
    )


def declare_history_subscriber(session: Any, key: str, callback: Any, *, allowed_origin: Any) -> Any:
    """Declare a subscriber that requests the newest message that each publisher keeps."""
    from zenoh import ext  # noqa: PLC0415 - an optional dependency

    return ext.declare_advanced_subscriber(
        session,
        key,
        callback,
        allowed_origin=allowed_origin,
        history=ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
        recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
        subscriber_detection=True,
    )
