"""Metrics for Prometheus: the counters of the hub and of the clients, read at each request, and latencies."""

import asyncio
import dataclasses
from collections import Counter
from collections.abc import Iterator
from importlib.metadata import version

from aiohttp import web
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from hostlink import logs
from hostlink.api.clients import Clients
from hostlink.api.connections import Connections
from hostlink.api.rate_limit import RateLimit
from hostlink.api.rest import Owners
from hostlink.api.routes import Route
from hostlink.config import Config
from hostlink.hub.hub import Hub
from hostlink.latency import Latency
from hostlink.recording.folder import MEGABYTE, DiskUsage, Folder
from hostlink.recording.recordings import Recordings

DISK_INTERVAL_S = 5.0  # between two looks at the disk: a folder may have thousands of files
DISK_TIMEOUT_S = 1.0  # a disk that does not answer leaves its figures out, and nothing else


class RecordingMetrics(Collector):
    """Call `observe_disk` before each collection: it waits for the disk, the rest does not."""

    def __init__(self, recordings: Recordings, config: Config) -> None:
        self._recordings, self._config = recordings, config
        self._folders = {"recordings": recordings.folder, "incidents": recordings.black_box.folder}
        self._looking: asyncio.Future[dict[str, DiskUsage]] | None = None
        self._usage: dict[str, DiskUsage] = {}
        self._due_s = 0.0

    def describe(self) -> list[Metric]:
        """Nothing at registration: there is no event loop yet."""
        return []

    async def observe_disk(self) -> None:
        """Look at the disk in a thread, one at a time and not too often."""
        loop = asyncio.get_running_loop()
        if self._looking is None and loop.time() >= self._due_s:
            self._looking = loop.run_in_executor(None, _usage_of, self._folders)
            self._looking.add_done_callback(self._note_usage)
        if self._looking is not None:
            found, _ = await asyncio.wait({self._looking}, timeout=DISK_TIMEOUT_S)
            if not found:
                self._usage = {}

    def _note_usage(self, looked: "asyncio.Future[dict[str, DiskUsage]]") -> None:
        self._looking, self._due_s = None, asyncio.get_running_loop().time() + DISK_INTERVAL_S
        self._usage = {} if looked.cancelled() else looked.result()

    def collect(self) -> Iterator[Metric]:
        yield from self._of_recordings()
        yield from self._of_black_box()
        yield from self._of_disk()

    def _of_recordings(self) -> Iterator[Metric]:
        recordings = self._recordings
        totals = recordings.totals()
        yield GaugeMetricFamily(
            "hostlink_recordings_running", "Recordings under way", value=len(recordings.under_way())
        )
        yield CounterMetricFamily("hostlink_recording_messages", "Messages written", value=totals.messages)
        yield CounterMetricFamily("hostlink_recording_bytes", "Bytes written", value=totals.written_bytes)
        yield CounterMetricFamily(
            "hostlink_recording_dropped", "Messages that the disk was too slow for, or had no room for",
            value=totals.dropped,
        )  # fmt: skip
        yield CounterMetricFamily(
            "hostlink_recordings_failed", "Recordings that ended before they were stopped", value=recordings.failed
        )
        yield CounterMetricFamily(
            "hostlink_recordings_removed", "Old files that were removed for the budget", value=recordings.removed
        )

    def _of_black_box(self) -> Iterator[Metric]:
        box, config = self._recordings.black_box, self._config.black_box
        yield GaugeMetricFamily("hostlink_incidents_pending", "Incidents that are to be saved", value=len(box.pending))
        incidents = CounterMetricFamily("hostlink_incidents", "Incidents, by what became of them", labels=["outcome"])
        incidents.add_metric(["saved"], box.saved)
        incidents.add_metric(["failed"], box.missed)
        yield incidents
        yield GaugeMetricFamily(
            "hostlink_black_box_bytes", "Memory that the last minutes take", value=box.rings.size_bytes
        )
        yield GaugeMetricFamily(
            "hostlink_black_box_max_bytes",
            "Memory that they may take; 0: it is off",
            value=config.max_memory_mb * MEGABYTE if config.enabled else 0,
        )
        yield GaugeMetricFamily(
            "hostlink_black_box_keep_seconds",
            "How far back an incident reaches; 0: it is off",
            value=config.before_s if config.enabled else 0,
        )
        yield CounterMetricFamily(
            "hostlink_black_box_dropped",
            "Messages that went before their time, for want of memory",
            value=box.rings.dropped,
        )

    def _of_disk(self) -> Iterator[Metric]:
        figures = {
            name: GaugeMetricFamily(f"hostlink_disk_{name}", help_, labels=["folder"])
            for name, help_ in {
                "used_bytes": "Of the files in the folder",
                "budget_bytes": "What they may take; over it the oldest go",
                "free_bytes": "Free on the folder's disk",
                "min_free_bytes": "What must stay free on it; below it a recording ends",
            }.items()
        }
        for folder, usage in self._usage.items():
            for name, figure in figures.items():
                figure.add_metric([folder], getattr(usage, name))
        yield from figures.values()


