"""Metrics for Prometheus: counters of the host and of the clients, read at each request, and latencies."""

import asyncio
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import version
from itertools import islice
from typing import NamedTuple, TypeVar

from aiohttp import web
from prometheus_client import CONTENT_TYPE_LATEST, ProcessCollector, generate_latest
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)

from hostlink.components.gateway.clients import Clients
from hostlink.components.gateway.listener import ApiConnections
from hostlink.components.gateway.rest import Owners
from hostlink.components.gateway.routes import Route
from hostlink.components.recorder.black_box import BlackBox
from hostlink.components.recorder.folder import MEGABYTE, DiskUsage, Folder
from hostlink.components.recorder.recordings import Recordings
from hostlink.core.host import Host, LinkMeasures, RobotMeasures
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.runtime import logs
from hostlink.core.runtime.latency import Latency
from hostlink.core.runtime.rate_limit import RateLimit

DISK_INTERVAL_S = 5.0  # between two measurements of the disk: a folder may have thousands of files
DISK_TIMEOUT_S = 1.0  # without an answer of the disk its figures are omitted
SLICE = 8  # robots or links whose metrics are made at once
SLICE_S = 0.001  # of one turn of the event loop; a histogram of SLICE links takes twice as long

_LINK_COUNTERS = {
    "frames_from_device": "Frames received",
    "frames_to_device": "Frames sent",
    "bytes_from_device": "Bytes received",
    "bytes_to_device": "Bytes sent",
    "skipped_bytes": "Bytes that are not part of a frame",
    "unknown_ids": "Frames of a topic that the device never announced",
    "refused_frames": "Frames refused",
    "malformed": "Control frames with an invalid payload",
    "excess_topics": "Topics over the bound of one device",
    "negotiations": "Topic announcements of the device",
    "topic_requests": "Requests for the device's topics",
    "lost_messages": "Messages lost on their way, by the gaps in their numbers",
}

_LINK_CLOCK = {
    "offset_s": ("clock_offset_seconds", "Smallest time from a header stamp to its arrival"),
    "drift_ppm": ("clock_drift_ppm", "How much faster the device's clock runs than the host's"),
    "round_trip_s": ("round_trip_seconds", "Round trip of the network, as TCP measures it"),
    "answer_s": ("answer_seconds", "Time from a topic request to the first answer"),
}

_DISK = {
    "used_bytes": "Size of the files in the folder",
    "budget_bytes": "Size limit; above it the oldest files are removed",
    "free_bytes": "Free on the folder's disk",
    "min_free_bytes": "Free space to keep; below it a recording ends",
}

Item = TypeVar("Item")
_Family = TypeVar("_Family", CounterMetricFamily, GaugeMetricFamily)
_Samples = Iterable[tuple[str | tuple[str, ...], float | None]]  # values by their labels; None: there is no value


def _counter(name: str, text: str, found: float | _Samples, *labels: str) -> CounterMetricFamily:
    return _filled(CounterMetricFamily(f"hostlink_{name}", text, labels=labels), found)


def _gauge(name: str, text: str, found: float | _Samples, *labels: str) -> GaugeMetricFamily:
    return _filled(GaugeMetricFamily(f"hostlink_{name}", text, labels=labels), found)


def _filled(family: _Family, found: float | _Samples) -> _Family:
    """Add the samples to the family: one value without labels, or values by their labels."""
    for labels, value in [((), found)] if isinstance(found, int | float) else found:
        if value is not None:
            family.add_metric((labels,) if isinstance(labels, str) else labels, value)
    return family


