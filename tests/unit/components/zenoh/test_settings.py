"""Settings of [zenoh], and the ones passed to Zenoh."""

import json
from pathlib import Path
from typing import Any

import pytest

from hostlink.cli.settings import load
from hostlink.components.zenoh.settings import (
    ZenohSettings,
    certificate_trouble,
    reach_of,
    reason_of,
    settings_of,
    warnings_of,
)
from hostlink.core.config import Config
from hostlink.errors import ConfigError
from tests.support.zenoh_certificates import make_authority, make_certificate


def write(folder: Path, text: str) -> Path:
    path = folder / "hostlink.toml"
    path.write_text(text)
    return path


def test_configuration_without_the_table_starts_no_zenoh(tmp_path: Path) -> None:
    assert load(write(tmp_path, "")).component_settings == {}
    assert load(write(tmp_path, "[zenoh]\n")).component_settings == {"zenoh": ZenohSettings()}


def test_paths_are_beside_the_file(tmp_path: Path) -> None:
    settings = load(write(tmp_path, '[zenoh]\nca = "ca.pem"\nfile = "/etc/rules.json5"\n')).component_settings["zenoh"]
    assert (settings.ca, settings.file) == (tmp_path / "ca.pem", Path("/etc/rules.json5"))


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ('drivrs = ["a"]', "unknown key zenoh.drivrs; did you mean drivers"),
        ('name = "a/b"', "must be made of letters"),
        ('name = "*"', "must be made of letters"),
        ('fleet_name = ""', "must not be empty"),
        ('key = "a.key"', "zenoh.key together"),
        ('certificate = "a.pem"\nkey = "a.key"', "zenoh.certificate needs zenoh.ca"),
        ('mode = "broker"', "broker"),
    ],
)
def test_wrong_setting_is_refused(tmp_path: Path, line: str, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem.replace("*", r"\*")):
        load(write(tmp_path, f"[zenoh]\n{line}\n"))


def test_zenoh_gets_what_is_set() -> None:
    settings = settings_of(
        ZenohSettings(
            mode="client",
            connect=("tls/10.0.0.2:7447",),
            ca=Path("/ca.pem"),
            certificate=Path("/a.pem"),
            key=Path("/a.key"),
        )
    )
    assert settings.get_json("mode") == '"client"'
    assert "tls/10.0.0.2:7447" in settings.get_json("connect/endpoints")
    assert settings.get_json("transport/link/protocols") == '["tls"]'
    assert settings.get_json("scouting/multicast/enabled") == "false"
    assert settings.get_json("scouting/gossip/enabled") == "false"
    assert settings.get_json("transport/link/tls/close_link_on_expiration") == "true"
    assert settings.get_json("access_control/enabled") == "false"
    assert settings.get_json("transport/link/tls/enable_mtls") == "true"
    assert settings.get_json("transport/link/tls/root_ca_certificate") == '"/ca.pem"'
    assert settings.get_json("transport/link/tx/lease") == "1000"
    assert settings.get_json("transport/shared_memory/enabled") == "false"


def certified(**settings: Any) -> ZenohSettings:
    return ZenohSettings(ca=Path("/ca.pem"), certificate=Path("/a.pem"), key=Path("/a.key"), **settings)


def test_certificates_leave_no_listener_but_those_that_are_named() -> None:
    settings = settings_of(certified())
    assert settings.get_json("listen/endpoints") == "[]"
    assert tuple(reach_of(settings, certified())) == (
        "listens on nothing",
        "TLS alone: reached by certificates of /ca.pem",
        "all of them may drive",
    )


@pytest.mark.parametrize(
    ("settings", "file", "problem"),
    [
        ({"listen": ("tcp/0.0.0.0:7447",)}, "", "zenoh.listen: tcp/0.0.0.0:7447 is open to everybody"),
        ({"listen": ("tls/[::]:7447", "quic/[::]:7447")}, "", "zenoh.listen: quic/"),
        ({"listen": ("tls/[::]:7447#enable_mtls=false",)}, "", "zenoh.listen: tls/.* is open to everybody"),
        ({"connect": ("tcp/10.0.0.2:7447",)}, "", "zenoh.connect: tcp/10.0.0.2:7447 is open to everybody"),
        ({"multicast": True}, "", "zenoh.multicast: must not be true with certificates"),
        ({"drivers": ("lab-*",)}, "", r"zenoh.drivers: lab-\*: with certificates each name is written out"),
        ({}, "{listen: {endpoints: ['tcp/[::]:7447']}}", "zenoh.listen: tcp/"),
        ({}, "{listen: {endpoints: {peer: ['ws/[::]:7447'], router: []}}}", "zenoh.listen: ws/"),
        ({}, "{connect: {endpoints: ['udp/10.0.0.2:7447']}}", "zenoh.connect: udp/"),
        ({}, "{transport: {link: {protocols: ['tls', 'tcp']}}}", "zenoh.file: transport/link/protocols is"),
        ({}, "{scouting: {multicast: {enabled: true}}}", "zenoh.file: scouting/multicast/enabled is true"),
        ({}, "{transport: {link: {tls: {enable_mtls: false}}}}", "zenoh.file: transport/link/tls/enable_mtls is false"),
        ({}, "{transport: {link: {tls: ", "zenoh: Zenoh refuses the settings: "),
    ],
)
def test_a_setting_that_opens_what_certificates_close_is_refused(
    tmp_path: Path, settings: dict[str, Any], file: str, problem: str
) -> None:
    if file:
        settings["file"] = tmp_path / "zenoh.json5"
        settings["file"].write_text(file)
    with pytest.raises(ConfigError, match=problem):
        settings_of(certified(**settings))


