"""Answers to parameter requests of devices: from the settings, from another source, and for what does not exist."""

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest
from structlog.testing import capture_logs

from hostlink.core.config import ParameterValue
from hostlink.core.hub.parameters import MAX_UNKNOWN_NAMES, MAX_WAITING, ParameterAnswers
from hostlink.core.link.link import Link
from hostlink.core.protocol.events import Parameter
from hostlink.errors import ServiceFailed, WrongType
from tests.support.virtual_loop import run_virtual

NONE = Parameter()


class FakeLink:
    """Link of a device that keeps the answers. `refuses`: values that do not fit the device."""

    def __init__(self, *, refuses: bool = False) -> None:
        self.number, self.wakes = 1, 0
        self.answers: list[tuple[str, Parameter]] = []
        self.session = SimpleNamespace(answer_parameter=self._answer)
        self._refuses = refuses

    def _answer(self, name: str, parameter: Parameter) -> None:
        if self._refuses and parameter != NONE:
            raise WrongType(f"parameter {name}", "a short one", "a long one")
        self.answers.append((name, parameter))

    def wake(self) -> None:
        self.wakes += 1

    @property
    def link(self) -> Link:
        return cast(Link, self)


class FakeSource:
    """Another source of parameters, which answers after a second."""

    def __init__(self, values: dict[str, ParameterValue]) -> None:
        self.values, self.requested = values, list[str]()

    async def get(self, name: str) -> ParameterValue | None:
        self.requested.append(name)
        await asyncio.sleep(1.0)
        if name == "/broken":
            raise ServiceFailed("master", "unreachable")
        return self.values.get(name)


def with_source(values: dict[str, ParameterValue], test: Callable[[ParameterAnswers, FakeSource], Any]) -> None:
    """Run a test with answers that have the setting `gain` and another source."""

    async def run() -> None:
        source = FakeSource(values)
        async with asyncio.TaskGroup() as tasks:
            await test(ParameterAnswers({"gain": 7}, lambda: source, tasks.create_task), source)

    run_virtual(run())


@pytest.mark.parametrize(
    ("name", "shown", "value"),
    [
        ("gain", "/robot_0/gain", 2),  # the robot's own
        ("gain", "/robot_1/gain", 1),
        ("/gain", "/gain", 1),
        ("~gain", "/gain", 1),
    ],
)
def test_parameter_of_the_robot_s_namespace_precedes_that_of_the_device_s_name(
    name: str, shown: str, value: int
) -> None:
    link, noted = FakeLink(), list[Parameter]()
    ParameterAnswers({"/gain": 1, "/robot_0/gain": 2}).answer(link.link, name, shown, noted.append)
    assert link.answers == [(name, Parameter(ints=(value,)))]
    assert noted == [Parameter(ints=(value,))]


def test_name_in_the_robot_s_namespace_alone_is_not_found_twice() -> None:
    link = FakeLink()
    ParameterAnswers({"/other": 1}).answer(link.link, "/gain", "/gain")
    assert link.answers == [("/gain", NONE)]


def test_unknown_parameter_is_answered_empty_and_logged_once_while_its_name_is_kept() -> None:
    answers, link = ParameterAnswers({}), FakeLink()
    with capture_logs() as logs:
        for _ in range(2):
            answers.answer(link.link, "/none", "/none")
        assert [(each["event"], each["name"]) for each in logs] == [("parameter.unknown", "/none")]
        for number in range(MAX_UNKNOWN_NAMES - 1):
            answers.answer(link.link, f"/n{number}", f"/n{number}")
        answers.answer(link.link, "/none", "/none")  # now it is the latest
        answers.answer(link.link, "/one_more", "/one_more")
        logs.clear()
        answers.answer(link.link, "/none", "/none")
        assert logs == []
        answers.answer(link.link, "/n0", "/n0")
        assert len(logs) == 1
    assert set(link.answers[-2:]) == {("/none", NONE), ("/n0", NONE)}


@pytest.mark.parametrize("value", [2**31, [1, "a"]])
def test_setting_that_rosserial_cannot_carry_is_answered_empty_and_logged(value: ParameterValue) -> None:
    link, noted = FakeLink(), list[Parameter]()
    with capture_logs() as logs:
        ParameterAnswers({"/gain": value}).answer(link.link, "/gain", "/gain", noted.append)
    assert (link.answers, noted) == ([("/gain", NONE)], [])
    assert [each["event"] for each in logs] == ["parameter.refused"]


def test_value_that_does_not_fit_the_device_is_answered_empty_and_not_noted() -> None:
    link, noted = FakeLink(refuses=True), list[Parameter]()
    ParameterAnswers({"/gain": 7}).answer(link.link, "/gain", "/gain", noted.append)
    assert (link.answers, noted) == ([("/gain", NONE)], [])


def test_other_source_is_asked_only_for_what_the_settings_lack() -> None:
    async def test(answers: ParameterAnswers, source: FakeSource) -> None:
        link, noted = FakeLink(), list[Parameter]()
        answers.answer(link.link, "gain", "/gain", noted.append)
        assert (link.answers, source.requested) == ([("gain", Parameter(ints=(7,)))], [])
        for name in ("/speed", "/none"):
            answers.answer(link.link, name, f"/robot_0{name}", noted.append)
        assert len(link.answers) == 1
        await asyncio.sleep(1.5)
        assert source.requested == ["/speed", "/none"]
        assert link.answers[1:] == [("/speed", Parameter(floats=(0.5,))), ("/none", NONE)]
        assert noted[1:] == [Parameter(floats=(0.5,)), NONE]
        assert link.wakes == 2

    with_source({"/speed": 0.5}, test)


def test_failed_or_odd_answer_of_the_other_source_is_empty() -> None:
    async def test(answers: ParameterAnswers, _: FakeSource) -> None:
        link = FakeLink()
        for name in ("/broken", "/large"):
            answers.answer(link.link, name, name)
        await asyncio.sleep(1.5)
        assert (link.answers, link.wakes) == ([("/broken", NONE), ("/large", NONE)], 2)

    with_source({"/large": 2**31}, test)


def test_requests_to_the_other_source_are_bounded_and_further_ones_answered_at_once() -> None:
    async def test(answers: ParameterAnswers, source: FakeSource) -> None:
        link = FakeLink()
        for number in range(MAX_WAITING + 1):
            answers.answer(link.link, f"/p{number}", f"/p{number}")
        assert link.answers == [(f"/p{MAX_WAITING}", NONE)]
        await asyncio.sleep(1.5)
        assert len(link.answers) == MAX_WAITING + 1
        answers.answer(link.link, "/later", "/later")
        await asyncio.sleep(1.5)
        assert source.requested[-1] == "/later"

    with_source({}, test)
