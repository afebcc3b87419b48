"""Reloading while files block: what is refused, and what is left behind."""

import asyncio
import threading
from dataclasses import dataclass

import pytest

from hostlink.core.config import Config, RobotConfig
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.reloader import MAX_LOGGED, Reloader, _shown
from hostlink.core.messages.catalog import Catalog
from hostlink.errors import ConfigError, ReloadRefused
from tests.support.waiting import expect

ROVER = Config(robots={"rover": RobotConfig(max_linear_m_s=0.2)})


async def test_reload_of_a_file_that_blocks_is_refused_and_begins_no_second_thread() -> None:
    unblocked = threading.Event()

    def read() -> Config:
        unblocked.wait()
        return ROVER

    hub = Hub(Config(), Catalog())
    reloader = Reloader(hub, read, read_timeout_s=0.05)
    threads = threading.active_count()
    with pytest.raises(ReloadRefused, match=r"could not be read within 0\.05 s"):
        await reloader.reload()
    for _ in range(3):
        with pytest.raises(ReloadRefused, match="an earlier reload still waits"):
            await reloader.reload()
    assert threading.active_count() == threads + 1
    unblocked.set()
    await expect(lambda: not reloader._thread.is_busy)
    assert hub.config == Config()  # it came too late
    assert (await Reloader(hub, read).reload()).changed == ("robots.rover.max_linear_m_s",)
    assert hub.config == ROVER


async def test_reload_while_another_reads_waits_and_reads_again() -> None:
    begun, goes_on = threading.Event(), threading.Event()
    configs = [ROVER, Config()]

    def read() -> Config:
        begun.set()
        goes_on.wait()
        return configs.pop(0)

    hub = Hub(Config(), Catalog())
    reloader = Reloader(hub, read)
    async with asyncio.TaskGroup() as tasks:
        both = [tasks.create_task(reloader.reload()) for _ in range(2)]
        await asyncio.to_thread(begun.wait)
        goes_on.set()
    assert [each.result().changed for each in both] == [("robots.rover.max_linear_m_s",)] * 2
    assert hub.config == Config()


async def test_reload_with_limits_that_cannot_be_kept_changes_nothing() -> None:
    hub = Hub(Config(), Catalog())
    wrong = Config(robots={"rover": RobotConfig(max_linear_m_s=-1.0)})
    with pytest.raises(ConfigError, match="max_linear_m_s"):
        await Reloader(hub, lambda: wrong).reload()
    assert hub.config == Config()


@dataclass(frozen=True)
class Table:
    """Settings of a component."""

    port: int = 9999
    host: str = "127.0.0.1"


async def test_changed_settings_of_components_need_a_restart_and_are_named_as_in_the_file() -> None:
    hub = Hub(Config(component_settings={"status": Table(), "gone": Table()}), Catalog())
    changed = Config(component_settings={"status": Table(port=1)}, components={"mqtt": True})
    reloaded = await Reloader(hub, lambda: changed).reload()
    assert sorted(reloaded.needs_restart) == ["components.mqtt", "gone", "status.port"]
    assert reloaded.changed == ()


def test_settings_in_the_log_are_as_many_as_a_line_may_have() -> None:
    names = tuple(map(str, range(MAX_LOGGED + 3)))
    assert _shown(names[:MAX_LOGGED]) == names[:MAX_LOGGED]
    assert _shown(names) == (*names[:MAX_LOGGED], "and 3 more")