class Metrics:
    """The metrics of one daemon. Each request reads the host, clients and recordings: no counter exists twice."""

    def __init__(
        self,
        host: Host,
        clients: Clients,
        limit: RateLimit,
        connections: ApiConnections,
        owners: Owners,
    ) -> None:
        self.to_client = Latency()  # from the arrival of a message to the client's socket
        self._host, self._measures = host, host.measures
        self._clients, self._limit, self._connections, self._owners = clients, limit, connections, owners
        self._process = ProcessCollector(registry=None)
        self._looking: asyncio.Future[dict[str, DiskUsage]] | None = None
        self._usage: dict[str, DiskUsage] = {}
        self._disk_due_s = 0.0

    def route(self) -> Route:
        """Return the route GET /metrics."""
        return Route("/metrics", self._show, response=None, media_type="text/plain")

    async def _show(self, _: web.Request) -> web.Response:
        """Metrics for Prometheus."""
        await self._observe_disk()
        body = await text_of(self._collect())
        return web.Response(body=body, headers={"Content-Type": CONTENT_TYPE_LATEST, "Cache-Control": "no-store"})

    async def _observe_disk(self) -> None:
        """Measure the disk in a thread, one measurement at a time and at most every DISK_INTERVAL_S."""
        loop, recordings = asyncio.get_running_loop(), self._host.offered(Recordings)
        if recordings is not None and self._looking is None and loop.time() >= self._disk_due_s:
            folders = {"recordings": recordings.folder, "incidents": recordings.black_box.folder}
            self._looking = loop.run_in_executor(None, _usage_of, folders)
            self._looking.add_done_callback(self._note_usage)
        if self._looking is not None:
            found, _ = await asyncio.wait({self._looking}, timeout=DISK_TIMEOUT_S)
            if not found:
                self._usage = {}

    def _note_usage(self, measured: "asyncio.Future[dict[str, DiskUsage]]") -> None:
        self._looking, self._disk_due_s = None, asyncio.get_running_loop().time() + DISK_INTERVAL_S
        self._usage = {} if measured.cancelled() else measured.result()

    def _collect(self) -> Iterator[Metric]:
        yield from self._process.collect()
        yield from self._of_daemon()
        for robots in _slices(self._measures.robots()):
            yield from self._of_robots(robots)
        for links in _slices(self._measures.links()):
            yield from self._of_links(links)
        yield from self._of_clients()
        if (recordings := self._host.offered(Recordings)) is not None:
            yield from _of_recordings(recordings)
            yield from _of_black_box(recordings.black_box)
        for name, text in _DISK.items():
            usage = [(folder, getattr(each, name)) for folder, each in self._usage.items()]
            yield _gauge(f"disk_{name}", text, usage, "folder")

    def _of_daemon(self) -> Iterator[Metric]:
        found = self._measures.daemon()
        yield InfoMetricFamily("hostlink", "This daemon", value={"version": version("hostlink")})
        yield _gauge("links", "Live connections of devices", found.links)
        yield _counter(
            "link_crashes", "Connections ended by an internal error of hostlink", found.crashes.get("link", 0)
        )
        yield _counter(
            "messages_unheard", "Messages of devices whose topics were not known in time", found.messages_unheard
        )
        yield _counter("crashes", "Internal errors, by what they ended", found.crashes.items(), "what")
        yield _counter(
            "device_calls_refused", "Service calls of devices refused because of a limit", found.device_calls_refused
        )
        yield _counter("service_late_answers", "Answers of devices' services after their timeout", found.late_answers)
        yield _counter(
            "messages_out_of_order",
            "Messages delivered before their turn because too many waited",
            found.messages_out_of_order,
        )
        yield _counter("log_lines_lost", "Log lines that could not be written", logs.output.lost_lines)
        yield _counter("log_lines_left_out", "Log lines over the budget of their source", logs.budget.left_out)
        yield _counter("connections_refused", "Devices refused, by cause", found.refused.items(), "cause")
        yield _counter("datagrams_dropped", "UDP datagrams dropped, by cause", found.datagrams_dropped.items(), "cause")
        events = [
            ((graph, what), count) for graph, counts in found.components.items() for what, count in counts.items()
        ]
        yield _counter("graph_events", "Events of a graph", events, "graph", "what")
        yield _gauge("fleet_robots", "Connected robots of other daemons", found.fleet_robots.items(), "host")
        yield _counter(
            "robots_forgotten",
            "Robots forgotten after a long disconnection, or because of too many",
            found.robots_forgotten,
        )
        held = [(kind, share.held_bytes) for kind, share in found.kept.items()]
        yield _gauge("kept_bytes", "Bytes from clients that are kept, by kind", held, "kind")
        refused = [(kind, share.refused) for kind, share in found.kept.items()]
        yield _counter("kept_refused", "Items refused because the byte budget of their kind was full", refused, "kind")

    def _of_robots(self, robots: Sequence[RobotMeasures]) -> Iterator[Metric]:
        odometry = [(each.name, each.odometry) for each in robots if each.odometry is not None]
        connected = [(each.name, each.is_connected) for each in robots]
        yield _gauge("robot_connected", "1 while its device is connected", connected, "robot")
        ages_s = [(name, found.age_s) for name, found in odometry]
        yield _gauge("robot_odometry_age_seconds", "Age of the newest pose", ages_s, "robot")
        yield _counter("robot_poses", "Poses received", [(name, found.count) for name, found in odometry], "robot")
        refused = [(each.name, each.velocities_refused) for each in robots]
        yield _counter("robot_velocity_refused", "Velocities that the device could not receive", refused, "robot")
        unreadable = [(each.name, each.unreadable) for each in robots]
        yield _counter("robot_unreadable", "Odometry messages that could not be decoded", unreadable, "robot")
        outcomes = [
            *(((each.name, name), n) for each in robots for name, n in each.outcomes.items()),
            *(((each.name, f"refused_{kind}"), n) for each in robots for kind, n in each.refusals.items()),
        ]
        yield _counter("robot_gate", "Commands at the velocity gate, by outcome", outcomes, "robot", "outcome")
        locked = [(each.name, each.is_locked) for each in robots]
        yield _gauge("robot_locked", "1 while the robot is locked", locked, "robot")
        driven = [(each.name, each.is_driven) for each in robots]
        yield _gauge("robot_driven", "1 while the robot is driven", driven, "robot")
        commanded = [sample for each in robots for sample in _by_axis(each.name, each.commanded)]
        yield _gauge("robot_commanded_speed", "Commanded, m/s and rad/s", commanded, "robot", "axis")
        measured = [sample for name, found in odometry if found.twist for sample in _by_axis(name, found.twist)]
        yield _gauge("robot_speed", "Measured, m/s and rad/s", measured, "robot", "axis")
        volts = [(each.name, each.battery_v) for each in robots]
        yield _gauge("robot_battery_volts", "Measured by the device", volts, "robot")

    def _of_links(self, found: Sequence[LinkMeasures]) -> Iterator[Metric]:
        names = ("peer", "robot")
        links = [((each.address, each.robot), each, each.facts) for each in found]
        for name, text in _LINK_COUNTERS.items():
            counts = [(labels, getattr(facts.counts, name)) for labels, _, facts in links]
            yield _counter(f"link_{name}", text, counts, *names)
        replaced = [(labels, facts.replaced) for labels, _, facts in links]
        yield _counter("link_replaced", "Messages replaced by a newer one", replaced, *names)
        for name, (metric, text) in _LINK_CLOCK.items():
            readings = [(labels, getattr(facts.clock, name, None)) for labels, _, facts in links]
            yield _gauge(f"link_{metric}", text, readings, *names)
        rejected = [((*labels, cause), n) for labels, _, facts in links for cause, n in facts.rejected.items()]
        yield _counter("link_rejected", "False starts of frames, by cause", rejected, *names, "cause")
        silent_s = [(labels, link.silent_s) for labels, link, _ in links]
        yield _gauge("link_silent_seconds", "Time since the last byte", silent_s, *names)
        oldest_s = [(labels, facts.oldest_waiting_s) for labels, _, facts in links]
        yield _gauge(
            "link_oldest_waiting_seconds", "Age of the oldest frame that waits for the device", oldest_s, *names
        )
        latency = HistogramMetricFamily(
            "hostlink_command_to_device_seconds", "Time from a velocity command to the device's socket", labels=names
        )
        for labels, link, _ in links:
            latency.add_metric(labels, link.command_latency.buckets(), link.command_latency.sum_s)
        yield latency

    def _of_clients(self) -> Iterator[Metric]:
        clients = self._clients.views()
        kinds = Counter(client["kind"] for client in clients)
        found = [(kind, kinds[kind]) for kind in ("rosbridge", "foxglove", "events")]
        yield _gauge("clients", "Connected clients", found, "kind")
        dropped = self._clients.gone_dropped + sum(client["dropped"] for client in clients)
        yield _counter("client_dropped", "Messages dropped for slow clients", dropped)
        waiting_bytes = sum(client["waiting_bytes"] for client in clients)
        yield _gauge("client_waiting_bytes", "Bytes that wait for clients", waiting_bytes)
        lag_s = max((client["lag_s"] for client in clients), default=0.0)
        yield _gauge("client_lag_seconds", "Age of the oldest message that waits for a client", lag_s)
        yield _counter("clients_refused", "Clients refused because there were too many", self._clients.refused)
        yield HistogramMetricFamily(
            "hostlink_device_to_client_seconds",
            "Time from the arrival of a message to the client's socket",
            buckets=self.to_client.buckets(),
            sum_value=self.to_client.sum_s,
        )
        yield _counter("owners_evicted", "REST participants removed at the limit", self._owners.evicted)
        yield _counter("requests_refused", "Requests refused by the rate limit", self._limit.refused)
        yield _counter(
            "velocities_replaced",
            "Velocities of clients replaced by a newer one before they were executed",
            self._clients.velocities_replaced.items(),
            "kind",
        )
        yield _gauge("api_connections", "TCP connections to the API's port", len(self._connections))
        closed = self._connections.closed.items()
        yield _counter("api_connections_closed", "Connections refused or closed by hostlink, by cause", closed, "cause")


