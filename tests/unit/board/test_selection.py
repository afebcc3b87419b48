"""Selection of types for a library, and names that clash."""

from pathlib import Path

import pytest

from hostlink.board.library import known_names, select
from hostlink.core.messages.catalog import Catalog
from hostlink.errors import ConfigError

CATALOG = Catalog()


def folder(tmp_path: Path, **texts: str) -> Catalog:
    """Write definitions. `my_msgs__Name__msg` is the text of my_msgs/Name.msg."""
    for name, text in texts.items():
        package, base, suffix = name.split("__")
        (tmp_path / package).mkdir(exist_ok=True)
        (tmp_path / package / f"{base}.{suffix}").write_text(text)
    return Catalog([tmp_path])


def test_all_types_are_selected_when_none_is_named() -> None:
    selection = select(CATALOG, None)
    assert len(selection.messages) > 160
    assert len(selection.services) > 40
    assert sorted(selection.names) == sorted({*CATALOG.message_names(), *CATALOG.service_names()})


def test_nested_types_are_selected() -> None:
    assert select(CATALOG, ["geometry_msgs/TwistStamped"]).names == [
        "geometry_msgs/Twist", "geometry_msgs/TwistStamped", "geometry_msgs/Vector3", "std_msgs/Header",
    ]  # fmt: skip
    plan = select(CATALOG, ["nav_msgs/GetPlan"])
    assert [service.name for service in plan.services] == ["nav_msgs/GetPlan"]
    assert "geometry_msgs/PoseStamped" in plan.names


def test_selected_package_has_its_messages_and_services() -> None:
    selection = select(CATALOG, ["std_srvs"])
    assert selection.packages == ["std_srvs"]
    assert selection.names == ["std_srvs/Empty", "std_srvs/SetBool", "std_srvs/Trigger"]
    assert {"std_srvs", "std_srvs/Trigger", "std_msgs/String"} <= set(known_names(CATALOG))


@pytest.mark.parametrize(
    ("texts", "problem"),
    [
        (
            {"my_msgs__Go__msg": "", "my_msgs__Go__srv": "---"},
            "my_msgs/Go: the service header needs the name of the message my_msgs/Go",
        ),
        ({"my_msgs__GoRequest__msg": "", "my_msgs__Go__srv": "---"}, "the name of the message my_msgs/GoRequest"),
        ({"my_msgs__Go__msg": "", "my_msgs__GO__msg": ""}, "only in upper and lower case"),
        ({"ros__Go__msg": ""}, "ros/Go: the package has the name of a C\\+\\+ namespace"),
    ],
)
def test_clashing_names_are_refused(tmp_path: Path, texts: dict[str, str], problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        select(folder(tmp_path, **texts), None)


def test_two_types_with_one_name_in_c_plus_plus_are_refused(tmp_path: Path) -> None:
    assert select(folder(tmp_path, my_msgs__PI__msg=""), ["my_msgs"]).names == ["my_msgs/PI"]
    (tmp_path / "my_msgs" / "PI_.msg").write_text("")
    catalog = Catalog([tmp_path])
    with pytest.raises(ConfigError, match=r"my_msgs/PI_: its C\+\+ name my_msgs::PI_ is also that of my_msgs/PI; ren"):
        select(catalog, None)
