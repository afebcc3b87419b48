"""The JSON of devices and connections: each type is described in the OpenAPI document."""

import msgspec

from hostlink.core.robot.device_views import (
    ArrivalView,
    DevicesView,
    LinksView,
    OtherLinksView,
)


def test_each_view_is_described_for_the_document() -> None:
    _, schemas = msgspec.json.schema_components([ArrivalView, DevicesView, LinksView])
    assert {"ArrivalView", "DeviceView", "FindingView", "LinkView", "LinksView"} <= schemas.keys()
    assert [name for name, schema in schemas.items() if not schema.get("description")] == []


def test_live_connections_are_added_to_the_others() -> None:
    assert LinksView.__annotations__.keys() - OtherLinksView.__annotations__.keys() == {"links"}