def _of_recordings(recordings: Recordings) -> Iterator[Metric]:
    totals = recordings.totals()
    yield _gauge("recordings_running", "Running recordings", len(recordings.under_way()))
    yield _counter("recording_messages", "Messages written", totals.messages)
    yield _counter("recording_bytes", "Bytes written", totals.written_bytes)
    yield _counter("recording_dropped", "Messages dropped because the disk was too slow or full", totals.dropped)
    yield _counter("recordings_failed", "Recordings that failed", recordings.failed)
    yield _counter("recordings_removed", "Old files removed for the budget", recordings.removed)


def _of_black_box(box: BlackBox) -> Iterator[Metric]:
    config = box.config
    yield _gauge("incidents_pending", "Incidents not saved yet", len(box.pending))
    outcomes = [("saved", box.saved), ("failed", box.missed)]
    yield _counter("incidents", "Incidents, by outcome", outcomes, "outcome")
    yield _gauge("black_box_bytes", "Memory of the black box", box.rings.size_bytes)
    max_bytes = config.max_memory_mb * MEGABYTE if config.enabled else 0
    yield _gauge("black_box_max_bytes", "Memory limit of the black box; 0: off", max_bytes)
    keep_s = config.before_s if config.enabled else 0
    yield _gauge("black_box_keep_seconds", "Time before an incident that is saved; 0: off", keep_s)
    yield _counter("black_box_dropped", "Messages removed early because of the memory limit", box.rings.dropped)


