"""Types built from a full definition."""

import pytest
from rosbags.typesys import Stores, get_typestore

from hostlink.core.messages.catalog import Catalog, read_full_definition
from hostlink.errors import ConfigError
from tests.support.fake_device import message_type

CATALOG = Catalog()
NAMES = sorted(
    name.replace("/msg/", "/")
    for name in get_typestore(Stores.ROS1_NOETIC).fielddefs
    if not name.startswith("builtin_interfaces/")
)


def test_every_type_is_read_from_its_own_text_with_the_same_md5() -> None:
    assert len(NAMES) > 150
    for name in NAMES:
        known = message_type(name)
        found = read_full_definition(name, known.full_definition)
        assert (found.name, found.md5) == (known.name, known.md5), name


def test_message_is_decoded_as_by_the_catalogs_type() -> None:
    known = message_type("nav_msgs/Odometry")
    payload = known.encode({"child_frame_id": "base", "pose": {"covariance": list(range(36))}})
    assert read_full_definition(known.name, known.full_definition).decode(payload) == known.decode(payload)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("Header header\n", "a/A:1: field header: unknown type std_msgs/Header"),
        (f"b/B x\n{'=' * 80}\nMSG: b/B\na/A y\n", "contains itself"),
        ("no definition at all ???\n", "a/A"),
    ],
)
def test_invalid_full_definition_names_the_error(text: str, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        read_full_definition("a/A", text)
