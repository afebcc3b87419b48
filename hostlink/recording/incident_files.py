"""The incidents that were saved: what their files say of themselves."""

from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import cast

from mcap.exceptions import McapError
from mcap.records import Metadata

from hostlink.recording.disk_budget import StoredFile
from hostlink.recording.folder import Folder
from hostlink.recording.incident import Cause, Incident
from hostlink.recording.reader import stored_records

_FIRST_RECORDS = 2  # the header, and what the file says of itself
MAX_LISTED = 1000


@dataclass(frozen=True, slots=True)
class SavedIncident:
    """One file."""

    incident: Incident
    file: StoredFile


class IncidentFiles:
    """Reads each file's beginning once; every method waits for the disk."""

    def __init__(self, folder: Folder) -> None:
        self._folder = folder
        self._known: dict[StoredFile, Incident] = {}

    def newest_first(self) -> list[SavedIncident]:
        """The newest MAX_LISTED. A file that says nothing of itself is none.

        Raises:
            OSError: the folder cannot be read.
        """
        known: dict[StoredFile, Incident] = {}
        for file in self._folder.files()[-MAX_LISTED:]:
            incident = self._known.get(file) or read_incident(self._folder.path / file.name)
            if incident is not None:
                known[file] = incident
        self._known = known
        found = [SavedIncident(incident, file) for file, incident in known.items()]
        return sorted(found, key=lambda saved: saved.incident.stamp_ns, reverse=True)


def read_incident(path: Path) -> Incident | None:
    """What a file says of itself; None: it is no incident's."""
    try:
        with path.open("rb") as file:
            for record in islice(stored_records(file), _FIRST_RECORDS):
                if isinstance(record, Metadata) and "cause" in record.metadata:
                    facts = record.metadata
                    cause = cast("Cause", facts["cause"])
                    return Incident(facts.get("robot", ""), cause, facts.get("detail", ""), int(facts["stamp_ns"]))
    except (OSError, McapError, ValueError, KeyError):  # removed meanwhile, damaged, or put there by somebody else
        return None
    return None
