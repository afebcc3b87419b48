"""RecordingMetrics: recordings, incidents, the black box and their disk, for Prometheus."""

import asyncio
from collections.abc import Iterator

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from hostlink.config import Config
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
