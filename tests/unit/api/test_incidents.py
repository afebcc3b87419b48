"""The list of incidents: pending ones, then saved ones."""

from hostlink.api.history import incident_views
from hostlink.recording.folder import StoredFile
from hostlink.recording.incident import Incident, SavedIncident

OLD = Incident("robot_0", "locked", "smoke", 1_000_000_000_000)
NEW = Incident("robot_0", "gone", "its link ended while it was driven", 2_000_000_000_000)


def saved(incident: Incident) -> SavedIncident:
    return SavedIncident(incident, StoredFile(f"{incident.cause}.mcap", 9, 0.0))


def test_incident_views_list_pending_incidents_first() -> None:
    views = incident_views([NEW], [saved(OLD)])
    assert [(each["cause"], each["file"]) for each in views] == [("gone", ""), ("locked", "locked.mcap")]


def test_incident_saved_while_the_files_were_read_is_listed_once() -> None:
    views = incident_views([OLD, NEW], [saved(OLD)])
    assert [(each["cause"], each["file"]) for each in views] == [("gone", ""), ("locked", "locked.mcap")]