def test_an_authority_alone_connects_by_tls_and_does_not_listen() -> None:
    config = ZenohSettings(ca=Path("/ca.pem"), connect=("tls/10.0.0.2:7447",))
    settings = settings_of(config)
    assert (settings.get_json("transport/link/protocols"), settings.get_json("listen/endpoints")) == ('["tls"]', "[]")
    assert settings.get_json("transport/link/tls/enable_mtls") == "null"
    with pytest.raises(ConfigError, match=r"zenoh.listen: needs zenoh.certificate and zenoh.key"):
        settings_of(ZenohSettings(ca=Path("/ca.pem"), listen=("tls/[::]:7447",)))


@pytest.mark.parametrize("kind", ["root_ca_certificate", "root_ca_certificate_base64"])
def test_certificates_in_a_file_of_zenoh_close_as_much(tmp_path: Path, kind: str) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(json.dumps({"transport": {"link": {"tls": {kind: "a"}}}}))
    settings = settings_of(ZenohSettings(file=file))
    assert settings.get_json("transport/link/protocols") == '["tls"]'
    assert list(warnings_of(settings, ZenohSettings(file=file))) == []


def test_neighbours_that_others_name_are_met_over_tls_where_that_is_chosen() -> None:
    config = certified(listen=("tls/10.0.0.2:7447",), gossip=True)
    settings = settings_of(config)
    assert settings.get_json("scouting/gossip/enabled") == "true"
    assert settings.get_json("transport/link/protocols") == '["tls"]'
    assert tuple(reach_of(settings, config))[:2] == (
        "listens on tls/10.0.0.2:7447",
        "TLS alone, found by gossip: reached by certificates of /ca.pem",
    )


def test_without_certificates_it_says_that_everybody_may_drive() -> None:
    config = ZenohSettings(drivers=("desk",))
    settings = settings_of(config)
    assert tuple(reach_of(settings, config)) == (
        "listens on tcp/[::]:0",
        "no TLS, found by multicast and gossip: everybody who reaches it can drive",
    )
    assert [warning.partition(" (")[0] for warning in warnings_of(settings, config)] == [
        "no certificates",
        "drivers without certificates keeps out nobody: a daemon has the name that it gives itself",
    ]
    config = ZenohSettings(mode="client", connect=("tcp/10.0.0.2:7447",), multicast=False, gossip=False)
    assert tuple(reach_of(settings_of(config), config)) == (
        "listens on nothing",
        "connects to tcp/10.0.0.2:7447",
        "no TLS: everybody who reaches it can drive",
    )


def test_drivers_are_bound_to_the_names_in_certificates() -> None:
    config = certified(listen=("tls/10.0.0.2:7447",), drivers=("desk", "lab-2"))
    settings = settings_of(config)
    rules = json.loads(settings.get_json("access_control"))
    assert (rules["enabled"], rules["default_permission"]) == (True, "deny")
    assert [each.get("cert_common_names") for each in rules["subjects"]] == [None, ["desk"], ["lab-2"]]
    assert tuple(reach_of(settings, config))[-1] == "of them desk, lab-2 may drive, by the name in the certificate"


def test_access_rules_of_a_file_stand(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(
        "{access_control: {enabled: true, default_permission: 'allow', rules: [], subjects: [], policies: []}}"
    )
    config = certified(file=file, drivers=("desk",))
    settings = settings_of(config)
    assert json.loads(settings.get_json("access_control/default_permission")) == "allow"
    assert tuple(reach_of(settings, config))[-1] == f"who may drive: the access rules of {file}"


def test_an_administration_that_writes_is_a_warning(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{adminspace: {enabled: true, permissions: {read: true, write: true}}}")
    config = certified(file=file)
    assert "adminspace lets whoever is connected change" in next(warnings_of(settings_of(config), config))


def test_file_of_zenoh_precedes_the_defaults_of_hostlink(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{transport: {link: {tx: {lease: 4000}}}, mode: 'router'}")
    settings = settings_of(ZenohSettings(file=file))
    assert settings.get_json("transport/link/tx/lease") == "4000"
    assert settings.get_json("mode") == '"peer"'


def test_a_reason_of_zenoh_is_short() -> None:
    assert reason_of(ValueError('Json5Err(Message { msg: "no such endpoint at /root/x.rs:1", location: None })')) == (
        "no such endpoint"
    )
    assert reason_of(ValueError("address in use at /root/y.rs:2")) == "address in use"


def test_the_parts_of_a_configuration_stay_what_they_are(tmp_path: Path) -> None:
    assert load(write(tmp_path, "[zenoh]\nfleet = false\n")) == Config(
        component_settings={"zenoh": ZenohSettings(fleet=False)}
    )


@pytest.mark.parametrize(
    ("days", "is_own", "trouble"),
    [("2", True, ""), ("-1", True, "certificate has expired"), ("2", False, "unable to get local issuer certificate")],
)
def test_certificate_that_no_daemon_lets_in_is_told(tmp_path: Path, days: str, trouble: str, *, is_own: bool) -> None:
    ca = make_authority(tmp_path)
    certificate, key = make_certificate(tmp_path, "desk", days=days)
    if not is_own:
        (tmp_path / "other").mkdir()
        ca = make_authority(tmp_path / "other")
    config = ZenohSettings(ca=ca, certificate=certificate, key=key)
    assert certificate_trouble(config) == trouble
    warnings = [warning for warning in warnings_of(settings_of(config), config) if "lets this one in" in warning]
    assert len(warnings) == (trouble != "")
