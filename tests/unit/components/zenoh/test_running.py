"""Zenoh as a component: what switches it on, and what its check says."""

import importlib.util
from typing import Any

import pytest

from hostlink.components.zenoh.running import Zenoh
from hostlink.components.zenoh.settings import ZenohSettings
from hostlink.core.components import chosen_components
from hostlink.core.config import Config
from hostlink.errors import ConfigError, LibraryMissing

TABLE = {"zenoh": ZenohSettings(fleet=False)}


@pytest.mark.parametrize(
    ("settings", "chosen"),
    [
        ({}, None),
        ({"component_settings": TABLE}, TABLE["zenoh"]),
        ({"components": {"zenoh": True}}, ZenohSettings()),
        ({"component_settings": TABLE, "components": {"zenoh": True}}, TABLE["zenoh"]),
        ({"component_settings": TABLE, "components": {"zenoh": False}}, None),
    ],
)
def test_zenoh_runs_by_its_table_or_its_switch(settings: dict[str, Any], chosen: ZenohSettings | None) -> None:
    assert chosen_components(Config(**settings)) == ([] if chosen is None else [("zenoh", Zenoh, chosen)])


@pytest.mark.parametrize("library", ["rosbags", "xxhash"])
def test_check_names_the_library_that_ros_2_lacks(library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == library else find(name))
    with pytest.raises(LibraryMissing, match=f"zenoh.ros2: needs {library}"):
        Zenoh(ZenohSettings(ros2=True)).check()
    assert any("everybody who reaches its port" in each for each in Zenoh(ZenohSettings()).check())


def test_check_refuses_settings_that_zenoh_refuses() -> None:
    with pytest.raises(ConfigError, match="Zenoh refuses the settings"):
        Zenoh(ZenohSettings(listen=("nonsense",))).check()
