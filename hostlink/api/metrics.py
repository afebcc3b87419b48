"""Metrics for Prometheus: counters of the hub and of the clients, read at each request, and latencies."""

import asyncio
import dataclasses
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import version
from typing import TypeVar

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
from hostlink.api.listener import ApiConnections
from hostlink.api.rate_limit import RateLimit
from hostlink.api.rest import Owners
from hostlink.api.routes import Route
from hostlink.config import Config
from hostlink.hub.device import Device
from hostlink.hub.hub import Hub
from hostlink.hub.robot import LocalRobot
from hostlink.latency import Latency
from hostlink.recording.folder import MEGABYTE, DiskUsage, Folder
from hostlink.recording.recordings import Recordings

DISK_INTERVAL_S = 5.0  # between two measurements of the disk: a folder may have thousands of files
DISK_TIMEOUT_S = 1.0  # without an answer of the disk its figures are omitted
SLICE = 8  # robots or links whose metrics are made at once
SLICE_S = 0.001  # of one turn of the event loop; a histogram of SLICE links takes twice as long

Item = TypeVar("Item")


class RecordingMetrics(Collector):
    """Metrics of recordings. Call `observe_disk` before each collection: it waits for the disk, the rest does not."""

    def __init__(self, recordings: Recordings, config: Config) -> None:
        self._recordings, self._config = recordings, config
        self._folders = {"recordings": recordings.folder, "incidents": recordings.black_box.folder}
        self._looking: asyncio.Future[dict[str, DiskUsage]] | None = None
        self._usage: dict[str, DiskUsage] = {}
        self._due_s = 0.0

    def describe(self) -> list[Metric]:
        """Return nothing at registration: there is no event loop yet."""
        return []

    async def observe_disk(self) -> None:
        """Measure the disk in a thread, one measurement at a time and at most every DISK_INTERVAL_S."""
        loop = asyncio.get_running_loop()
        if self._looking is None and loop.time() >= self._due_s:
            self._looking = loop.run_in_executor(None, _usage_of, self._folders)
            self._looking.add_done_callback(self._note_usage)
        if self._looking is not None:
            found, _ = await asyncio.wait({self._looking}, timeout=DISK_TIMEOUT_S)
            if not found:
                self._usage = {}

    def _note_usage(self, measured: "asyncio.Future[dict[str, DiskUsage]]") -> None:
        self._looking, self._due_s = None, asyncio.get_running_loop().time() + DISK_INTERVAL_S
        self._usage = {} if measured.cancelled() else measured.result()

    def collect(self) -> Iterator[Metric]:
        yield from self._of_recordings()
        yield from self._of_black_box()
        yield from self._of_disk()

    def _of_recordings(self) -> Iterator[Metric]:
        recordings = self._recordings
        totals = recordings.totals()
        yield GaugeMetricFamily("hostlink_recordings_running", "Running recordings", value=len(recordings.under_way()))
        yield CounterMetricFamily("hostlink_recording_messages", "Messages written", value=totals.messages)
        yield CounterMetricFamily("hostlink_recording_bytes", "Bytes written", value=totals.written_bytes)
        yield CounterMetricFamily(
            "hostlink_recording_dropped", "Messages dropped because the disk was too slow or full",
            value=totals.dropped,
        )  # fmt: skip
        yield CounterMetricFamily("hostlink_recordings_failed", "Recordings that failed", value=recordings.failed)
        yield CounterMetricFamily(
            "hostlink_recordings_removed", "Old files removed for the budget", value=recordings.removed
        )

    def _of_black_box(self) -> Iterator[Metric]:
        box, config = self._recordings.black_box, self._config.black_box
        yield GaugeMetricFamily("hostlink_incidents_pending", "Incidents not saved yet", value=len(box.pending))
        incidents = CounterMetricFamily("hostlink_incidents", "Incidents, by outcome", labels=["outcome"])
        incidents.add_metric(["saved"], box.saved)
        incidents.add_metric(["failed"], box.missed)
        yield incidents
        yield GaugeMetricFamily("hostlink_black_box_bytes", "Memory of the black box", value=box.rings.size_bytes)
        yield GaugeMetricFamily(
            "hostlink_black_box_max_bytes",
            "Memory limit of the black box; 0: off",
            value=config.max_memory_mb * MEGABYTE if config.enabled else 0,
        )
        yield GaugeMetricFamily(
            "hostlink_black_box_keep_seconds",
            "Time before an incident that is saved; 0: off",
            value=config.before_s if config.enabled else 0,
        )
        yield CounterMetricFamily(
            "hostlink_black_box_dropped",
            "Messages removed early because of the memory limit",
            value=box.rings.dropped,
        )

    def _of_disk(self) -> Iterator[Metric]:
        figures = {
            name: GaugeMetricFamily(f"hostlink_disk_{name}", help_, labels=["folder"])
            for name, help_ in {
                "used_bytes": "Size of the files in the folder",
                "budget_bytes": "Size limit; above it the oldest files are removed",
                "free_bytes": "Free on the folder's disk",
                "min_free_bytes": "Free space to keep; below it a recording ends",
            }.items()
        }
        for folder, usage in self._usage.items():
            for name, figure in figures.items():
                figure.add_metric([folder], getattr(usage, name))
        yield from figures.values()


