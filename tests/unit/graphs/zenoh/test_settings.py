"""What [zenoh] says, and what of it Zenoh gets."""

from pathlib import Path

import pytest
import zenoh

from hostlink.config import Config, ZenohConfig, load
from hostlink.errors import ConfigError
from hostlink.graphs.zenoh.session import _reason, _settings


def write(folder: Path, text: str) -> Path:
    path = folder / "hostlink.toml"
    path.write_text(text)
    return path


def test_without_the_table_there_is_no_zenoh(tmp_path: Path) -> None:
    assert load(write(tmp_path, "")).zenoh is None
    assert load(write(tmp_path, "[zenoh]\n")).zenoh == ZenohConfig()


def test_paths_are_beside_the_file(tmp_path: Path) -> None:
    settings = load(write(tmp_path, '[zenoh]\nca = "ca.pem"\nfile = "/etc/rules.json5"\n')).zenoh
    assert settings is not None
    assert (settings.ca, settings.file) == (tmp_path / "ca.pem", Path("/etc/rules.json5"))


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ('drivrs = ["a"]', "unknown key zenoh.drivrs; did you mean drivers"),
        ('name = "a/b"', "must be made of letters"),
        ('name = "*"', "must be made of letters"),
        ('fleet_name = ""', "must not be empty"),
        ('key = "a.key"', "belong together"),
        ('mode = "broker"', "broker"),
    ],
)
def test_what_is_wrong_is_refused(tmp_path: Path, line: str, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem.replace("*", r"\*")):
        load(write(tmp_path, f"[zenoh]\n{line}\n"))


def test_zenoh_gets_what_is_set() -> None:
    settings = _settings(
        zenoh,
        ZenohConfig(
            mode="client",
            connect=("tls/10.0.0.2:7447",),
            multicast=False,
            ca=Path("/ca.pem"),
            certificate=Path("/a.pem"),
            key=Path("/a.key"),
        ),
    )
    assert settings.get_json("mode") == '"client"'
    assert "tls/10.0.0.2:7447" in settings.get_json("connect/endpoints")
    assert settings.get_json("scouting/multicast/enabled") == "false"
    assert settings.get_json("transport/link/tls/enable_mtls") == "true"
    assert settings.get_json("transport/link/tls/root_ca_certificate") == '"/ca.pem"'
    assert settings.get_json("transport/link/tx/lease") == "1000"
    assert settings.get_json("transport/shared_memory/enabled") == "false"


def test_a_file_of_zenoh_comes_before_the_defaults_of_hostlink(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{transport: {link: {tx: {lease: 4000}}}, mode: 'router'}")
    settings = _settings(zenoh, ZenohConfig(file=file))
    assert settings.get_json("transport/link/tx/lease") == "4000"
    assert settings.get_json("mode") == '"peer"'


def test_a_reason_of_zenoh_is_short() -> None:
    assert _reason(ValueError('Json5Err(Message { msg: "no such endpoint at /root/x.rs:1", location: None })')) == (
        "no such endpoint"
    )
    assert _reason(ValueError("address in use at /root/y.rs:2")) == "address in use"


def test_the_parts_of_a_configuration_stay_what_they_are(tmp_path: Path) -> None:
    assert load(write(tmp_path, "[zenoh]\nfleet = false\n")) == Config(zenoh=ZenohConfig(fleet=False))