def _usage_of(folders: dict[str, Folder]) -> dict[str, DiskUsage]:
    """Of those whose disk can be read."""
    found = {}
    for name, folder in folders.items():
        try:
            found[name] = folder.usage()
        except OSError:  # the figure is missing, which is one
            continue
    return found


_LINK_COUNTERS = {
    "frames_from_device": "Frames that came",
    "frames_to_device": "Frames that left",
    "bytes_from_device": "Bytes that came",
    "bytes_to_device": "Bytes that left",
    "skipped_bytes": "Bytes that were no frame",
    "unknown_ids": "Frames of a topic that the device never announced",
    "refused_frames": "Frames that were refused",
    "malformed": "Control frames whose payload makes no sense",
    "excess_topics": "Topics over the bound of one device",
    "negotiations": "Times that the device announced its topics",
    "topic_requests": "Requests for its topics",
}

_LINK_CLOCK = {
    "offset_s": ("clock_offset_seconds", "From a header stamp to its arrival, on the fastest way"),
    "drift_ppm": ("clock_drift_ppm", "How much faster the device's clock runs than the host's"),
    "round_trip_s": ("round_trip_seconds", "Of the network, as TCP measures it"),
    "answer_s": ("answer_seconds", "From a request for the device's topics to the first of them"),
}


class Metrics:
    """The registry of one daemon."""

    def __init__(
        self,
        hub: Hub,
        clients: Clients,
        limit: RateLimit,
        connections: Connections,
        owners: Owners,
        recordings: Recordings,
    ) -> None:
        self._registry = CollectorRegistry()
        ProcessCollector(registry=self._registry)
        self.to_client = Latency()  # from the arrival of a message to the client's socket
        self._registry.register(_Graph(hub, clients, limit, connections, owners, self.to_client))
        self._recording = RecordingMetrics(recordings, hub.config)
        self._registry.register(self._recording)

    def route(self) -> Route:
        """GET /metrics."""
        return Route(
            "/metrics",
            self._show,
            "Metrics for Prometheus",
            response=None,
            media_type="text/plain",
        )

    async def _show(self, _: web.Request) -> web.Response:
        await self._recording.observe_disk()
        body = generate_latest(self._registry)
        return web.Response(body=body, headers={"Content-Type": CONTENT_TYPE_LATEST, "Cache-Control": "no-store"})


