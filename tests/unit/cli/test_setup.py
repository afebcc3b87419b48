"""The questions of setup: what is refused, and that every answer that is not makes a configuration that is served."""

import asyncio
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.cli.check import check
from hostlink.cli.settings import load
from hostlink.cli.setup import configuration, questions
from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import Config

QUESTIONS = {question.key: question for question in questions(["/dev/ttyACM0"])}
DEFAULTS = {key: question.default for key, question in QUESTIONS.items()}


def made(**answers: str) -> Config:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "hostlink.toml"
        file.write_text(configuration({**DEFAULTS, **answers}, token="a-token"))
        return load(file)


def test_there_are_ten_and_the_usual_answers_are_accepted() -> None:
    assert len(QUESTIONS) == 10
    assert [question.key for question in QUESTIONS.values() if question.complaint(question.default)] == []


def test_the_usual_answers_change_only_the_robots_limit() -> None:
    config = made()
    assert (config.tcp, config.table("api", ApiConfig), config.serial) == (
        Config().tcp,
        Config().table("api", ApiConfig),
        (),
    )
    assert config.robots["robot_0"].max_linear_m_s == 0.5


def test_a_board_on_usb_is_a_robot_at_its_port() -> None:
    config = made(way="usb", serial="/dev/ttyUSB1", baud="115200", robot="mule", separation_m="0.21")
    assert config.tcp.host == "127.0.0.1"
    assert (config.serial[0].path, config.serial[0].baud) == ("/dev/ttyUSB1", 115200)
    assert (config.robots["mule"].address, config.robots["mule"].wheel_separation_m) == ("/dev/ttyUSB1", 0.21)
    assert config.robots["mule"].kinematics == "differential"


def test_an_api_for_the_network_needs_the_token() -> None:
    config = made(reach="network", network="192.168.4.0/24", robot="-")
    api = config.table("api", ApiConfig)
    assert (api.host, api.tokens[0].role, api.tokens[0].token) == ("0.0.0.0", "drive", "a-token")
    assert (config.tcp.allow, config.robots) == (("192.168.4.0/24",), {})


@pytest.mark.parametrize(
    ("key", "answer"),
    [
        ("way", "lan"), ("network", "192.168.4"), ("device_port", "0"), ("device_port", "65536"), ("device_port", "x"),
        ("serial", "COM3"), ("baud", "9" * 30), ("robot", "my robot"), ("robot", "robot/0"), ("separation_m", "21 cm"),
        ("speed_m_s", ""), ("speed_m_s", "nan"), ("deceleration_m_s2", "-1"), ("reach", "all"),
    ],
)  # fmt: skip
def test_an_answer_that_cannot_be_is_refused_with_what_could_be(key: str, answer: str) -> None:
    assert QUESTIONS[key].complaint(answer)


def test_any_path_of_a_port_is_quoted_as_toml_wants_it() -> None:
    port = '/dev/\U00010000"\x7f\\\t\u00e4'
    assert made(way="usb", serial=port).serial[0].path == port


TEXTS = st.one_of(st.text(max_size=20), st.from_regex(r"[\w./-]{1,12}"), st.floats().map(str), st.integers().map(str))


@given(st.data())
def test_accepted_answers_can_be_served(data: st.DataObject) -> None:
    answers = dict(DEFAULTS)
    for key, question in QUESTIONS.items():
        answer = data.draw(TEXTS, label=key).strip()
        if answer and not question.complaint(answer):
            answers[key] = answer
    config = made(
        way=data.draw(st.sampled_from(["wifi", "usb", "both"])), **{k: v for k, v in answers.items() if k != "way"}
    )
    assert asyncio.run(check(config, descriptors=1024)) is not None
