"""Recorder: component that records on request, keeps the black box, and logs who drove which robot."""

import asyncio
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from hostlink.components.gateway.settings import ApiConfig
from hostlink.components.recorder.folder import default_folder
from hostlink.components.recorder.recordings import Recordings
from hostlink.components.recorder.settings import BlackBoxConfig, RecordingConfig
from hostlink.core.host import Component, Host
from hostlink.core.runtime.folders import owner_of
from hostlink.core.runtime.listening import spelled


@dataclass(frozen=True, kw_only=True)
class RecorderSettings:
    """The tables [recording] and [black_box], and of [api] the address: it tells other daemons whose the folder is."""

    recording: RecordingConfig = field(default_factory=RecordingConfig)
    black_box: BlackBoxConfig = field(default_factory=BlackBoxConfig)
    api: ApiConfig = field(default_factory=ApiConfig)


class Recorder(Component[RecorderSettings]):
    """Recordings, the black box and the log of drives: `Recordings`, `BlackBox`, `DriveLog` for other components."""

    name = "recorder"
    settings_type = RecorderSettings
    tables = ("recording", "black_box")
    begins_first = True  # so that the first messages of devices are kept, and the stop at the daemon's end

    def check(self) -> Iterable[str]:
        """Warn of a folder that another daemon has."""
        folder = self.settings.recording.folder or default_folder()
        if (owner := owner_of(folder)) is not None:
            advice = "this daemon keeps no recordings, incidents and drives until that one ends; set another folder"
            yield f"recording.folder {folder} belongs to {owner}: {advice}"

    def describe(self) -> str:
        """Return one line for --check-config."""
        return "; ".join(_described(self.settings))

    async def run(self, host: Host) -> None:
        """Record until cancelled."""
        settings = self.settings
        api = spelled(settings.api.host, settings.api.port)
        recordings = Recordings(host, settings.recording, settings.black_box, api=api)
        try:
            await recordings.open()
            for service in (recordings, recordings.black_box, recordings.drives):
                host.offer(service)
            host.ready()
            await asyncio.Event().wait()
        finally:
            await recordings.aclose()


def _described(settings: RecorderSettings) -> Iterator[str]:
    recording, box = settings.recording, settings.black_box
    yield f"recordings in {recording.folder or default_folder()}, at most {recording.max_disk_mb:g} MB"
    yield f"black box of {box.before_s:g} s before an incident" if box.enabled else "no black box"
    if not recording.drives:
        yield "no log of drives"