def _usage_of(folders: dict[str, Folder]) -> dict[str, DiskUsage]:
    """Return the usage of the folders whose disk can be read."""
    found = {}
    for name, folder in folders.items():
        try:
            found[name] = folder.usage()
        except OSError:  # the figure is omitted
            continue
    return found


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
}

_LINK_CLOCK = {
    "offset_s": ("clock_offset_seconds", "Smallest time from a header stamp to its arrival"),
    "drift_ppm": ("clock_drift_ppm", "How much faster the device's clock runs than the host's"),
    "round_trip_s": ("round_trip_seconds", "Round trip of the network, as TCP measures it"),
    "answer_s": ("answer_seconds", "Time from a topic request to the first answer"),
}


class Metrics:
    """The metrics registry of one daemon."""

    def __init__(
        self,
        hub: Hub,
        clients: Clients,
        limit: RateLimit,
        connections: ApiConnections,
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
        """Return the route GET /metrics."""
        return Route(
            "/metrics",
            self._show,
            "Metrics for Prometheus",
            response=None,
            media_type="text/plain",
        )

    async def _show(self, _: web.Request) -> web.Response:
        await self._recording.observe_disk()
        body = await text_of(self._registry.collect())
        return web.Response(body=body, headers={"Content-Type": CONTENT_TYPE_LATEST, "Cache-Control": "no-store"})


async def text_of(parts: Iterable[Metric]) -> bytes:
    """Return the text of families that come in parts.

    The metrics of a thousand robots take half a second, in which no command may wait: others have their turn each
    SLICE_S.
    """
    text, now_s = _Text(), asyncio.get_running_loop().time
    ends_s = now_s() + SLICE_S
    for part in parts:
        text.add(part)
        if now_s() >= ends_s:
            await asyncio.sleep(0)
            ends_s = now_s() + SLICE_S
    return text.encoded()


class _Text(Collector):
    """Text of families that come in parts."""

    def __init__(self) -> None:
        self._texts: dict[str, bytearray] = {}  # by name of the family
        self._part: tuple[Metric, ...] = ()

    def add(self, part: Metric) -> None:
        """Add a part. Only the first one of a family has its two lines of comment."""
        self._part = (part,)
        text = generate_latest(self)
        if part.name in self._texts:
            text = text.split(b"\n", 2)[2]
        self._texts.setdefault(part.name, bytearray()).extend(text)

    def collect(self) -> Sequence[Metric]:
        """Return the last part."""
        return self._part

    def encoded(self) -> bytes:
        """Return the text of all families."""
        return b"".join(self._texts.values())


def _slices(items: Sequence[Item]) -> Iterator[Sequence[Item]]:
    """Yield SLICE items at a time; nothing once if there are none, so that each family has its comment."""
    for start in range(0, max(len(items), 1), SLICE):
        yield items[start : start + SLICE]


class _Graph(Collector):
    """Reads the hub and the clients at each request, so that no counter exists twice."""

    def __init__(
        self,
        hub: Hub,
        clients: Clients,
        limit: RateLimit,
        connections: ApiConnections,
        owners: Owners,
        to_client: Latency,
    ) -> None:
        self._hub, self._clients, self._limit, self._connections = hub, clients, limit, connections
        self._owners, self._to_client = owners, to_client

    def describe(self) -> list[Metric]:
        """Return nothing at registration: there is no event loop yet."""
        return []

    def collect(self) -> Iterator[Metric]:
        yield InfoMetricFamily("hostlink", "This daemon", value={"version": version("hostlink")})
        yield GaugeMetricFamily("hostlink_links", "Live connections of devices", value=len(self._hub.links.all()))
        yield CounterMetricFamily(
            "hostlink_link_crashes",
            "Connections ended by an internal error of hostlink",
            value=self._hub.isolation.crashes["link"],
        )
        yield CounterMetricFamily(
            "hostlink_messages_unheard",
            "Messages of devices whose topics were not known in time",
            value=self._hub.links.undelivered,
        )
        crashes = CounterMetricFamily("hostlink_crashes", "Internal errors, by what they ended", labels=["what"])
        for what, count in self._hub.isolation.crashes.items():
            crashes.add_metric([what], count)
        yield crashes
        yield CounterMetricFamily(
            "hostlink_device_calls_refused",
            "Service calls of devices refused because of a limit",
            value=self._hub.links.calls.refused,
        )
        yield CounterMetricFamily(
            "hostlink_service_late_answers",
            "Answers of devices' services after their timeout",
            value=self._hub.links.late_answers,
        )
        yield CounterMetricFamily(
            "hostlink_messages_out_of_order",
            "Messages delivered before their turn because too many waited",
            value=self._hub.topics.deliveries.out_of_order,
        )
        yield CounterMetricFamily(
            "hostlink_log_lines_lost", "Log lines that could not be written", value=logs.output.lost_lines
        )
        yield CounterMetricFamily(
            "hostlink_log_lines_left_out", "Log lines over the budget of their source", value=logs.budget.left_out
        )
        refused = CounterMetricFamily("hostlink_connections_refused", "Devices refused, by cause", labels=["cause"])
        for cause, count in self._hub.counts.refused.items():
            refused.add_metric([cause], count)
        yield refused
        dropped = CounterMetricFamily("hostlink_datagrams_dropped", "UDP datagrams dropped, by cause", labels=["cause"])
        for cause, count in self._hub.counts.datagrams_dropped.items():
            dropped.add_metric([cause], count)
        yield dropped
        yield from self._graphs()
        for robots in _slices(self._hub.robots.here()):
            yield from self._robots(robots)
            yield from self._driving(robots)
        yield CounterMetricFamily(
            "hostlink_robots_forgotten",
            "Robots forgotten after a long disconnection, or because of too many",
            value=self._hub.robots.forgotten,
        )
        for devices in _slices(list(self._hub.robots.devices.values())):
            yield from self._links(devices)
        yield from self._to_clients()
        yield from self._kept()
        yield from self._to_port()

    def _graphs(self) -> Iterator[Metric]:
        events = CounterMetricFamily("hostlink_graph_events", "Events of a graph", labels=["graph", "what"])
        for graph, counts in self._hub.counts.graphs.items():
            for what, count in counts().items():
                events.add_metric([graph, what], count)
        yield events
        places: Counter[str] = Counter(robot.host for robot in self._hub.robots.remote.values() if robot.link)
        elsewhere = GaugeMetricFamily("hostlink_fleet_robots", "Connected robots of other daemons", labels=["host"])
        for host, count in places.items():
            elsewhere.add_metric([host], count)
        yield elsewhere

    def _robots(self, robots: Sequence[LocalRobot]) -> Iterator[Metric]:
        now_s = asyncio.get_running_loop().time()
        connected = GaugeMetricFamily("hostlink_robot_connected", "1 while its device is connected", labels=["robot"])
        age = GaugeMetricFamily("hostlink_robot_odometry_age_seconds", "Age of the newest pose", labels=["robot"])
        poses = CounterMetricFamily("hostlink_robot_poses", "Poses received", labels=["robot"])
        refused = CounterMetricFamily(
            "hostlink_robot_velocity_refused", "Velocities that the device could not receive", labels=["robot"]
        )
        for robot in robots:
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
            "hostlink_robot_unreadable", "Odometry messages that could not be decoded", labels=["robot"]
        )
        for robot in robots:
            unreadable.add_metric([robot.name], robot.unreadable)
            for outcome, count in dataclasses.asdict(robot.gate.counts).items():
                gates.add_metric([robot.name, outcome], count)
            for kind, count in robot.gate.admission.refused.items():
                gates.add_metric([robot.name, f"refused_{kind}"], count)
        yield from (connected, age, poses, refused, unreadable, gates)

    def _driving(self, robots: Sequence[LocalRobot]) -> Iterator[Metric]:
        now_s = asyncio.get_running_loop().time()
        locked = GaugeMetricFamily("hostlink_robot_locked", "1 while the robot is locked", labels=["robot"])
        driven = GaugeMetricFamily("hostlink_robot_driven", "1 while the robot is driven", labels=["robot"])
        commanded = GaugeMetricFamily(
            "hostlink_robot_commanded_speed", "Commanded, m/s and rad/s", labels=["robot", "axis"]
        )
        measured = GaugeMetricFamily("hostlink_robot_speed", "Measured, m/s and rad/s", labels=["robot", "axis"])
        battery = GaugeMetricFamily("hostlink_robot_battery_volts", "Measured by the device", labels=["robot"])
        for robot in robots:
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

    def _links(self, devices: Sequence[Device]) -> Iterator[Metric]:
        names = ["peer", "robot"]
        counters = {
            name: CounterMetricFamily(f"hostlink_link_{name}", help_, labels=names)
            for name, help_ in _LINK_COUNTERS.items()
        }
        replaced = CounterMetricFamily("hostlink_link_replaced", "Messages replaced by a newer one", labels=names)
        rejected = CounterMetricFamily(
            "hostlink_link_rejected", "False starts of frames, by cause", labels=[*names, "cause"]
        )
        silent = GaugeMetricFamily("hostlink_link_silent_seconds", "Time since the last byte", labels=names)
        oldest = GaugeMetricFamily(
            "hostlink_link_oldest_waiting_seconds", "Age of the oldest frame that waits for the device", labels=names
        )
        clocks = {
            name: GaugeMetricFamily(f"hostlink_link_{metric}", help_, labels=names)
            for name, (metric, help_) in _LINK_CLOCK.items()
        }
        latency = HistogramMetricFamily(
            "hostlink_command_to_device_seconds", "Time from a velocity command to the device's socket", labels=names
        )
        for device in devices:
            link, robot = device.link, device.robot
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
        kinds = GaugeMetricFamily("hostlink_clients", "Connected clients", labels=["kind"])
        for kind in ("rosbridge", "foxglove", "events"):
            kinds.add_metric([kind], sum(client["kind"] == kind for client in clients))
        yield kinds
        dropped = self._clients.gone_dropped + sum(client["dropped"] for client in clients)
        yield CounterMetricFamily("hostlink_client_dropped", "Messages dropped for slow clients", value=dropped)
        yield GaugeMetricFamily(
            "hostlink_client_waiting_bytes",
            "Bytes that wait for clients",
            value=sum(client["waiting_bytes"] for client in clients),
        )
        yield GaugeMetricFamily(
            "hostlink_client_lag_seconds",
            "Age of the oldest message that waits for a client",
            value=max((client["lag_s"] for client in clients), default=0.0),
        )
        yield CounterMetricFamily(
            "hostlink_clients_refused", "Clients refused because there were too many", value=self._clients.refused
        )
        yield HistogramMetricFamily(
            "hostlink_device_to_client_seconds",
            "Time from the arrival of a message to the client's socket",
            buckets=self._to_client.buckets(),
            sum_value=self._to_client.sum_s,
        )
        yield CounterMetricFamily(
            "hostlink_owners_evicted", "REST participants removed at the limit", value=self._owners.evicted
        )
        yield CounterMetricFamily(
            "hostlink_requests_refused", "Requests refused by the rate limit", value=self._limit.refused
        )

    def _kept(self) -> Iterator[Metric]:
        held = GaugeMetricFamily("hostlink_kept_bytes", "Bytes from clients that are kept, by kind", labels=["kind"])
        refused = CounterMetricFamily(
            "hostlink_kept_refused", "Items refused because the byte budget of their kind was full", labels=["kind"]
        )
        for kind, share in self._hub.budget.shares.items():
            held.add_metric([kind], share.held_bytes)
            refused.add_metric([kind], share.refused)
        replaced = CounterMetricFamily(
            "hostlink_velocities_replaced",
            "Velocities of clients replaced by a newer one before they were executed",
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
            "hostlink_api_connections_closed", "Connections refused or closed by hostlink, by cause", labels=["cause"]
        )
        for cause, count in self._connections.closed.items():
            closed.add_metric([cause], count)
        yield closed
