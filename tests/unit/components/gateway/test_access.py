"""Access to the API: tokens, roles, and pages of other origins."""

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from aiohttp import web
from structlog.testing import capture_logs

from hostlink.components.gateway.access import (
    SHORTEST_TOKEN,
    Access,
    Grant,
    Grants,
    Role,
    check_role,
    is_loopback,
    tls_context,
)
from hostlink.components.gateway.settings import KEPT_FOR_REQUESTS, ApiConfig, TokenConfig
from hostlink.errors import ConfigError

DRIVER = TokenConfig(name="phone", role="drive", token="a-token-of-a-driver")
WATCHER = TokenConfig(name="wall", role="read", token="a-token-of-a-watcher")
GUARDED = ApiConfig(tokens=(DRIVER, WATCHER))


def refused(access: Access, origin: str | None, host: str) -> str:
    try:
        access.check_place(origin=origin, host=host)
    except web.HTTPForbidden as error:
        return error.reason
    return ""


@pytest.mark.parametrize(
    ("origin", "host"),
    [
        (None, "localhost:9090"),
        (None, "127.0.0.1:9090"),
        (None, "[::1]:9090"),
        (None, "192.168.4.1"),
        ("http://localhost:9090", "localhost:9090"),
        ("http://127.0.0.1:9090", "127.0.0.1:9090"),
        ("http://[::1]:9090", "[::1]:9090"),
    ],
)
def test_check_place_own_page_and_programs_are_allowed(origin: str | None, host: str) -> None:
    assert refused(Access(ApiConfig()), origin, host) == ""


@pytest.mark.parametrize(
    ("origin", "host"),
    [
        ("http://evil.example", "localhost:9090"),
        ("http://localhost", "localhost:9090"),  # another port is another origin
        ("http://localhost:9090.evil.example", "localhost:9090"),
        ("null", "localhost:9090"),
        ("", "localhost:9090"),
        ("http://[", "localhost:9090"),
        ("http://evil.example:9090", "evil.example:9090"),  # DNS rebinding
        (None, "evil.example"),
        (None, ""),
        (None, "[::1"),
    ],
)
def test_check_place_page_of_another_origin_is_refused(origin: str | None, host: str) -> None:
    assert refused(Access(ApiConfig()), origin, host)


def test_check_place_listed_origin_is_allowed() -> None:
    access = Access(ApiConfig(origins=("https://app.example/", "null")))
    assert refused(access, "https://app.example", "localhost") == ""
    assert refused(access, "null", "localhost") == ""
    assert 'add "https://other.example" to api.origins' in refused(access, "https://other.example", "localhost")


def test_check_place_with_tokens_allows_names_and_every_origin() -> None:
    access = Access(ApiConfig(host="0.0.0.0", tokens=(DRIVER,), origins=("*",)))
    assert refused(access, "https://anywhere.example", "robot.local:9090") == ""
    assert refused(Access(GUARDED), "http://robot.local:9090", "robot.local:9090") == ""
    assert refused(Access(GUARDED), "https://anywhere.example", "robot.local:9090")


def test_grant_without_tokens_may_drive() -> None:
    assert Access(ApiConfig()).grant(None) == Grant("", Role.DRIVE)


def test_grant_of_a_token_has_name_and_role() -> None:
    access = Access(GUARDED)
    assert access.grant("a-token-of-a-driver") == Grant("phone", Role.DRIVE)
    assert access.grant("a-token-of-a-watcher") == Grant("wall", Role.READ)


@pytest.mark.parametrize("token", [None, "", "a-token-of-a-drive", "a-token-of-a-driver ", "ü", "\udcff"])
def test_grant_of_missing_or_unknown_token_is_refused(token: str | None) -> None:
    with pytest.raises(web.HTTPUnauthorized) as refusal:
        Access(GUARDED).grant(token)
    assert refusal.value.headers["WWW-Authenticate"].startswith("Bearer")
    assert "a-token-of" not in refusal.value.reason


def test_check_role_read_may_not_drive() -> None:
    check_role(Grant("wall", Role.READ), Role.READ)
    check_role(Grant("phone", Role.DRIVE), Role.READ)
    with pytest.raises(web.HTTPForbidden, match="wall may only read"):
        check_role(Grant("wall", Role.READ), Role.DRIVE)


def test_token_is_read_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text("a-token-in-a-file\n")
    access = Access(ApiConfig(tokens=(TokenConfig(name="page", token_file=file),)))
    assert access.grant("a-token-in-a-file") == Grant("page", Role.READ)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.4.1", "::", "robot.local", ""])
def test_address_outside_loopback_needs_tokens(host: str) -> None:
    with pytest.raises(ConfigError, match="every program on the network could drive"):
        Access(ApiConfig(host=host))
    Access(ApiConfig(host=host, tokens=(DRIVER,)))


def test_token_is_not_shown() -> None:
    assert "a-token-of-a-driver" not in repr(GUARDED)