def _by_axis(robot: str, velocity: PlanarVelocity) -> Iterator[tuple[tuple[str, str], float]]:
    for axis, value in zip(("linear", "linear_y", "angular"), velocity, strict=True):
        yield (robot, axis), value


def _slices(items: Iterator[Item]) -> Iterator[Sequence[Item]]:
    """Yield SLICE items at a time; nothing once if there are none, so that each family has its comment."""
    piece = list(islice(items, SLICE))
    yield piece
    while piece := list(islice(items, SLICE)):
        yield piece


def _usage_of(folders: dict[str, Folder]) -> dict[str, DiskUsage]:
    """Return the usage of the folders whose disk can be read."""
    found = {}
    for name, folder in folders.items():
        try:
            found[name] = folder.usage()
        except OSError:  # the figure is omitted
            continue
    return found


class _Part(NamedTuple):
    """One part of a family, as `generate_latest` reads it."""

    metric: Metric

    def collect(self) -> tuple[Metric]:
        return (self.metric,)


async def text_of(parts: Iterable[Metric]) -> bytes:
    """Return the text of families that come in parts. Only the first part of a family has its two lines of comment.

    The metrics of a thousand robots take half a second, in which no command may wait: others have their turn each
    SLICE_S.
    """
    texts: dict[str, bytearray] = {}  # by name of the family
    now_s = asyncio.get_running_loop().time
    ends_s = now_s() + SLICE_S
    for part in parts:
        text = generate_latest(_Part(part))
        if part.name in texts:
            text = text.split(b"\n", 2)[2]
        texts.setdefault(part.name, bytearray()).extend(text)
        if now_s() >= ends_s:
            await asyncio.sleep(0)
            ends_s = now_s() + SLICE_S
    return b"".join(texts.values())