class _Graph(Collector):
    """Reads the hub and the clients at each request: nothing is counted twice."""

    def __init__(
        self,
        hub: Hub,
        clients: Clients,
        limit: RateLimit,
        connections: Connections,
        owners: Owners,
        to_client: Latency,
    ) -> None:
        self._hub, self._clients, self._limit, self._connections = hub, clients, limit, connections
        self._owners, self._to_client = owners, to_client

    def describe(self) -> list[Metric]:
        """Nothing at registration: there is no event loop yet."""
        return []

    def collect(self) -> Iterator[Metric]:
        yield InfoMetricFamily("hostlink", "This daemon", value={"version": version("hostlink")})
        yield GaugeMetricFamily("hostlink_links", "Live connections of devices", value=len(self._hub.links.all()))
        yield CounterMetricFamily(
            "hostlink_link_crashes",
            "Connections that a fault of hostlink ended",
            value=self._hub.isolation.crashes["link"],
        )
        yield CounterMetricFamily(
            "hostlink_messages_unheard",
            "Messages of devices that were not known in time",
            value=self._hub.links.undelivered,
        )
        crashes = CounterMetricFamily("hostlink_crashes", "Faults of hostlink, by what they ended", labels=["what"])
        for what, count in self._hub.isolation.crashes.items():
            crashes.add_metric([what], count)
        yield crashes
        yield CounterMetricFamily(
            "hostlink_device_calls_refused",
            "Calls of services by devices that were over a bound",
            value=self._hub.links.calls.refused,
        )
        yield CounterMetricFamily(
            "hostlink_service_late_answers",
            "Answers of devices' services that nobody waited for any more",
            value=self._hub.links.late_answers,
        )
        yield CounterMetricFamily(
            "hostlink_messages_out_of_order",
            "Messages that were delivered before their turn: too many waited",
            value=self._hub.topics.deliveries.out_of_order,
        )
        yield CounterMetricFamily(
            "hostlink_log_lines_lost", "Lines that could not be written", value=logs.output.lost_lines
        )
        yield CounterMetricFamily(
            "hostlink_log_lines_left_out", "Lines over the budget of who caused them", value=logs.budget.left_out
        )
        refused = CounterMetricFamily("hostlink_connections_refused", "Devices turned away, by cause", labels=["cause"])
        for cause, count in self._hub.counts.refused.items():
            refused.add_metric([cause], count)
        yield refused
        dropped = CounterMetricFamily("hostlink_datagrams_dropped", "Of UDP, either way, by cause", labels=["cause"])
        for cause, count in self._hub.counts.datagrams_dropped.items():
            dropped.add_metric([cause], count)
        yield dropped
        yield from self._graphs()
        yield from self._robots()
        yield from self._driving()
        yield from self._links()
        yield from self._to_clients()
        yield from self._kept()
        yield from self._to_port()

    def _graphs(self) -> Iterator[Metric]:
        events = CounterMetricFamily("hostlink_graph_events", "What of a graph has happened", labels=["graph", "what"])
        for graph, counts in self._hub.counts.graphs.items():
            for what, count in counts().items():
                events.add_metric([graph, what], count)
        yield events
        places: Counter[str] = Counter(robot.host for robot in self._hub.robots.remote.values() if robot.link)
        elsewhere = GaugeMetricFamily("hostlink_fleet_robots", "Connected robots of other daemons", labels=["host"])
        for host, count in places.items():
            elsewhere.add_metric([host], count)
        yield elsewhere

    def _robots(self) -> Iterator[Metric]:
        now_s = asyncio.get_running_loop().time()
        connected = GaugeMetricFamily("hostlink_robot_connected", "1 when its device is there", labels=["robot"])
        age = GaugeMetricFamily("hostlink_robot_odometry_age_seconds", "Since the newest pose", labels=["robot"])
        poses = CounterMetricFamily("hostlink_robot_poses", "Poses that came", labels=["robot"])
        refused = CounterMetricFamily(
            "hostlink_robot_velocity_refused", "Velocities that the device could not receive", labels=["robot"]
        )
        for robot in self._hub.robots.here():
            refused.add_metric([robot.name], robot.refusals.count)
            connected.add_metric([robot.name], robot.link is not None)
            odometry = robot.odometry.snapshot(now_s)
            if odometry is not None:
                age.add_metric([robot.name], odometry.age_s)
                poses.add_metric([robot.name], odometry.count)
        gates = CounterMetricFamily(
            "hostlink_robot_gate",
            "Commands at the velocity gate, by outcome",
            labels=["robot", "outcome"],
        )
        unreadable = CounterMetricFamily(
            "hostlink_robot_unreadable", "Messages of its odometry that are none", labels=["robot"]
        )
        for robot in self._hub.robots.here():
            unreadable.add_metric([robot.name], robot.unreadable)
            for outcome, count in dataclasses.asdict(robot.gate.counts).items():
                gates.add_metric([robot.name, outcome], count)
            for kind, count in robot.gate.admission.refused.items():
                gates.add_metric([robot.name, f"refused_{kind}"], count)
        forgotten = CounterMetricFamily(
            "hostlink_robots_forgotten",
            "Robots that were away for long, or before many others",
            value=self._hub.robots.forgotten,
        )
        yield from (connected, age, poses, refused, unreadable, gates, forgotten)

    def _driving(self) -> Iterator[Metric]:
        now_s = asyncio.get_running_loop().time()
        locked = GaugeMetricFamily("hostlink_robot_locked", "1 while nobody may drive it", labels=["robot"])
        driven = GaugeMetricFamily("hostlink_robot_driven", "1 while somebody drives it", labels=["robot"])
        commanded = GaugeMetricFamily(
            "hostlink_robot_commanded_speed", "What it is sent, m/s and rad/s", labels=["robot", "axis"]
        )
        measured = GaugeMetricFamily("hostlink_robot_speed", "By its odometry, m/s and rad/s", labels=["robot", "axis"])
        battery = GaugeMetricFamily("hostlink_robot_battery_volts", "As its device measures it", labels=["robot"])
        for robot in self._hub.robots.here():
            locked.add_metric([robot.name], robot.gate.lock_reason is not None)
            driven.add_metric([robot.name], robot.gate.owner is not None)
            if robot.battery is not None and robot.battery.voltage_v is not None:
                battery.add_metric([robot.name], robot.battery.voltage_v)
            odometry = robot.odometry.snapshot(now_s)
            sent = robot.gate.current
            commanded.add_metric([robot.name, "linear"], sent.x_m_s)
            commanded.add_metric([robot.name, "linear_y"], sent.y_m_s)
            commanded.add_metric([robot.name, "angular"], sent.yaw_rad_s)
            if odometry is not None:
                measured.add_metric([robot.name, "linear"], odometry.twist.x_m_s)
                measured.add_metric([robot.name, "linear_y"], odometry.twist.y_m_s)
                measured.add_metric([robot.name, "angular"], odometry.twist.yaw_rad_s)
        yield from (locked, driven, commanded, measured, battery)

    def _links(self) -> Iterator[Metric]:
        names = ["peer", "robot"]
        counters = {
            name: CounterMetricFamily(f"hostlink_link_{name}", help_, labels=names)
            for name, help_ in _LINK_COUNTERS.items()
        }
        replaced = CounterMetricFamily("hostlink_link_replaced", "Messages that a newer one replaced", labels=names)
        rejected = CounterMetricFamily(
            "hostlink_link_rejected", "False starts of frames, by cause", labels=[*names, "cause"]
        )
        silent = GaugeMetricFamily("hostlink_link_silent_seconds", "Since the last byte", labels=names)
        oldest = GaugeMetricFamily(
            "hostlink_link_oldest_waiting_seconds", "Age of the oldest frame that waits for the device", labels=names
        )
        clocks = {
            name: GaugeMetricFamily(f"hostlink_link_{metric}", help_, labels=names)
            for name, (metric, help_) in _LINK_CLOCK.items()
        }
        latency = HistogramMetricFamily(
            "hostlink_command_to_device_seconds", "From a velocity's command to the device's socket", labels=names
        )
        for link in self._hub.links.all():
            robot = self._hub.robots.of_link(link)
            labels = [link.address, "" if robot is None else robot.name]
            facts = link.facts()
            for name, counter in counters.items():
                counter.add_metric(labels, getattr(facts.counts, name))
            replaced.add_metric(labels, facts.replaced)
            for cause, count in facts.rejected.items():
                rejected.add_metric([*labels, cause], count)
            silent.add_metric(labels, link.silent_s)
            oldest.add_metric(labels, facts.oldest_waiting_s)
            for name, gauge in clocks.items():
                value = getattr(facts.clock, name, None)
                if value is not None:
                    gauge.add_metric(labels, value)
            latency.add_metric(labels, link.command_latency.buckets(), link.command_latency.sum_s)
        yield from (*counters.values(), replaced, *clocks.values(), rejected, silent, oldest, latency)

    def _to_clients(self) -> Iterator[Metric]:
        clients = self._clients.views()
        kinds = GaugeMetricFamily("hostlink_clients", "Clients that are connected", labels=["kind"])
        for kind in ("rosbridge", "foxglove", "events"):
            kinds.add_metric([kind], sum(client["kind"] == kind for client in clients))
        yield kinds
        dropped = self._clients.gone_dropped + sum(client["dropped"] for client in clients)
        yield CounterMetricFamily("hostlink_client_dropped", "Messages that clients were too slow for", value=dropped)
        yield GaugeMetricFamily(
            "hostlink_client_waiting_bytes",
            "Bytes that wait for clients",
            value=sum(client["waiting_bytes"] for client in clients),
        )
        yield GaugeMetricFamily(
            "hostlink_client_lag_seconds",
            "How old the oldest message is that waits for a client",
            value=max((client["lag_s"] for client in clients), default=0.0),
        )
        yield CounterMetricFamily(
            "hostlink_clients_refused", "Clients turned away: too many", value=self._clients.refused
        )
        yield HistogramMetricFamily(
            "hostlink_device_to_client_seconds",
            "From the arrival of a message to the client's socket",
            buckets=self._to_client.buckets(),
            sum_value=self._to_client.sum_s,
        )
        yield CounterMetricFamily(
            "hostlink_owners_evicted", "Drivers over REST that others took the place of", value=self._owners.evicted
        )
        yield CounterMetricFamily(
            "hostlink_requests_refused", "Requests turned away: too many a second", value=self._limit.refused
        )

    def _kept(self) -> Iterator[Metric]:
        held = GaugeMetricFamily("hostlink_kept_bytes", "What clients have sent and is kept, by kind", labels=["kind"])
        refused = CounterMetricFamily(
            "hostlink_kept_refused", "What found no room in the bytes of its kind, and was not kept", labels=["kind"]
        )
        for kind, share in self._hub.budget.shares.items():
            held.add_metric([kind], share.held_bytes)
            refused.add_metric([kind], share.refused)
        replaced = CounterMetricFamily(
            "hostlink_velocities_replaced",
            "Velocities of clients that a newer one replaced before they were obeyed",
            labels=["kind"],
        )
        for kind, count in self._hub.counts.velocities_replaced.items():
            replaced.add_metric([kind], count)
        yield from (held, refused, replaced)

    def _to_port(self) -> Iterator[Metric]:
        yield GaugeMetricFamily(
            "hostlink_api_connections", "TCP connections to the API's port", value=len(self._connections)
        )
        closed = CounterMetricFamily(
            "hostlink_api_connections_closed", "That hostlink refused or cut, by cause", labels=["cause"]
        )
        for cause, count in self._connections.closed.items():
            closed.add_metric([cause], count)
        yield closed