def test_tls_needs_valid_certificate_and_key(tmp_path: Path) -> None:
    assert tls_context(ApiConfig()) is None
    with pytest.raises(ConfigError, match="both certificate and key"):
        tls_context(ApiConfig(key=tmp_path / "key.pem"))
    with pytest.raises(ConfigError, match="No such file"):
        tls_context(ApiConfig(certificate=tmp_path / "cert.pem", key=tmp_path / "key.pem"))
    (tmp_path / "cert.pem").write_text("no certificate")
    with pytest.raises(ConfigError, match=r"cert\.pem"):
        tls_context(ApiConfig(certificate=tmp_path / "cert.pem", key=tmp_path / "cert.pem"))


def test_refused_origin_of_a_browser_is_logged_once() -> None:
    access = Access(ApiConfig())
    with capture_logs() as logs:
        for origin in ("http://evil.example", "http://evil.example", "null", "not-a-browser"):
            with pytest.raises(web.HTTPForbidden):
                access.check_place(origin=origin, host="localhost")
    assert [(each["event"], each["origin"]) for each in logs] == [
        ("client.origin_refused", "http://evil.example"),
        ("client.origin_refused", "null"),
    ]


def access_of(*tokens: TokenConfig) -> Access:
    return Access(ApiConfig(tokens=tokens))


def test_token_that_is_missing_or_has_another_role_is_revoked() -> None:
    old, reader = access_of(DRIVER, WATCHER), replace(DRIVER, role="read")
    assert old.revoked(access_of(WATCHER, DRIVER)) == set()
    assert old.revoked(access_of(DRIVER)) == {"wall"}
    assert old.revoked(access_of(reader, WATCHER)) == {"phone"}
    assert old.revoked(access_of(replace(DRIVER, token="another-token-of-it"), WATCHER)) == {"phone"}
    assert old.revoked(Access(ApiConfig())) == {"phone", "wall"}


def test_requests_without_a_token_are_revoked_with_the_first_token() -> None:
    none = Access(ApiConfig())
    assert (none.has_tokens, access_of(DRIVER).has_tokens) == (False, True)
    assert none.revoked(access_of(DRIVER)) == {""}
    assert none.revoked(Access(ApiConfig())) == set()


@pytest.mark.parametrize(
    ("host", "is_loopback_"),
    [
        ("localhost", True),
        ("127.0.0.1", True),
        ("127.8.8.8", True),
        ("::1", True),
        ("[::1]", True),
        ("0.0.0.0", False),
        ("10.0.0.1", False),
        ("robot", False),
        ("", False),
    ],
)
def test_loopback_is_reached_by_this_computer_alone(host: str, is_loopback_: bool) -> None:
    assert is_loopback(host) is is_loopback_


@pytest.mark.parametrize(
    ("token", "problem"),
    [
        (TokenConfig(name="a", role="read"), "needs either token or token_file"),
        (TokenConfig(name="a", role="read", token="x" * 20, token_file=Path("f")), "needs either token or token_file"),
        (TokenConfig(name="a", role="read", token_file=Path("/none/of/these")), "token_file: "),
        (TokenConfig(name="a", role="read", token="x" * (SHORTEST_TOKEN - 1)), f"at least {SHORTEST_TOKEN} characters"),
    ],
)
def test_token_without_a_secret_is_refused(token: TokenConfig, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        access_of(token)
    access_of(TokenConfig(name="a", role="read", token="x" * SHORTEST_TOKEN))


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"max_clients": 0}, "api.max_clients"),
        ({"max_message_bytes": 0}, "api.max_message_bytes"),
        ({"max_requests_s": 0.5}, "api.max_requests_s"),
        ({"max_requests_s": float("nan")}, "api.max_requests_s"),
        ({"request_timeout_s": 0.0}, "api.request_timeout_s"),
        ({"request_timeout_s": float("inf")}, "api.request_timeout_s"),
        ({"max_connections": KEPT_FOR_REQUESTS}, "api.max_connections"),
        ({"max_connections_per_address": KEPT_FOR_REQUESTS}, "api.max_connections_per_address"),
        ({"origins": ("*",)}, "api.origins"),
        ({"tokens": (DRIVER, replace(WATCHER, token=DRIVER.token))}, "two names have the same token"),
    ],
)
def test_setting_out_of_its_bounds_is_refused(changes: dict[str, Any], problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        Access(replace(ApiConfig(), **changes))


def test_least_settings_are_accepted() -> None:
    least = KEPT_FOR_REQUESTS + 1
    Access(
        ApiConfig(
            max_clients=1,
            max_message_bytes=1,
            max_requests_s=1.0,
            max_connections=least,
            max_connections_per_address=least,
        )
    )
    Access(ApiConfig(tokens=(DRIVER,), origins=("*",), host="0.0.0.0"))


async def test_task_of_a_revoked_grant_is_cancelled_and_the_own_one_is_not() -> None:
    grants, ended = Grants(), []

    async def answer(who: str) -> None:
        with grants.using(Grant(who, Role.READ)):
            try:
                await asyncio.sleep(1e6)
            finally:
                ended.append(who)

    async with asyncio.TaskGroup() as tasks:
        both = [tasks.create_task(answer(who)) for who in ("phone", "wall")]
        await asyncio.sleep(0)
        with grants.using(Grant("phone", Role.DRIVE)):
            grants.end({"phone"})
            await asyncio.sleep(0)
        assert ended == ["phone"]
        grants.end({"wall", "phone"})
        await asyncio.wait(both)
    assert ended == ["phone", "wall"]
