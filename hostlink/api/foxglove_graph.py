"""Connection graph: what of it has changed since it was sent to a client of Foxglove's protocol. Pure."""

from typing import Any

from hostlink.api.foxglove_directory import ConnectionGraph, Names

NO_GRAPH = ConnectionGraph({}, {}, {})


def graph_update(before: ConnectionGraph, now: ConnectionGraph) -> dict[str, Any] | None:
    """The JSON of the changes; None: there are none."""
    topics_before = before.publishers.keys() | before.subscribers.keys()
    removed = topics_before - now.publishers.keys() - now.subscribers.keys()
    update = {
        "publishedTopics": _changes(before.publishers, now.publishers, removed, "publisherIds"),
        "subscribedTopics": _changes(before.subscribers, now.subscribers, removed, "subscriberIds"),
        "advertisedServices": _changes(before.providers, now.providers, set(before.providers), "providerIds"),
        "removedTopics": sorted(removed),
        "removedServices": sorted(before.providers.keys() - now.providers.keys()),
    }
    return {"op": "connectionGraphUpdate", **update} if any(update.values()) else None


def _changes(before: Names, now: Names, removed: set[str], ids: str) -> list[dict[str, Any]]:
    """A name whose nodes are others; one without nodes that stays for another reason has none from now on."""
    changed = [{"name": name, ids: nodes} for name, nodes in now.items() if before.get(name) != nodes]
    return changed + [{"name": name, ids: []} for name in before if name not in now and name not in removed]
